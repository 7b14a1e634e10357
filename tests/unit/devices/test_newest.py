"""The newest good value of each quantity, on whatever bus it came."""

from __future__ import annotations

import pytest

from adaptdrive.devices.description import Source
from adaptdrive.devices.field import Field
from adaptdrive.devices.port import NewestValues
from adaptdrive.safety.facts import FaultWord

WORD = FaultWord("State", -1, {2: "hot"})
FIELD = Field("Any", 0, 1, integer=True)
GOOD = {"output": 2.5, "boost_voltage_V": 300.0, "bridge": 1.0, "counter": 7.0, "fault": 0.0}


def unknown(**slacks: float) -> NewestValues:
    """The values of a drive of which none has come."""
    return NewestValues(
        [
            Source(
                name,
                None,
                FIELD,
                1.0,
                0.0,
                None,
                "",
                word=WORD if name == "fault" else None,
                slack_s=slacks.get(name, 0.0),
            )
            for name in GOOD
        ]
    )


def known(**slacks: float) -> NewestValues:
    """The values of a drive of which every quantity has been good once, at 1 s."""
    newest = unknown(**slacks)
    newest.keep(GOOD, 1.0)
    return newest


def test_there_is_no_reading_before_every_quantity_has_been_good_once() -> None:
    assert known().reading(1.0) is not None
    blind = unknown()
    blind.keep({name: value for name, value in GOOD.items() if name != "output"}, 1.0, ["output"])
    assert blind.reading(1.0) is None


def test_a_refused_value_leaves_the_last_good_one_which_ages() -> None:
    newest = known()
    for taken_s in (2.0, 3.0):
        newest.keep({"boost_voltage_V": 301.0, "bridge": 0.0}, taken_s, ["output"])
    reading = newest.reading(3.0)
    assert reading is not None
    assert (reading.output, reading.oldest_s, reading.whole) == (2.5, 1.0, False)
    assert (reading.boost_voltage_V, reading.bridge, reading.bridge_s) == (301.0, False, 3.0)
    assert newest.oldest()[:2] == ("output", 1.0)
    newest.keep(GOOD, 4.0)
    reading = newest.reading(4.0)
    assert reading is not None
    assert (reading.oldest_s, reading.whole) == (4.0, True)


def test_a_held_counter_is_none() -> None:
    """The same count again would be that of a drive that hangs."""
    newest = known()
    newest.keep({"output": 2.5}, 2.0, ["counter"])
    reading = newest.reading(2.0)
    assert reading is not None
    assert reading.counter is None


@pytest.mark.parametrize(
    ("slacks", "oldest_s", "slack_s"), [({}, 1.0, 0.0), ({"output": 5.0}, 2.0, 0.0)]
)
def test_a_reading_is_as_old_as_the_value_that_is_out_of_date_first(
    slacks: dict[str, float], oldest_s: float, slack_s: float
) -> None:
    newest = known(**slacks)
    newest.keep({name: value for name, value in GOOD.items() if name != "output"}, 2.0)
    reading = newest.reading(2.0)
    assert reading is not None
    assert (reading.oldest_s, reading.slack_s) == (oldest_s, slack_s)


def test_a_report_of_the_bridge_of_the_same_set_has_no_time_of_its_own() -> None:
    newest = known()
    newest.keep(GOOD, 2.0)
    together = newest.reading(2.1, set_s=2.0)
    newest.keep(GOOD, 3.0)
    newest.keep({}, 4.0, ["bridge"])
    apart = newest.reading(4.1, set_s=4.0)
    assert together is not None
    assert apart is not None
    assert (together.bridge_s, together.bridge_reported_s) == (None, 2.0)
    assert (apart.bridge_s, apart.bridge_reported_s) == (3.0, 3.0)


def test_a_forgotten_report_of_the_bridge_is_awaited() -> None:
    newest = known()
    newest.forget("bridge")
    assert newest.reading(2.0) is None
    newest.keep({"bridge": 0.0}, 2.0)
    reading = newest.reading(2.0)
    assert reading is not None
    assert (reading.bridge, reading.oldest_s) == (False, 1.0)


def test_a_fault_stays_until_its_word_is_good_again() -> None:
    newest = known()
    newest.keep({"fault": 2.0}, 2.0)
    found = []
    for step in range(3):
        newest.keep({"fault": 0.0} if step == 2 else {}, 3.0, [] if step == 2 else ["fault"])
        reading = newest.reading(3.0)
        assert reading is not None
        found.append((reading.fault, reading.fault_name))
        newest.faults.clear(reading.fault)
    assert found == [(2, "State bit 1 hot"), (2, "State bit 1 hot"), (0, "")]
