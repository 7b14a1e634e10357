"""What is wrong in a file is refused, wholly listed, and named by its place.

The texts of the flaws are in `flaws.txt`; `tests/golden.py` says how they are renewed.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.config import parse_configuration
from adaptdrive.util.errors import ConfigurationError, Flaw
from tests.golden import hold
from tests.unit.config import documents, modbus_documents
from tests.unit.config.documents import MINIMAL, SOURCE, flaws, parse
from tests.unit.config.test_sensors import DIFFERENCE, THERMOCOUPLES
from tests.unit.config.test_sensors import flaws as sensor_flaws


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


def test_each_flaw_has_its_place_and_its_text() -> None:
    hold(Path(__file__).with_name("flaws.txt"), answered)


def answered(subject: str, asked: list[str]) -> Iterator[str]:
    """Yield the flaws of a small configuration with other keys, or with another text.

    Args:
        subject: Which one.
        asked: `key = value`, `key` alone to leave it out, or `text -> other text`.
    """
    changes = [line.split(" -> ") for line in asked if " -> " in line]
    pairs = [line.partition(" = ") for line in asked if " -> " not in line]
    keys = {key.replace(".", "__"): value or None for key, _, value in pairs}
    if subject == "thermocouples beside the drive":
        text = THERMOCOUPLES + DIFFERENCE
        for old, new in changes:
            assert old in text
            text = text.replace(old, new.encode().decode("unicode_escape"), 1)
        found = sensor_flaws(text, **keys)
    else:
        found = (modbus_documents if "Modbus" in subject else documents).flaws(**keys)
    yield from (str(Flaw(*item)) for item in found.items())
    if not found:
        yield "valid"


@pytest.mark.parametrize(
    ("places", "values"),
    [
        (FLOATS, ["nan", "inf", "-inf"]),
        (NUMBERS, ["{}", "true", '"1"', '"yes"']),
        (SWITCHES, ["1", '"yes"', "0.0"]),
    ],
    ids=["finite numbers", "numbers", "switches"],
)
def test_no_key_takes_a_value_of_another_kind(places: list[str], values: list[str]) -> None:
    for value in values:
        changes = {place.replace(".", "__"): value for place in places}
        assert sorted(flaws(**changes)) == sorted(places), value


@pytest.mark.parametrize("place", [key for key in MINIMAL if "signals.command" not in key])
def test_a_missing_key_is_a_flaw(place: str) -> None:
    (flaw,) = flaws(**{place.replace(".", "__"): None})
    assert place == flaw or place.startswith(f"{flaw}.")


def test_the_text_of_the_error_has_a_line_for_each_flaw() -> None:
    with pytest.raises(ConfigurationError) as caught:
        parse(load__pole="1.5", mqtt__port="0")
    first, second = str(caught.value).splitlines()
    assert first.startswith(f"{SOURCE}: load.pole: ")
    assert second.startswith(f"{SOURCE}: mqtt.port: ")


@given(half_cycles=st.floats(0.0, 500_000.0))
def test_a_slow_period_is_a_whole_number_of_half_cycles(half_cycles: float) -> None:
    found = flaws(load__period_s=repr(half_cycles / 120.0))
    whole = abs(half_cycles - round(half_cycles)) <= 1e-6 * half_cycles
    refused = "load.period_s" in found
    assert refused == (not whole or not 0.5 <= half_cycles <= 432_000.0)


@given(st.text())
def test_any_text_is_either_a_configuration_or_a_listed_error(text: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        parse_configuration(text, SOURCE)
    assert caught.value.flaws


@given(place=st.sampled_from([place for place, _ in LEAVES]), value=TOML_VALUES)
def test_any_value_in_any_place_is_either_taken_or_refused(place: str, value: str) -> None:
    found = flaws(**{place.replace(".", "__"): value})
    assert all(where and message for where, message in found.items())


@pytest.mark.parametrize(
    "place", ["load.output_name", "load.output_unit", "mqtt.username", "bus.clock", "drive.name"]
)
def test_a_text_longer_than_a_path_is_refused(place: str) -> None:
    found = flaws(**{place.replace(".", "__"): f'"{"s" * 4097}"'})
    assert set(found) == {place}
    assert "the text must have at most 4096 characters" in found[place]


@pytest.mark.parametrize(
    "text", ["Drehzahl", "Скорость", "速度", "speed of fan 2", "µm/s²", "°C", ""]
)
def test_names_and_units_of_any_language_pass(text: str) -> None:
    configuration = parse(load__output_name=f'"{text}"', load__output_unit=f'"{text}"')
    assert configuration.load.output_name == configuration.load.output_unit == text
