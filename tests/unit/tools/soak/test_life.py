"""A short life in virtual time: faults, operators and restarts, recorded and replayed."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools.soak.life import Life

QUARTER_s = 900.0


@pytest.mark.proof
def test_a_life_of_faults_is_recorded_whole_and_replays_bit_equal(tmp_path: Path) -> None:
    life = Life(4, tmp_path / "session")
    life.pass_time(QUARTER_s)
    life.close()
    assert [flaw for one in life.sessions for flaw in one.flaws] == []
    assert life.counts["faults"] > 3
    assert life.counts["enabled"] > 3
    assert sum(one.ticks for one in life.sessions) > 100_000


def test_a_tick_that_is_not_recorded_is_found(tmp_path: Path) -> None:
    life = Life(4, tmp_path / "session")
    life.run(10.0)
    life._tape._ticks._items.popleft()
    life.close()
    assert life.sessions[0].flaws
