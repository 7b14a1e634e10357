"""Each cause of a trip, and which one is named when there are several."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.app.settings import fast_settings
from adaptdrive.config import load_configuration
from adaptdrive.safety.facts import Reading
from adaptdrive.safety.interlocks import Limits, find_cause
from adaptdrive.safety.trips import Trip, TripKind
from adaptdrive.util.quantity import Display
from tests.support import text_of
from tests.unit.devices.bench import EXAMPLES
from tests.unit.runtime.bench import CALM

STALE_S = 0.05
LIMITS = Limits(
    boost_voltage_max_V=430.0,
    output_max=5.0,
    display=Display("V"),
    output_name="speed",
    output_min=-1.0,
)
NOW_S = 12.0
GOOD = replace(CALM, arrival_s=NOW_S - 0.001, oldest_s=NOW_S - 0.002)
ANY = st.floats(allow_nan=True, allow_infinity=True)


def cause_of(**changes: object) -> str | None:
    cause = find_cause(replace(GOOD, **changes), NOW_S, LIMITS, STALE_S)  # type: ignore[arg-type]
    return text_of(cause)


@pytest.mark.parametrize("output", [GOOD.output, 5.0, -1.0])
def test_values_within_and_at_their_limits_are_no_cause(output: float) -> None:
    assert cause_of(output=output) is None
    assert cause_of(output=output, boost_voltage_V=430.0, oldest_s=NOW_S - 0.05 + 1e-9) is None


def test_a_measurement_exactly_as_old_as_the_limit_is_used() -> None:
    stale_s = 0.0625  # a power of two: its sum and difference are exact
    assert find_cause(replace(GOOD, oldest_s=NOW_S - stale_s), NOW_S, LIMITS, stale_s) is None


def test_a_message_that_comes_less_often_may_be_older_by_its_period() -> None:
    assert cause_of(oldest_s=NOW_S - 0.069, slack_s=0.02) is None
    cause = cause_of(oldest_s=NOW_S - 2.0, slack_s=0.02)
    assert cause == "stale: measurement is 2000 ms old, limit 70 ms"


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"oldest_s": NOW_S - 0.051}, "stale: measurement is 51 ms old, limit 50 ms"),
        ({"oldest_s": -math.inf}, "stale: "),
        ({"oldest_s": math.nan}, "stale: "),
        ({"fault": 0x12}, "drive fault: word 0x12"),
        ({"boost_voltage_V": 430.1}, "over-voltage: v_bst = 430.1 V, limit 430 V"),
        ({"boost_voltage_V": -430.1}, "over-voltage: v_bst = -430.1 V, limit 430 V"),
        ({"output": 5.01}, "output above its limit: speed = 5.01 V, limit 5 V"),
        ({"output": -1.1}, "output below its limit: speed = -1.1 V, limit -1 V"),
        ({"boost_voltage_V": math.nan}, "invalid: "),
        ({"line_voltage_V": math.inf}, "invalid: "),
        ({"load_power_W": -math.inf}, "invalid: "),
        ({"output": math.nan}, "invalid: "),
    ],
)
def test_each_cause_is_named_with_its_value(changes: dict[str, float], text: str) -> None:
    cause = cause_of(**changes)
    assert cause is not None
    assert cause.startswith(text)


def test_what_makes_other_causes_meaningless_is_named_first() -> None:
    """Old values say nothing, values that are no numbers little, a fault explains the rest."""
    order: list[tuple[str, dict[str, float]]] = [
        ("stale", {"oldest_s": NOW_S - 1.0}),
        ("invalid", {"line_voltage_V": math.nan}),
        ("drive fault", {"fault": 1}),
        ("over-voltage", {"boost_voltage_V": 500.0}),
        ("output above", {"output": 9.0}),
    ]
    for index in range(len(order)):
        together: dict[str, float] = {}
        for _, changes in order[index:]:
            together |= changes
        cause = cause_of(**together)
        assert cause is not None
        assert cause.startswith(order[index][0])


@given(values=st.tuples(ANY, ANY, ANY, ANY), age=ANY, fault=st.integers(0, 255))
def test_without_a_cause_everything_is_fresh_finite_healthy_and_within_limits(
    values: tuple[float, float, float, float], age: float, fault: int
) -> None:
    reading = Reading(NOW_S, NOW_S - age, None, *values, fault, bridge=True)
    if find_cause(reading, NOW_S, LIMITS, STALE_S) is None:
        assert NOW_S - reading.oldest_s <= STALE_S
        assert all(map(math.isfinite, values))
        assert fault == 0
        assert reading.boost_voltage_V <= LIMITS.boost_voltage_max_V
        assert reading.output <= LIMITS.output_max


@pytest.mark.parametrize(("example", "text"), [("bath", "temperature = 99 K, limit 25 K")])
def test_the_trip_names_the_output_as_the_configuration_does(example: str, text: str) -> None:
    limits = fast_settings(load_configuration(EXAMPLES / f"{example}.toml")).limits
    cause = find_cause(replace(GOOD, output=99.0), NOW_S, limits, STALE_S)
    assert cause is not None
    assert text in str(cause)


@pytest.mark.parametrize(("example", "lowest"), [("motor", -1.125), ("bath", -3.625)])
def test_without_a_limit_below_a_quarter_of_the_range_is_one(example: str, lowest: float) -> None:
    limits = fast_settings(load_configuration(EXAMPLES / f"{example}.toml")).limits
    assert limits.output_min == pytest.approx(lowest)


def test_a_stale_reading_is_explained_and_no_other() -> None:
    def explain() -> Trip:
        return Trip(TripKind.NO_MESSAGE, "output (DriveLoad) is the oldest value")

    stale = replace(GOOD, oldest_s=NOW_S - 0.051)
    cause = find_cause(stale, NOW_S, LIMITS, STALE_S, explain)
    text = f"stale: measurement is 51 ms old, limit 50 ms; {explain()}"
    assert cause == Trip(TripKind.NO_MESSAGE, text)
    never = Trip(TripKind.NO_MESSAGE, f"stale: no measurement yet; {explain()}")
    assert find_cause(None, NOW_S, LIMITS, STALE_S, explain) == never
    assert find_cause(GOOD, NOW_S, LIMITS, STALE_S, explain) is None
