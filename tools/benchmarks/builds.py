"""The compiled modules against their sources: the same benchmarks with one and the other, in turn.

Needs the wheel of `make compiled`.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any
from zipfile import ZipFile

from tools.benchmarks.rows import Extent, Row
from tools.builds.run import BUILDS, COMPILED, PURE, ROOT, environment

PARTS = ("compute", "path", "daemon", "turnaround")
ROUNDS = 3

Runs = dict[tuple[str, str], dict[str, list[dict[str, Any]]]]
"""Rows by name and reference, and by build."""


def rows(extent: Extent) -> Iterator[Row]:
    """All rows of this file."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        path = unpacked(folder)
        for part in extent.pick(PARTS, PARTS, PARTS[1:2]):
            try:
                runs = _in_turn(part, extent.pick(ROUNDS, 1, 1), path, folder / "bench.json")
            except RuntimeError as problem:
                sys.stderr.write(f"{part}: not measured: {problem}\n")
                continue
            yield from _compared(runs)


def _in_turn(part: str, rounds: int, path: Path, output: Path) -> Runs:
    """Run a part with each build in turn."""
    runs: Runs = {}
    for _ in range(rounds):
        for build in BUILDS:
            for row in measured(part, build, path, output):
                places = runs.setdefault((row["name"], row["against"]), {})
                places.setdefault(build, []).append(row)
    return runs


def unpacked(folder: Path) -> Path:
    """Unpack the compiled wheel; return the folder that PYTHONPATH must name.

    Raises:
        RuntimeError: There is none for this Python.
    """
    tag = f"cp{sys.version_info.major}{sys.version_info.minor}"
    wheels = sorted((ROOT / "build" / "compiled").glob(f"*-{tag}-*.whl"))
    if not wheels:
        raise RuntimeError(f"no compiled wheel of {tag}: make compiled")
    with ZipFile(wheels[-1]) as wheel:
        wheel.extractall(folder / "wheel")
    return folder / "wheel"


def measured(
    part: str, build: str, path: Path, output: Path, *, quick: bool = True
) -> list[dict[str, Any]]:
    """Run a part of the benchmarks with a build, and return its rows.

    Args:
        part: One of the parts of `make bench`.
        build: One of `BUILDS`.
        path: Folder of the unpacked wheel.
        output: File that the part writes; it is removed.
        quick: Whether to measure for seconds instead of minutes.

    Raises:
        RuntimeError: It failed, or ran with the other build.
    """
    command = [sys.executable, "-m", "tools.benchmarks", "--only", part]
    done = subprocess.run(
        [*command, *(["--quick"] if quick else []), "--output", output],
        check=False,
        capture_output=True,
        text=True,
        cwd=ROOT,
        env=environment(build) | {"PYTHONPATH": f"{path}:{ROOT}"},
    )
    found = json.loads(output.read_text(encoding="utf-8")) if output.exists() else {"rows": []}
    output.unlink(missing_ok=True)
    if not found["rows"] or found["build"] != build:
        raise RuntimeError(f"{part} with {build}: {done.stderr}")
    return list(found["rows"])


def _compared(runs: Runs) -> Iterator[Row]:
    """Each figure of both builds, and its ratio to the reference of its own run."""
    seen = set()
    for (name, against), by_build in runs.items():
        compiled, pure = by_build.get(COMPILED, []), by_build.get(PURE, [])
        if not (compiled and pure):
            continue
        if name not in seen:
            seen.add(name)
            yield Row(
                name, _median(compiled, "ours"), compiled[0]["unit"], _median(pure, "ours"), PURE
            )
        if against:
            label = f"{name} over {against}"
            yield Row(label, _median(compiled, "ratio"), "x", _median(pure, "ratio"), PURE)


def _median(found: list[dict[str, Any]], field: str) -> float:
    return float(median(row[field] for row in found))
