"""The compiled modules against their sources, to the last bit, where both are at hand."""

from __future__ import annotations

from pathlib import Path

import pytest

from adaptdrive import build_name
from tools.builds.run import BUILDS, COMPILED, PURE, run_with

pytestmark = pytest.mark.usefixtures("outside")

needs_both = pytest.mark.skipif(build_name() != COMPILED, reason="only the sources are here")

SHARE = 0.2
"""Share of the length of a session: six slow periods of the bath."""


@pytest.mark.parametrize(
    ("recorder", "player"),
    [
        (PURE, PURE),
        pytest.param(PURE, COMPILED, marks=needs_both),
        pytest.param(COMPILED, PURE, marks=needs_both),
    ],
)
def test_a_session_of_one_build_replays_bit_equal_with_another(
    recorder: str, player: str, tmp_path: Path
) -> None:
    run_with(recorder, "tools.builds.sessions", "record", tmp_path, SHARE)
    assert run_with(player, "tools.builds.sessions", "replay", tmp_path)


@needs_both
def test_campaign_runs_are_bit_equal() -> None:
    compiled, pure = (run_with(one, "tools.builds.trajectories", 1, 3, 240.0) for one in BUILDS)
    assert len(set(compiled)) == 3
    assert compiled == pure
