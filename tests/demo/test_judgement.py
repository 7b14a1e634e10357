"""What counts as control that worked."""

from __future__ import annotations

from datetime import timedelta

import msgspec
import numpy as np
import pytest
from scipy import signal

from adaptdrive.watch.plot import PlotPoint
from adaptdrive_sim.demo.judgement import ideal_response, shortcomings, tracking_error
from adaptdrive_sim.demo.record import DemoRecord
from tests.demo.stories import BEGAN, Clock, drive, event, load, state, steady_record


def square_wave(periods: int) -> list[float]:
    return [3.2 if (k // 30) % 2 == 0 else 3.0 for k in range(periods)]


def test_the_ideal_response_has_four_poles_and_no_error_at_rest() -> None:
    references = [3.0, *square_wave(119)]
    points = [PlotPoint(float(k), reference, 3.0) for k, reference in enumerate(references)]
    # The same loop as a transfer function, by an independent filter.
    denominator = np.poly([0.7] * 4)
    numerator = np.array([0.0, 1.0, 0.93]) * denominator.sum() / 1.93
    expected = 3.0 + signal.lfilter(numerator, denominator, np.array(references) - 3.0)
    # The filter answers to r[k-1]; the loop does so too, from the second sample on.
    found = ideal_response(points, 0.7)
    assert found[1:] == pytest.approx(expected[1:].tolist(), abs=1e-9)


def test_a_drive_that_is_held_has_no_shortcoming() -> None:
    record = steady_record(30)
    assert list(shortcomings(record)) == []
    assert tracking_error(record) == pytest.approx(0.0, abs=1e-12)


def test_a_drive_that_stays_away_from_its_set_point_fails() -> None:
    record = steady_record(60, output=2.9, reference=3.0)
    assert any("from where it should be" in text for text in shortcomings(record))


def test_a_speed_that_does_not_answer_to_the_wave_fails() -> None:
    record = steady_record(1)
    for k, reference in enumerate(square_wave(120)):
        record.hear_load(load(k + 2, reference, 3.0))
    assert any("from where it should be" in text for text in shortcomings(record))


def test_the_slow_period_that_the_broker_kept_of_an_earlier_run_is_ignored() -> None:
    record = DemoRecord(BEGAN, Clock())
    earlier = msgspec.structs.replace(load(40, 3.2, 2.9), time=BEGAN - timedelta(seconds=1))
    record.hear_load(earlier)
    assert record.load is None
    assert record.slow_periods == 0


def test_counting_begins_with_the_first_report_under_control() -> None:
    record = DemoRecord(BEGAN, Clock())
    record.hear_drive(drive(100))
    record.hear_state(state())
    assert record.control is None
    record.hear_drive(drive(112))
    record.hear_drive(drive(124))
    assert record.control is not None
    assert record.control.ticks == 12


def test_a_drive_that_never_ran_fails() -> None:
    assert list(shortcomings(DemoRecord(BEGAN, Clock()))) == ["the drive never ran"]


def test_a_drive_without_a_decision_fails_in_words() -> None:
    record = steady_record(30)
    record.slow.clear()
    (found,) = shortcomings(record)
    assert found == "the controller has not decided yet, so that nothing was controlled"


def test_a_trip_fails_even_when_it_was_reset() -> None:
    record = steady_record(30)
    record.hear_event(event("over-voltage: 440 V", "trip", "alarm"))
    assert list(shortcomings(record)) == ["tripped: over-voltage: 440 V"]


def test_a_drive_in_standby_at_the_end_fails() -> None:
    record = steady_record(30)
    record.hear_state(state(state="standby"))
    assert any("standby" in text for text in shortcomings(record))


def test_lost_ticks_fail() -> None:
    record = steady_record(30)
    record.hear_drive(drive(100 + 120 * 25))  # five of thirty seconds are missing
    assert list(shortcomings(record)) == ["only 3000 of 3600 ticks were run"]


def test_a_state_from_an_earlier_daemon_is_not_believed() -> None:
    record = DemoRecord(BEGAN, Clock())
    record.hear_state(state(time=BEGAN.replace(hour=11)))
    assert not record.running
