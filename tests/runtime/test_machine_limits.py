"""The limits of an operator's requests, at them and beyond them, with the words of each refusal."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace

import pytest

from adaptdrive.control.reach import Reach
from adaptdrive.errors import RefusedError
from adaptdrive.runtime.machine_limits import MachineLimits
from adaptdrive.runtime.manual import ManualVoltage
from tests.runtime.test_machine import LIMITS

REACH = Reach(2.25, 4.25)
Check = Callable[[], None]

WITHIN: dict[str, Check] = {
    "lowest set-point": lambda: LIMITS.require_reference("setpoint", 0.0),
    "highest set-point": lambda: LIMITS.require_reference("setpoint", 4.5),
    "lowest in reach": lambda: LIMITS.require_reach("setpoint", 2.25, REACH),
    "highest in reach": lambda: LIMITS.require_reach("setpoint", 4.25, REACH),
    "governed": lambda: replace(LIMITS, govern=True).require_reach("setpoint", 9.0, REACH),
    "shortest period": lambda: LIMITS.require_period("period_s", 4.0),
    "fastest pole": lambda: LIMITS.require_pole(0.5),
    "slowest pole": lambda: LIMITS.require_pole(0.98),
    "lowest V_c": lambda: LIMITS.require_voltage(200.0, None),
    "highest V_c, for a day": lambda: LIMITS.require_voltage(400.0, 86_400.0),
    "any time": lambda: LIMITS.require_voltage(300.0, 1e-3),
}
BEYOND: dict[str, Check] = {
    "setpoint = -0.1 V is outside 0…4.5 V":
        lambda: LIMITS.require_reference("setpoint", -0.1),
    "setpoint = 4.6 V is outside 0…4.5 V":
        lambda: LIMITS.require_reference("setpoint", 4.6),
    "setpoint = nan V is outside 0…4.5 V":
        lambda: LIMITS.require_reference("setpoint", math.nan),
    "setpoint = inf V is outside 0…inf V":
        lambda: replace(LIMITS, reference_max=math.inf).require_reference("setpoint", math.inf),
    "low = 2.2 V is outside 2.25…4.25 V, which V_c can hold":
        lambda: LIMITS.require_reach("low", 2.2, REACH),
    "high = 4.3 V is outside 2.25…4.25 V, which V_c can hold":
        lambda: LIMITS.require_reach("high", 4.3, REACH),
    "period_s = 3.9 s is below 4 s": lambda: LIMITS.require_period("period_s", 3.9),
    "period_s = nan s is below 4 s": lambda: LIMITS.require_period("period_s", math.nan),
    "pole = 0.49 is outside 0.5…0.98": lambda: LIMITS.require_pole(0.49),
    "pole = 0.99 is outside 0.5…0.98": lambda: LIMITS.require_pole(0.99),
    "voltage = 199 V is outside 200…400 V": lambda: LIMITS.require_voltage(199.0, None),
    "voltage = 401 V is outside 200…400 V": lambda: LIMITS.require_voltage(401.0, 1.0),
    "hold_s = 0 s is not above 0 s and at most 86400 s":
        lambda: LIMITS.require_voltage(300.0, 0.0),
    "hold_s = 86400.5 s is not above 0 s": lambda: LIMITS.require_voltage(300.0, 86_400.5),
}  # fmt: skip


@pytest.mark.parametrize("name", WITHIN)
def test_a_value_at_its_limit_is_allowed(name: str) -> None:
    WITHIN[name]()


@pytest.mark.parametrize("reason", BEYOND)
def test_a_value_beyond_its_limit_is_refused_by_name(reason: str) -> None:
    with pytest.raises(RefusedError, match=re.escape(reason)):
        BEYOND[reason]()


@pytest.mark.parametrize(("output", "nearest"), [(-1.0, 0.0), (2.5, 2.5), (9.0, 4.5)])
def test_the_nearest_set_point_is_within_the_limits(output: float, nearest: float) -> None:
    assert LIMITS.nearest_reference(output) == nearest


@pytest.mark.parametrize(("asked_V", "held_V"), [(90.0, 200.0), (250.0, 250.0), (900.0, 400.0)])
def test_a_held_voltage_is_within_its_limits_and_stays(asked_V: float, held_V: float) -> None:
    held = LIMITS.held(asked_V, 7)
    assert [held.value(tick) for tick in (0, 7, 1000)] == [held_V] * 3
    assert held.slew_V == pytest.approx(0.5)  # 60 V/s at 120 Hz
    assert held.find_cause(10**9) is None


def test_an_unknown_voltage_is_held_at_the_floor() -> None:
    assert LIMITS.held(math.nan, 0).value(0) == LIMITS.floor_V


@pytest.mark.parametrize("needs_bridge", [False, True])
def test_a_precharge_that_fails_names_voltage_time_and_remedy(*, needs_bridge: bool) -> None:
    limits: MachineLimits = replace(LIMITS, boost_needs_bridge=needs_bridge)
    cause = limits.precharge_cause(171.04)
    assert cause.startswith("precharge: v_bst = 171.0 V after 5 s, needs 200 V")
    assert ("with its enable bit on" in cause) is needs_bridge
    assert ("drive.enable_bit = 'bridge-and-boost'" in cause) is not needs_bridge


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_voltage_moves_by_its_slope_and_stops_at_its_target(sign: float) -> None:
    moving = ManualVoltage(300.0, 300.0 + 1.5 * sign, since_tick=10, slew_V=0.5)
    way = [sign * (moving.value(tick) - 300.0) for tick in range(8, 16)]
    assert way == [0.0, 0.0, 0.0, 0.5, 1.0, 1.5, 1.5, 1.5]
    short = ManualVoltage(300.0, 300.0 + 0.75 * sign, since_tick=10, slew_V=0.5)
    assert [sign * (short.value(tick) - 300.0) for tick in (11, 12)] == [0.5, 0.75]


def test_a_voltage_with_a_time_expires_after_it() -> None:
    moving = ManualVoltage(300.0, 300.0, since_tick=10, slew_V=0.5, hold_s=0.5, hold_ticks=60)
    assert moving.find_cause(70) is None
    assert moving.find_cause(71) == (
        "manual: no new voltage within the 0.5 s that its sender had set"
    )
