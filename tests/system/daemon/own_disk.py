"""A file system of its own for one test or benchmark, whose writes can be made to wait."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

_BYTES = 24 << 20
_PROGRAMS = ("mkfs.ext4", "mount", "umount", "fsfreeze", "chattr")
_PATH = f"{os.environ['PATH']}:/usr/sbin"


@contextlib.contextmanager
def mounted(folder: Path, size: int = _BYTES) -> Iterator[Path | None]:
    """An ext4 file system, None where none can be mounted.

    Args:
        folder: Takes its image and its mount point.
        size: In bytes.
    """
    image, point = folder / "disk.img", folder / "disk"
    point.mkdir()
    with image.open("wb") as file:
        file.truncate(size)
    if not (
        all(shutil.which(program, path=_PATH) for program in _PROGRAMS)
        and run_privileged("mkfs.ext4", "-q", "-F", image)
        and run_privileged("mount", "-o", "loop", image, point)
    ):
        yield None
        return
    try:
        yield point
    finally:
        run_privileged("umount", "--lazy", point)


@contextlib.contextmanager
def stalled(disk: Path) -> Iterator[None]:
    """Each write waits."""
    assert run_privileged("fsfreeze", "--freeze", disk)
    try:
        yield
    finally:
        assert run_privileged("fsfreeze", "--unfreeze", disk)


def run_privileged(*command: str | Path) -> bool:
    """Run a program that may be in `/usr/sbin`; whether it succeeded."""
    done = subprocess.run(command, capture_output=True, check=False, env={"PATH": _PATH})
    return done.returncode == 0
