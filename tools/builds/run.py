"""Programs run with one of two builds: the compiled modules at hand, or their sources."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from zipfile import ZipFile

ROOT = Path(__file__).parents[2]
COMPILED, PURE = "compiled", "pure Python"
BUILDS = (COMPILED, PURE)


def environment(build: str) -> dict[str, str]:
    """Return the environment in which a program runs with a build."""
    return {**os.environ, "ADAPTDRIVE_PURE": "1" if build == PURE else "0"}


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


def environments(folder: Path) -> dict[str, dict[str, str]]:
    """Return the environment of each build at hand: of the sources, and of a compiled wheel.

    Args:
        folder: Where the wheel is unpacked.
    """
    found = {PURE: environment(PURE) | {"PYTHONPATH": f"{ROOT}/src:{ROOT}/simulators:{ROOT}"}}
    try:
        path = f"{unpacked(folder)}:{ROOT}"
    except RuntimeError as absent:
        sys.stderr.write(f"the sources alone: {absent}\n")
        return found
    return found | {COMPILED: environment(COMPILED) | {"PYTHONPATH": path}}


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
