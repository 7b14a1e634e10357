"""The last look before the wire, with whatever a broken controller could say."""

from __future__ import annotations

import contextlib
import math
from typing import Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.config.root import DriveLimits, DriveSection
from adaptdrive.control.signals import SAFE_COMMAND, Command
from adaptdrive.safety.guard import Guard

ANY = st.floats(allow_nan=True, allow_infinity=True) | st.floats(-1.0, 1.0)
COMMANDS = st.builds(Command, ANY, ANY | st.floats(0.0, 500.0), st.booleans())


def drive(
    kind: Literal["unidirectional", "bidirectional"], slew_S: float, lowest_V: float = 200.0
) -> DriveSection:
    """A drive with k of 0.15 S at the most, and 400 V."""
    limits = DriveLimits(current_scale_slew_S=slew_S, boost_reference_min_V=lowest_V)
    return DriveSection(name="guarded", kind=kind, limits=limits)


DRIVES = st.builds(
    drive,
    st.sampled_from(["unidirectional", "bidirectional"]),
    st.sampled_from([0.01, 0.05, 0.15, 0.4]),
)
UNIDIRECTIONAL = drive("unidirectional", 0.02)


@given(guarded=DRIVES, wanted=st.lists(st.just(SAFE_COMMAND) | COMMANDS, max_size=60))
def test_what_goes_out_is_finite_in_range_and_does_not_jump(
    guarded: DriveSection, wanted: list[Command]
) -> None:
    guard, limits, last_S = Guard(guarded), guarded.limits, 0.0
    for command in wanted:
        values = (command.current_scale_S, command.boost_reference_V)
        if not all(map(math.isfinite, values)):
            with pytest.raises(ValueError, match="not finite"):
                guard.check(command)
            continue
        sent = guard.check(command)
        assert guarded.current_scale_min_S <= sent.current_scale_S <= limits.current_scale_max_S
        assert 0.0 <= sent.boost_reference_V <= limits.boost_reference_max_V
        jump_S = abs(sent.current_scale_S - last_S)
        assert sent == SAFE_COMMAND or jump_S <= limits.current_scale_slew_S * (1 + 1e-12)
        assert command.bridge or not sent.bridge
        last_S = sent.current_scale_S


@given(guarded=DRIVES, before=st.lists(COMMANDS, max_size=20))
def test_the_safe_command_passes_at_once(guarded: DriveSection, before: list[Command]) -> None:
    guard = Guard(guarded)
    for command in before:
        with contextlib.suppress(ValueError):
            guard.check(command)
    assert guard.check(SAFE_COMMAND) == SAFE_COMMAND


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_value_that_is_no_number_is_refused_by_name(value: float) -> None:
    guard = Guard(UNIDIRECTIONAL)
    with pytest.raises(ValueError, match=f"k = {value:g} S, V_c = 300 V"):
        guard.check(Command(value, 300.0, bridge=True))
    with pytest.raises(ValueError, match=f"k = 0.01 S, V_c = {value:g} V"):
        guard.check(Command(0.01, value, bridge=True))


def test_a_command_within_limits_passes_as_it_is() -> None:
    guard = Guard(UNIDIRECTIONAL)
    for scale_S in (0.0, 0.02, 0.04, 0.025, 0.01):
        command = Command(scale_S, 300.0, bridge=True)
        assert guard.check(command) == command
    assert guard.limited == 0


def test_after_a_stop_the_current_rises_from_zero_again() -> None:
    guard = Guard(UNIDIRECTIONAL)
    for _ in range(5):
        guard.check(Command(0.1, 300.0, bridge=True))
    guard.check(SAFE_COMMAND)
    assert guard.check(Command(0.1, 300.0, bridge=True)).current_scale_S == 0.02
    assert guard.limited == 6 - 1


def test_a_low_voltage_passes_as_it_is() -> None:
    command = Command(0.0, 0.5, bridge=True)
    assert Guard(UNIDIRECTIONAL).check(command) == command


def test_a_drive_that_runs_both_ways_is_commanded_backwards() -> None:
    guard = Guard(drive("unidirectional", 0.02, lowest_V=-100.0))
    for asked, sent in ((-5.0, -5.0), (-100.0, -100.0), (-101.0, -100.0)):
        assert guard.check(Command(0.0, asked, bridge=True)).boost_reference_V == sent
    assert guard.limited == 1


def test_a_negative_voltage_becomes_none_and_is_counted() -> None:
    guard = Guard(UNIDIRECTIONAL)
    assert guard.check(Command(0.0, -5.0, bridge=True)) == Command(0.0, 0.0, bridge=True)
    assert guard.limited == 1
