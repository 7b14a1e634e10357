"""The compiled modules against their sources, to the last bit; runs where both are at hand."""

from __future__ import annotations

from pathlib import Path

import pytest

from adaptdrive.pure import build_name
from tests.builds.run import BUILDS, COMPILED, run_with

pytestmark = [
    pytest.mark.calculating,
    pytest.mark.skipif(build_name() != COMPILED, reason="only the sources are here"),
]

SHARE = 0.2
"""Share of the length of a session: six slow periods of the bath."""


@pytest.mark.parametrize("recorder", BUILDS)
def test_a_session_of_either_build_replays_bit_equal_with_the_other(
    recorder: str, tmp_path: Path
) -> None:
    (player,) = set(BUILDS) - {recorder}
    run_with(recorder, "tests.builds.sessions", "record", tmp_path, SHARE)
    assert run_with(player, "tests.builds.sessions", "replay", tmp_path)


def test_campaign_runs_are_bit_equal() -> None:
    compiled, pure = (run_with(one, "tests.builds.trajectories", 1, 3, 240.0) for one in BUILDS)
    assert len(set(compiled)) == 3
    assert compiled == pure
