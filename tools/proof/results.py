"""What each form gave when it ran last, as one JSON file for each in `tools/proof/results`."""

from __future__ import annotations

import dataclasses
import json
import os
import platform
import resource
import subprocess
import sys
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from tools.proof.forms import Form

RESULTS = Path(__file__).parent / "results"
KEPT = 6000
"""Characters of output that are kept of a form that prints no table."""


@dataclass(frozen=True, slots=True)
class Result:
    """One run of a form.

    Attributes:
        name: Of the form.
        command: What was run.
        status: Exit status.
        day: Date and time of its end, UTC.
        commit: Of the checkout.
        machine: Processors, system, interpreter.
        processor_min: Processor time in minutes, None where it was not measured.
        text: What it printed.
    """

    name: str
    command: str
    status: int
    day: str
    commit: str
    machine: str
    processor_min: float | None
    text: str


def run(form: Form) -> Result:
    """Run a form and return its result."""
    before_s = _processor_s()
    done = subprocess.run(
        [sys.executable, *form.command],
        stdout=subprocess.PIPE,
        env=os.environ | form.environment,
        text=True,
        check=False,
    )
    text = done.stdout.strip()
    return Result(
        name=form.name,
        command=form.shown_command,
        status=done.returncode,
        day=datetime.now(tz=UTC).strftime("%Y-%m-%d %H:%M"),
        commit=commit(),
        machine=machine(),
        processor_min=round((_processor_s() - before_s) / 60.0, 1),
        text=text if form.as_table else text[-KEPT:],
    )


def _processor_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def commit() -> str:
    """Return the commit that changed the measured code last; `-changed` marks what has none yet."""
    git, measured = ["git", "-C", str(RESULTS.parent)], [":/src", ":/simulators", ":/deploy"]
    head = subprocess.check_output([*git, "log", "-1", "--format=%h", "--", *measured], text=True)
    status = subprocess.check_output([*git, "status", "--porcelain", "--", *measured], text=True)
    return head.strip() + ("-changed" if status else "")


def machine() -> str:
    """Return processors, system and interpreter, without a name of the machine."""
    kernel = platform.release().partition("-")[0]
    return (
        f"{os.cpu_count()} processors ({platform.machine()}), {platform.system()} {kernel}, "
        f"Python {platform.python_version()}"
    )


def save(result: Result, folder: Path = RESULTS) -> None:
    """Keep a result in place of the one before it."""
    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps(dataclasses.asdict(result), indent=1, ensure_ascii=False)
    (folder / f"{result.name}.json").write_text(text + "\n", encoding="utf-8")


def load(name: str, folder: Path = RESULTS) -> Result | None:
    """Return the last result of a form, None where it has never run."""
    path = folder / f"{name}.json"
    return Result(**json.loads(path.read_text(encoding="utf-8"))) if path.exists() else None
