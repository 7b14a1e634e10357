"""The long forms of the tests: `python -m tests.proof PAGE` runs them and writes a page.

What a form prints is on the page, with the date, the commit and the machine. A form that fails is
on it too, and makes the run fail.
"""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import time
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

SEEDS = os.environ.get("SEEDS", "20")


@dataclass(frozen=True)
class Form:
    """A long form.

    Attributes:
        title: Its section of the page.
        command: Arguments of the interpreter.
        environment: What makes it long.
        as_table: Whether its output is Markdown already.
    """

    title: str
    command: tuple[str, ...]
    environment: dict[str, str] = field(default_factory=dict)
    as_table: bool = False


FORMS = (
    Form("Faults of sensors, plants, actuators, drives, links and clocks",
         ("-m", "tests.faults.table", SEEDS), as_table=True),
    Form("Stories that must energise nothing",
         ("-m", "pytest", "-q", "tests/faults/test_energised.py", "--timeout", "7200"),
         {"STORIES": "5000"}),
    Form("Damaged inputs of each decoder", ("-m", "tests.fuzz", "1000000")),
    Form("A drive of foreign code", ("-m", "pytest", "-q", "tests/peers")),
    Form("Sensors that lie", ("-m", "tests.closed_loop.deceived", SEEDS)),
    Form("Processes killed at random moments", ("-m", "tests.benchmarks", "--only", "kills")),
)  # fmt: skip


def main() -> int:
    """Run all forms; 1 when one of them failed."""
    page, failed = Path(sys.argv[1]), 0
    parts = [_head()]
    for form in FORMS:
        began_s = time.monotonic()
        text, status = _run(form)
        failed |= status != 0
        parts.append(_section(form, text, status, time.monotonic() - began_s))
        page.write_text("\n".join(parts), encoding="utf-8")
    return failed


def _run(form: Form) -> tuple[str, int]:
    """What a form prints, and its exit status."""
    done = subprocess.run(
        [sys.executable, *form.command],
        stdout=subprocess.PIPE,
        env=os.environ | form.environment,
        text=True,
        check=False,
    )
    return done.stdout.strip(), done.returncode


def _head() -> str:
    git = ["git", "describe", "--always", "--dirty"]
    commit = subprocess.run(git, capture_output=True, text=True, check=False).stdout.strip()
    day = datetime.now(tz=UTC).strftime("%Y-%m-%d %H:%M UTC")
    machine = (
        f"{os.cpu_count()} processors, {platform.platform()}, Python {platform.python_version()}"
    )
    return f"# Proof\n\nWritten by `make proof` on {day}, commit {commit}, {machine}.\n"


def _section(form: Form, text: str, status: int, took_s: float) -> str:
    setting = "".join(f"{name}={value} " for name, value in form.environment.items())
    command = f"`{setting}python {' '.join(form.command)}`"
    verdict = "passed" if status == 0 else f"FAILED with status {status}"
    body = text if form.as_table else f"```\n{text[-4000:]}\n```"
    return f"## {form.title}\n\n{command}: {verdict}, {took_s / 60.0:.1f} min.\n\n{body}\n"


if __name__ == "__main__":
    raise SystemExit(main())
