"""The CiA 402 state machine, held against the tables of the canopen library."""

from __future__ import annotations

import pytest
from canopen.profiles.p402 import State402
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.control.signals import SAFE_COMMAND, Command
from adaptdrive.devices.canopen.profile import (
    DISABLE_VOLTAGE,
    ENABLE_OPERATION,
    FAULT_RESET,
    SHUTDOWN,
    SWITCH_ON,
    DriveControl,
    DriveState,
    state_of,
)

CHARGE = Command(current_scale_S=0.0, boost_reference_V=250.0, bridge=False)
RUN = Command(current_scale_S=0.0, boost_reference_V=300.0, bridge=True)

REST, READY, SWITCHED_ON, ENABLED = 0x0240, 0x0221, 0x0233, 0x0237
FAULT, REACTION, QUICK_STOP, NOT_READY = 0x0208, 0x020F, 0x0217, 0x0200

words = st.integers(0, 0xFFFF)
statuswords = st.one_of(
    words, st.sampled_from([REST, READY, SWITCHED_ON, ENABLED, FAULT, QUICK_STOP])
)
commands = st.sampled_from([SAFE_COMMAND, CHARGE, RUN])


@given(words)
def test_a_statusword_names_the_state_that_the_library_sees_in_it(word: int) -> None:
    named = [name for name, (mask, bits) in State402.SW_MASK.items() if word & mask == bits]
    if named:
        assert state_of(word).value == named[0].lower()
    else:
        assert state_of(word) is DriveState.UNKNOWN


def test_the_controlwords_are_those_of_the_librarys_transitions() -> None:
    table = State402.TRANSITIONTABLE
    steps = [
        ("SWITCH ON DISABLED", "READY TO SWITCH ON", SHUTDOWN),
        ("READY TO SWITCH ON", "SWITCHED ON", SWITCH_ON),
        ("SWITCHED ON", "OPERATION ENABLED", ENABLE_OPERATION),
        ("OPERATION ENABLED", "SWITCHED ON", SWITCH_ON),
        ("OPERATION ENABLED", "SWITCH ON DISABLED", DISABLE_VOLTAGE),
        ("FAULT", "SWITCH ON DISABLED", FAULT_RESET),
    ]
    for start, end, word in steps:
        assert table[start, end] == word


def risen(*states: int, command: Command = RUN) -> DriveControl:
    """A control whose drive has shown some states, each after a command."""
    control = DriveControl()
    for state in states:
        control.follow(state)
        control.controlword(command)
    return control


def test_a_drive_is_brought_up_one_transition_at_a_time() -> None:
    control = DriveControl()
    sent = []
    for state in (REST, REST, READY, READY, SWITCHED_ON, SWITCHED_ON, ENABLED, ENABLED):
        control.follow(state)
        sent.append(control.controlword(RUN))
    assert sent == [6, 6, 7, 7, 15, 15, 15, 15]
    assert control.fallen is None


def test_charging_stops_short_of_enabled_operation() -> None:
    control = risen(REST, READY, SWITCHED_ON, command=CHARGE)
    assert control.controlword(CHARGE) == SWITCH_ON
    assert control.controlword(RUN) == ENABLE_OPERATION
    control.follow(ENABLED)
    assert control.controlword(CHARGE) == SWITCH_ON  # disables operation
    control.follow(ENABLED)  # the drive has not got there yet
    control.follow(SWITCHED_ON)
    assert control.fallen is None


@pytest.mark.parametrize("state", [READY, SWITCHED_ON, ENABLED, FAULT, QUICK_STOP, NOT_READY])
def test_a_drive_is_brought_up_from_rest_only(state: int) -> None:
    assert DriveControl().controlword(RUN) == DISABLE_VOLTAGE
    assert risen(state).controlword(RUN) == DISABLE_VOLTAGE


@pytest.mark.parametrize("state", [REST, READY, FAULT, REACTION, QUICK_STOP, NOT_READY, 0x0003])
def test_a_drive_that_falls_back_is_not_brought_up_again_before_it_was_commanded_safe(
    state: int,
) -> None:
    control = risen(REST, READY, SWITCHED_ON, ENABLED)
    control.follow(state)
    assert control.fallen is not None
    assert control.controlword(RUN) == DISABLE_VOLTAGE
    control.follow(REST)
    assert control.controlword(RUN) == DISABLE_VOLTAGE
    assert control.controlword(SAFE_COMMAND) == DISABLE_VOLTAGE
    assert control.fallen is None
    control.follow(REST)
    assert control.controlword(RUN) == SHUTDOWN


def test_switched_off_and_on_between_two_statuswords_it_waits_for_rest() -> None:
    control = risen(REST, READY, SWITCHED_ON, ENABLED)
    control.controlword(SAFE_COMMAND)
    assert control.controlword(RUN) == DISABLE_VOLTAGE
    control.follow(ENABLED)  # sent before the drive obeyed
    assert control.controlword(RUN) == DISABLE_VOLTAGE
    assert control.fallen is None
    control.follow(REST)
    assert control.controlword(RUN) == SHUTDOWN


@given(st.lists(st.tuples(statuswords, commands), max_size=60))
def test_whatever_a_drive_says_it_is_never_enabled_out_of_turn(
    story: list[tuple[int, Command]],
) -> None:
    """Bit 3 goes to a drive that has climbed since it was commanded safe, and to no other."""
    control, climbed = DriveControl(), False
    for word, command in story:
        control.follow(word)
        sent = control.controlword(command)
        assert sent & FAULT_RESET == 0
        if command == SAFE_COMMAND:
            assert sent == DISABLE_VOLTAGE
            climbed = False
        if sent == SHUTDOWN:
            climbed = True
        if sent == ENABLE_OPERATION:
            assert climbed
            assert command.bridge
            assert state_of(word) in {DriveState.SWITCHED_ON, DriveState.ENABLED}
