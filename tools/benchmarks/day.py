"""A session of a day at 120 Hz: its size, its check, its figure, and the memory of its archiver.

The rows are simulated, and written into a log for which the archiver is run after each hour.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec

from adaptdrive.recording.reader import read_session
from adaptdrive.recording.records import Header
from adaptdrive.recording.session import create_session, session_directories
from tests.unit.recording.material import INFO, Batch, write_log
from tools.benchmarks.day_material import CONFIG, STRETCH_s, repeated, stretch
from tools.benchmarks.rows import Extent, Row
from tools.benchmarks.tools import BUSY

HOURS = 24
LARGEST_MB, VERIFY_s, PLOT_s = 550.0, 2.0, 5.0
ARCHIVER_MiB = 90.0
_FILE_s = 300


@dataclass(frozen=True)
class Run:
    """One command.

    Attributes:
        wall_s: Its duration.
        cpu_s: Processor time.
        MiB: Largest resident memory.
    """

    wall_s: float
    cpu_s: float
    MiB: float


def rows(extent: Extent) -> Iterator[Row]:
    """All rows of this file."""
    hours = extent.pick(HOURS, 2, 1)
    with TemporaryDirectory() as name:
        folder = Path(name)
        runs = list(_recorded(folder, stretch(STRETCH_s), hours))
        most = max(run.MiB for run in runs)
        cpu_s = sum(run.cpu_s for run in runs) / hours
        yield Row(
            "largest memory of the archiver",
            most,
            "MiB",
            target=f"at most {ARCHIVER_MiB:g}",
            met=most <= ARCHIVER_MiB,
            note=f"{cpu_s:.1f} s of processor time for each hour",
        )
        (session,) = session_directories(folder / "sessions")
        yield from _read(session, hours)


def _recorded(folder: Path, batches: list[Batch], hours: int) -> Iterator[Run]:
    """Log a session hour by hour, and run the archiver on each."""
    info = msgspec.structs.replace(INFO, output_unit="V", log="../motor.log")
    header = Header(info, CONFIG.read_text(encoding="utf-8"), sessions="sessions")
    log, sessions = folder / "motor.log", folder / "sessions"
    create_session(sessions, info, header.config_text)
    seconds = repeated(batches, hours * 3600, info.started.timestamp())
    for hour in range(1, hours + 1):
        for _ in range(3600 // _FILE_s):
            write_log(log, header, *islice(seconds, _FILE_s), part=hour)
        yield _run("adaptdrive.recording.archiver", str(log), "10")


def _read(session: Path, hours: int) -> Iterator[Row]:
    share = hours / HOURS
    size = sum(path.stat().st_size for path in session.rglob("*") if path.is_file()) / 1e6
    info = read_session(session).info
    note = f"{info.ended}, {info.segments} segments"
    target = f"less than {LARGEST_MB * share:g}"
    met = size < LARGEST_MB * share
    yield Row(f"size of {hours} h at 120 Hz", size, "MB", target=target, met=met, note=note)
    for words, limit_s in ((("sessions", "verify"), VERIFY_s), (("plot",), PLOT_s)):
        run = _run("adaptdrive.cli", *words, str(session))
        note = f"of processor time; {run.wall_s:.1f} s in all, {run.MiB:.0f} MiB"
        target, met = f"less than {limit_s:g} s", run.cpu_s < limit_s
        yield Row(f"`{words[-1]}` of it", run.cpu_s, "s", target=target, met=met, note=note)


def _run(module: str, *words: str) -> Run:
    began_s = time.monotonic()
    command = [sys.executable, "-m", module, *words]
    with subprocess.Popen(command, env=BUSY, stdout=subprocess.DEVNULL) as one:
        peak_MiB = _peak_MiB(one)
        _, status, usage = os.wait4(one.pid, 0)
        one.returncode = os.waitstatus_to_exitcode(status)
    if one.returncode:
        raise RuntimeError(f"{' '.join(words)} ended with status {one.returncode}")
    cpu_s = usage.ru_utime + usage.ru_stime
    return Run(time.monotonic() - began_s, cpu_s, peak_MiB)


def _peak_MiB(one: subprocess.Popen[bytes]) -> float:
    """Watch a process until it ends; what the kernel counts at its end has this one in it."""
    peak_kB, status = 0, Path(f"/proc/{one.pid}/status")
    while os.waitid(os.P_PID, one.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
        lines = status.read_text(encoding="utf-8").splitlines()
        peak_kB = max([peak_kB, *(int(line.split()[1]) for line in lines if "VmHWM" in line)])
        time.sleep(0.02)
    return peak_kB / 1024.0
