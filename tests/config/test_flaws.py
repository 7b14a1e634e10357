"""What is wrong in a file is refused, wholly listed, and named by its place."""

from __future__ import annotations

import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.config import parse_configuration
from adaptdrive.errors import ConfigurationError
from tests.config.documents import MINIMAL, SOURCE, flaws, parse


def leaves(section: dict[str, object], prefix: str = "") -> list[tuple[str, object]]:
    found: list[tuple[str, object]] = []
    for key, value in section.items():
        place = f"{prefix}{key}"
        found += leaves(value, f"{place}.") if isinstance(value, dict) else [(place, value)]
    return found


LEAVES = leaves(parse().model_dump())
FLOATS = [place for place, value in LEAVES if isinstance(value, float)]
SWITCHES = [place for place, value in LEAVES if isinstance(value, bool)]
NUMBERS = [
    place for place, value in LEAVES if isinstance(value, int | float) and place not in SWITCHES
]
TOML_VALUES = st.one_of(
    st.integers(-(2**63), 2**63 - 1).map(str),
    st.floats().map(lambda value: repr(float(value))),
    st.booleans().map(lambda value: str(value).lower()),
    st.sampled_from(['""', '"x"', "[]", "[1]", "{}", "{ x = 1 }", "2026-11-21T10:00:00Z"]),
)


def change(place: str, value: str | None) -> dict[str, str | None]:
    return {place.replace(".", "__"): value}


def test_every_flaw_is_listed_with_its_place() -> None:
    assert set(
        flaws(
            drive__line_frequency_Hz="55",
            bus__udp_port="0",
            bus__chanel='"typo"',
            load__pole='"slow"',
            load__model__gain=None,
            mqtt__port="70000",
            extras='"unknown section"',
        )
    ) == {
        "drive.line_frequency_Hz",
        "bus.udp_port",
        "bus.chanel",
        "load.pole",
        "load.model.gain",
        "mqtt.port",
        "extras",
    }


def test_the_text_of_the_error_has_a_line_for_each_flaw() -> None:
    with pytest.raises(ConfigurationError) as caught:
        parse(load__pole="1.5", mqtt__port="0")
    first, second = str(caught.value).splitlines()
    assert first.startswith(f"{SOURCE}: load.pole: ")
    assert "1.5" in first
    assert second.startswith(f"{SOURCE}: mqtt.port: ")


def test_the_type_of_the_load_is_one_that_is_known() -> None:
    found = flaws(load__type='"pump"')
    assert set(found) == {"load.type"}
    assert all(kind in found["load.type"] for kind in ("motor", "bath", "battery"))


@pytest.mark.parametrize(
    "place", ["key", "drive.key", "drive.limits.key", "load.model.key", "signals.command.key"]
)
def test_an_unknown_key_is_a_flaw(place: str) -> None:
    assert set(flaws(**change(place, "1"))) == {place}


@pytest.mark.parametrize("place", [key for key in MINIMAL if "signals.command" not in key])
def test_a_missing_key_is_a_flaw(place: str) -> None:
    (flaw,) = flaws(**change(place, None))
    assert place == flaw or place.startswith(f"{flaw}.")


@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
@pytest.mark.parametrize("place", FLOATS)
def test_every_number_is_finite(place: str, value: str) -> None:
    assert set(flaws(**change(place, value))) == {place}


@pytest.mark.parametrize("value", ["{}", "true", '"1"', '"yes"'])
@pytest.mark.parametrize("place", NUMBERS)
def test_a_number_is_neither_text_nor_a_truth_value(place: str, value: str) -> None:
    assert set(flaws(**change(place, value))) == {place}


@pytest.mark.parametrize("value", ["1", '"yes"', "0.0"])
@pytest.mark.parametrize("place", SWITCHES)
def test_a_switch_is_on_or_off(place: str, value: str) -> None:
    assert set(flaws(**change(place, value))) == {place}


@pytest.mark.parametrize(
    ("changes", "place", "message"),
    [
        (
            {"drive.limits.boost_reference_min_V": "400.0"},
            "drive.limits",
            "boost_reference_min_V = 400.0 must be below boost_reference_max_V = 400.0",
        ),
        (
            {"drive.limits.boost_reference_min_V": "169.7"},
            "drive.limits.boost_reference_min_V",
            "169.7 must be above the line's peak of 169.7 V",
        ),
        (
            {"drive.line_voltage_V": "230.0"},
            "drive.limits.boost_reference_min_V",
            "line's peak of 325.3 V",
        ),
        ({"load.reference_min": "6.0"}, "load", "reference_min = 6.0 must be below"),
        ({"load.pole": "0.49"}, "load", "pole = 0.49 must lie in"),
        ({"load.pole": "0.99"}, "load", "pole = 0.99 must lie in"),
        ({"load.pole_min": "0.8", "load.pole_max": "0.6"}, "load", "0.8…0.6"),
        (
            {"realtime.rehearse_us": "200.0", "realtime.spin_us": "200.0"},
            "realtime.spin_us",
            "200 leaves no time for the rehearsal before it: rehearse_us = 200 must be larger",
        ),
    ],
)
def test_limits_that_contradict_each_other_are_a_flaw(
    changes: dict[str, str], place: str, message: str
) -> None:
    found = flaws(**{key.replace(".", "__"): value for key, value in changes.items()})
    assert set(found) == {place}
    assert message in found[place]


def test_every_contradiction_between_sections_is_listed() -> None:
    assert flaws(
        load__samples="121",
        load__latency_ticks="120",
        signals__command__current_scale_S=None,
        interlocks__boost_voltage_max_V="400.0",
        interlocks__output_max="6.0",
    ) == {
        "load.samples": "121 exceeds the 120 ticks of one period",
        "load.latency_ticks": "120 must be below the 120 ticks of one period",
        "signals.command.current_scale_S": ("is missing: voltage_loop.where = 'daemon' needs it"),
        "interlocks.boost_voltage_max_V": (
            "400.0 must be above drive.limits.boost_reference_max_V = 400.0"
        ),
        "interlocks.output_max": "6.0 must be above load.reference_max = 6.0",
    }


def test_the_default_of_a_key_with_a_wrong_value_contradicts_nothing() -> None:
    assert set(flaws(load__period_s="20.0", load__samples="600")) == set()
    assert set(flaws(load__period_s='"20 s"', load__samples="600")) == {"load.period_s"}


def test_a_drive_that_holds_its_own_voltage_needs_its_reference() -> None:
    assert set(flaws(voltage_loop__where='"drive"')) == {"signals.command.boost_reference_V"}
    given = '"DriveCommand.BoostReference"'
    assert not flaws(voltage_loop__where='"drive"', signals__command__boost_reference_V=given)


@given(half_cycles=st.floats(0.0, 500_000.0))
def test_a_slow_period_is_a_whole_number_of_half_cycles(half_cycles: float) -> None:
    found = flaws(load__period_s=repr(half_cycles / 120.0))
    whole = abs(half_cycles - round(half_cycles)) <= 1e-6 * half_cycles
    refused = "load.period_s" in found
    assert refused == (not whole or not 0.5 <= half_cycles <= 432_000.0)


def test_a_quantity_has_a_name() -> None:
    assert set(flaws(signals__output='""')) == {"signals.output.signal"}


def test_a_flaw_of_a_quantity_is_named_by_its_key() -> None:
    table = "{ signal = 'DriveLoad.Tachometer', scale = 'x' }"
    assert set(flaws(signals__output=table)) == {"signals.output.scale"}


@given(low=st.floats(0.01, 0.99), pole=st.floats(0.01, 0.99), high=st.floats(0.01, 0.99))
def test_a_pole_is_accepted_exactly_when_it_lies_in_its_range(
    low: float, pole: float, high: float
) -> None:
    found = flaws(load__pole_min=repr(low), load__pole=repr(pole), load__pole_max=repr(high))
    assert (not found) == (low <= pole <= high)


@given(st.text())
def test_any_text_is_either_a_configuration_or_a_listed_error(text: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        parse_configuration(text, SOURCE)
    assert caught.value.flaws


@given(place=st.sampled_from([place for place, _ in LEAVES]), value=TOML_VALUES)
def test_any_value_in_any_place_is_either_taken_or_refused(place: str, value: str) -> None:
    found = flaws(**change(place, value))
    assert all(where and message for where, message in found.items())


def test_a_key_of_another_kind_of_load_is_not_proposed_in_its_own_place() -> None:
    found = flaws(load__type='"bath"')
    assert found["load.model.gain"] == "Unknown key"
    assert found["load.model.tau_motor_s"] == "Unknown key (did you mean 'tau_s'?)"


@pytest.mark.parametrize(
    "host",
    [
        *("", " ", "my broker", "a" * 64, "x." * 127 + "x", "broker..local", ".", "a/b", "-x"),
        *("x-", "tab\\t", "nul\\u0000", "ü" * 60, "::g", "[::1]", "user@x", "x:1883", "http://x"),
    ],
)
def test_a_broker_host_that_cannot_be_looked_up_is_refused(host: str) -> None:
    assert set(flaws(mqtt__host=f'"{host}"')) == {"mqtt.host"}


@pytest.mark.parametrize("letter", ["\\u0000", "\\u001b", "\\n", "\\u0085", "\\u2028", "\\u007f"])
@pytest.mark.parametrize(
    "place", ["load.output_name", "load.output_unit", "mqtt.username", "bus.clock", "drive.name"]
)
def test_a_text_with_a_control_character_is_refused_with_value_and_place(
    place: str, letter: str
) -> None:
    found = flaws(**change(place, f'"spe{letter}ed"'))
    assert set(found) == {place}
    shown = repr(tomllib.loads(f'a = "spe{letter}ed"')["a"])
    assert f"without control characters (it is {shown})" in found[place]


@pytest.mark.parametrize(
    "place", ["load.output_name", "load.output_unit", "mqtt.username", "bus.clock", "drive.name"]
)
def test_a_text_longer_than_a_path_is_refused(place: str) -> None:
    found = flaws(**change(place, f'"{"s" * 4097}"'))
    assert set(found) == {place}
    assert "the text must have at most 4096 characters" in found[place]


@pytest.mark.parametrize(
    "place", ["bus.channel", "bus.database", "mqtt.password_file", "recording.directory"]
)
def test_a_channel_or_a_path_without_a_name_is_refused(place: str) -> None:
    assert set(flaws(**change(place, '""'))) == {place}


def test_a_key_with_a_control_character_is_refused() -> None:
    with pytest.raises(ConfigurationError) as caught:
        parse(**{"simulation.parameters": '{ "fric\\u001btion" = 1.0 }'})
    (flaw,) = caught.value.flaws
    assert flaw.place == "simulation.parameters.fric\x1btion"
    assert str(flaw).startswith(r"simulation.parameters.fric\x1btion: the key must be one line")


@pytest.mark.parametrize(
    "text", ["Drehzahl", "Скорость", "速度", "speed of fan 2", "µm/s²", "°C", ""]
)
def test_names_and_units_of_any_language_pass(text: str) -> None:
    assert parse(load__output_name=f'"{text}"').load.output_name == text
    assert parse(load__output_unit=f'"{text}"').load.output_unit == text


@pytest.mark.parametrize(
    "host", ["localhost", "10.0.0.1", "::1", "fe80::1%eth0", "a_b-c.example.", "bücher.example"]
)
def test_a_broker_host_that_can_be_looked_up_passes(host: str) -> None:
    assert parse(mqtt__host=f'"{host}"').mqtt.host == host


def test_an_authority_without_tls_is_refused() -> None:
    found = flaws(mqtt__ca_file='"ca.pem"')
    assert set(found) == {"mqtt"}
    assert "in clear" in found["mqtt"]
    assert parse(mqtt__ca_file='"ca.pem"', mqtt__tls="true").mqtt.tls


def test_a_course_of_impulses_needs_the_papers_design_and_a_quick_voltage_loop() -> None:
    impulse = {"load__boost_course": '"impulse"'}
    assert flaws(**impulse).keys() == {"load.boost_course"}
    assert flaws(**impulse, load__design='"paper"') == {}
    slow = {
        "voltage_loop__where": '"drive"',
        "voltage_loop__lag_s": "0.3",
        "signals__command__boost_reference_V__signal": '"DriveCommand.BoostReference"',
    }
    assert flaws(**impulse, load__design='"paper"', **slow).keys() == {"load.boost_course"}
