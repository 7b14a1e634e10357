"""`make bench`, `make board` and the long measurements can be run: their shortest forms."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tools.benchmarks import board
from tools.benchmarks.__main__ import PARTS
from tools.benchmarks.paired import __main__ as paired
from tools.benchmarks.paired.pairs import BUSY, Effort
from tools.builds.run import PURE, ROOT

ABSENT = ("is missing", "no compiled wheel", "No such file or directory: 'cyclictest'")
"""What a machine without a program of Debian, or without a C compiler, cannot measure."""

LONG = {"day", "equality"}
"""Parts that take minutes in their shortest form, too."""


def run(*words: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", *words]
    return subprocess.run(
        command, check=False, capture_output=True, text=True, cwd=ROOT, timeout=800
    )


@pytest.mark.slow
@pytest.mark.proof
@pytest.mark.parametrize("part", [part for part in PARTS if part not in LONG])
def test_each_part_is_measured(part: str, tmp_path: Path) -> None:
    output = tmp_path / "measured.json"
    done = run("tools.benchmarks", "--shortest", "--only", part, "--output", output)
    if any(one in done.stderr for one in ABSENT):
        pytest.skip(done.stderr.strip().splitlines()[-1])
    assert done.returncode == 0, done.stderr
    assert json.loads(output.read_text(encoding="utf-8"))["rows"]


@pytest.mark.slow
@pytest.mark.proof
@pytest.mark.parametrize("part", list(paired.BOXES_S))
def test_a_bench_of_few_turns_writes_its_table_and_tells_nothing(part: str, tmp_path: Path) -> None:
    output, page = tmp_path / "bench.json", tmp_path / "page.md"
    page.write_text("before\n{}stale\n{}after\n".format(*paired.MARKS), encoding="utf-8")
    words = ("--only", part, "--turns", "2", "--turn-s", "0.5", "--output", output)
    done = run("tools.benchmarks.paired", *words, "--write-page", page)
    assert done.returncode == 0, done.stderr
    rows = json.loads(output.read_text(encoding="utf-8"))["rows"]
    assert rows
    assert all(turn["ours"] > 0.0 for row in rows for turn in row["turns"])
    text = page.read_text(encoding="utf-8")
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert "stale" not in text
    for row in rows:
        assert f"| {row['name']} | {row['against']} | {BUSY} |" in text


def test_a_part_that_takes_too_long_is_no_failure() -> None:
    failures: list[str] = []
    rows = list(paired.measured({"steps": 0.05}, Effort(2, 0.5), failures))
    assert {(row.name, row.cell) for row in rows} == {("steps", "not measured within 0.05 s")}
    assert failures == []


@pytest.mark.slow
@pytest.mark.proof
def test_a_daemon_runs_on_a_tenth_of_a_processor() -> None:
    done = run("tools.benchmarks.board", "--seconds", "2", "--build", PURE)
    assert done.returncode == 0, done.stderr
    for drive in board.DRIVES:
        assert f"| {drive.rate} | " in done.stdout
