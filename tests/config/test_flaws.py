"""What is wrong in a file is refused, wholly listed, and named by its place."""

from __future__ import annotations

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
NUMBERS = [place for place, value in LEAVES if isinstance(value, int | float)]
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


@pytest.mark.parametrize(
    "place", ["key", "drive.key", "drive.limits.key", "load.model.key", "signals.command.key"]
)
def test_an_unknown_key_is_a_flaw(place: str) -> None:
    assert set(flaws(**change(place, "1"))) == {place}


@pytest.mark.parametrize("place", [key for key in MINIMAL if "signals.command" not in key])
def test_a_missing_key_is_a_flaw(place: str) -> None:
    (flaw,) = flaws(**change(place, None))
    assert place == flaw or place.startswith(f"{flaw}.")


@pytest.mark.parametrize("place", FLOATS)
def test_no_number_may_be_nan(place: str) -> None:
    assert set(flaws(**change(place, "nan"))) == {place}


@pytest.mark.parametrize("place", NUMBERS)
def test_no_number_may_be_a_table(place: str) -> None:
    assert set(flaws(**change(place, "{}"))) == {place}


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
            "drive",
            "limits.boost_reference_min_V = 169.7 must be above the line's peak of 169.7 V",
        ),
        ({"drive.line_voltage_V": "230.0"}, "drive", "line's peak of 325.3 V"),
        ({"load.reference_min": "6.0"}, "load", "reference_min = 6.0 must be below"),
        ({"load.pole": "0.49"}, "load", "pole = 0.49 must lie in"),
        ({"load.pole": "0.99"}, "load", "pole = 0.99 must lie in"),
        ({"load.pole_min": "0.8", "load.pole_max": "0.6"}, "load", "0.8…0.6"),
    ],
)
def test_limits_that_contradict_each_other_are_a_flaw(
    changes: dict[str, str], place: str, message: str
) -> None:
    found = flaws(**{key.replace(".", "__"): value for key, value in changes.items()})
    assert set(found) == {place}
    assert message in found[place]


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
