"""One course for each fault: safe within its bound, the right cause, and a way back.

`make proof` runs each on all loads with twenty seeds and writes the table.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

from adaptdrive.runtime.requests import Enable
from adaptdrive.util.quantity import MEASURED
from tests.integration.faults.course import Course
from tests.integration.faults.judge import judge
from tests.integration.faults.rows import QUICK, ROWS, Row

SEED = 3


def _load_of(row: Row) -> str:
    """A load of which a course takes less than a second; other rows have other ones."""
    quick = [name for name in row.loads if name in QUICK] or list(row.loads)
    return quick[ROWS.index(row) % len(quick)]


@pytest.mark.parametrize("row", ROWS, ids=[f"{row.group}: {row.fault}" for row in ROWS])
def test_a_fault_is_safe_in_time_and_named_or_ridden_through(row: Row) -> None:
    verdict = judge(row, _load_of(row), SEED)
    assert verdict is not None
    assert verdict.flaws == ()


@pytest.mark.parametrize("value", [-1e200, 1e200])
@pytest.mark.parametrize("quantity", MEASURED)
@pytest.mark.parametrize("name", ["motor, CAN", "bath, Modbus", "battery, CAN"])
def test_a_number_that_no_drive_measures_ends_no_daemon(
    name: str, quantity: str, value: float
) -> None:
    course = Course(name, SEED)
    course.run(3.0)
    assert course.daemon.accepts(Enable())
    course.run(3.0)
    course.frame = lambda reading: replace(reading, **{quantity: value})  # type: ignore[arg-type]
    course.run(3.0)
    assert not (course.daemon.trip or "").startswith("internal error")
