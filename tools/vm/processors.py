"""The share of the processors that a process got, of what it asked for.

Linux counts for each thread how long it ran and how long it was ready to run but had to wait
(`schedstat`, documentation of the kernel, "Scheduler Statistics").
"""

from __future__ import annotations

import subprocess
from pathlib import Path

LEAST_SHARE = 0.6
"""Beside the calculating tests, which have a lower priority, a virtual machine gets more; beside as
many busy processes of its own priority as there are processors it gets half, and time-outs pass."""

_LOOK_S = 1.0

_BUSY_S = 900.0
"""Longest life with less than the least share: three times the life on a quiet machine."""


def wait(process: subprocess.Popen[bytes], timeout_s: float) -> float:
    """Wait for the end of a process, and return the share that it got.

    Args:
        process: The process; it is killed when it has not ended in time, when it gets too little
            for too long, and when an error ends the wait.
        timeout_s: How long to wait at most, in seconds.

    Returns:
        Time for which its threads ran over time for which they wanted to run, 0 to 1; as last seen
        before its end, 1 where nothing was seen.
    """
    share = 1.0
    try:
        for look in range(round(timeout_s / _LOOK_S)):
            share = _share(process.pid, share)
            starved = share < LEAST_SHARE and look * _LOOK_S > _BUSY_S
            if starved or _has_ended(process):
                break
    finally:
        process.kill()
        process.wait()
    return share


def _has_ended(process: subprocess.Popen[bytes]) -> bool:
    try:
        process.wait(_LOOK_S)
    except subprocess.TimeoutExpired:
        return False
    return True


def _share(pid: int, before: float) -> float:
    ran_ns = wanted_ns = 0
    for counts in Path(f"/proc/{pid}/task").glob("*/schedstat"):
        ran, waited, _ = map(int, _read(counts).split() or (0, 0, 0))
        ran_ns, wanted_ns = ran_ns + ran, wanted_ns + ran + waited
    return ran_ns / wanted_ns if wanted_ns else before


def _read(file: Path) -> str:
    try:
        return file.read_text(encoding="ascii")
    except (FileNotFoundError, ProcessLookupError):  # the thread has ended
        return ""
