"""One course for each fault: safe within its bound, the right cause, and a way back.

`make proof` runs each on all loads with twenty seeds and writes the table.
"""

from __future__ import annotations

import pytest

from tests.faults.judge import judge
from tests.faults.rows import QUICK, ROWS, Row

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
