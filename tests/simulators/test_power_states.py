"""The drive's side of CiA 402, held against the tables of the canopen library."""

from __future__ import annotations

import pytest
from canopen.profiles.p402 import State402
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive_sim.devices.power_states import PowerState, PowerStates

NAMES = {
    PowerState.SWITCH_ON_DISABLED: "SWITCH ON DISABLED",
    PowerState.READY: "READY TO SWITCH ON",
    PowerState.SWITCHED_ON: "SWITCHED ON",
    PowerState.ENABLED: "OPERATION ENABLED",
    PowerState.FAULT: "FAULT",
}
STATES = {name: state for state, name in NAMES.items()}
STEPS = [
    (start, end, word)
    for (start, end), word in State402.TRANSITIONTABLE.items()
    if start in STATES and end in STATES and start != "FAULT"
]


@pytest.mark.parametrize("state", PowerState)
def test_a_statusword_says_its_state(state: PowerState) -> None:
    mask, bits = State402.SW_MASK[NAMES[state]]
    assert state & mask == bits


@pytest.mark.parametrize(("start", "end", "word"), STEPS)
def test_each_transition_of_the_library_is_made(start: str, end: str, word: int) -> None:
    power = PowerStates()
    power.state = STATES[start]
    power.obey(word, healthy=True)
    assert power.state is STATES[end]


def test_a_fault_is_left_by_an_edge_once_its_cause_is_gone() -> None:
    power = PowerStates()
    power.obey(0x80, healthy=True)
    power.fail()
    power.obey(0x80, healthy=True)  # up since before the fault: no edge
    assert power.state.name == "FAULT"
    power.obey(0x00, healthy=True)
    power.obey(0x80, healthy=False)
    assert power.state.name == "FAULT"
    power.obey(0x00, healthy=True)
    power.obey(0x80, healthy=True)
    assert power.state.name == "SWITCH_ON_DISABLED"


@given(st.lists(st.integers(0, 0xFFFF)))
def test_no_word_enables_a_drive_at_once(words: list[int]) -> None:
    power = PowerStates()
    for word in words:
        before = power.state
        power.obey(word, healthy=True)
        if power.state is PowerState.ENABLED:
            assert before in {PowerState.SWITCHED_ON, PowerState.ENABLED}
