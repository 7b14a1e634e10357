"""Programs run with one of two builds: the compiled modules at hand, or their sources."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
COMPILED, PURE = "compiled", "pure Python"
BUILDS = (COMPILED, PURE)


def environment(build: str) -> dict[str, str]:
    """Return the environment in which a program runs with a build."""
    return {**os.environ, "ADAPTDRIVE_PURE": "1" if build == PURE else "0"}


def run_with(build: str, module: str, *words: object, **more: str) -> list[str]:
    """Run a module of the tests, and return the lines that it prints after the name of its build.

    Args:
        build: One of `BUILDS`.
        module: The module.
        words: Its arguments.
        more: More of the environment.

    Raises:
        RuntimeError: It failed, or ran with the other build.
    """
    done = subprocess.run(
        [sys.executable, "-m", module, *map(str, words)],
        check=False,
        capture_output=True,
        text=True,
        cwd=ROOT,
        env=environment(build) | more,
    )
    found, *lines = done.stdout.splitlines() or [""]
    if done.returncode or found != build:
        raise RuntimeError(f"{module} with {build}: {found}: {lines} {done.stderr}")
    return lines
