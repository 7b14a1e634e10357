"""Bit-equality of the compiled modules and their sources, over campaign runs and sessions.

Needs the wheel of `make compiled`.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from tools.benchmarks.rows import Extent, Row
from tools.builds.run import BUILDS, COMPILED, PURE, ROOT, run_with, unpacked

BATCH = 50
DURATION_S = 120.0


def rows(extent: Extent) -> Iterator[Row]:
    """All rows of this file."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        path = f"{unpacked(folder)}:{ROOT}"
        yield _runs(extent.pick(20, 1, 1), extent.pick(BATCH, BATCH, 2), path)
        for recorder, player in ((COMPILED, PURE), (PURE, COMPILED)):
            yield _sessions(folder / recorder, recorder, player, path)


def _runs(batches: int, batch: int, path: str) -> Row:
    equal = 0
    for first in range(1, batches * batch, batch):
        words = (first, batch, DURATION_S)
        compiled, pure = (
            run_with(one, "tools.builds.trajectories", *words, PYTHONPATH=path) for one in BUILDS
        )
        equal += sum(one == other for one, other in zip(compiled, pure, strict=True))
    runs = batches * batch
    note = f"of {runs}, each {DURATION_S:g} s: every tick, snapshot and decision"
    return Row("bit-equal campaign runs", equal, "", target="all", met=equal == runs, note=note)


def _sessions(folder: Path, recorder: str, player: str, path: str) -> Row:
    """Record the sessions of every kind with one build, and replay them with the other."""
    run_with(recorder, "tools.builds.sessions", "record", folder, 1.0, PYTHONPATH=path)
    run_with(player, "tools.builds.sessions", "replay", folder, PYTHONPATH=path)
    count = sum(1 for _ in folder.glob("*/*/session.json"))
    name = f"bit-equal sessions, recorded {recorder}, replayed {player}"
    return Row(name, count, "", target="all", met=True, note="every load in every mode")
