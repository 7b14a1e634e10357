"""A session of a day at 120 Hz: its size, its check, its figure, and the memory of its recorder.

The rows are simulated and go through the pipe of a real recorder process as fast as it takes them.
A daemon with a recorder of its own runs beside it in real time, and its memory is compared between
the first minute and the end. Check and figure are then run alone.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec

from adaptdrive.recording.batches import Batch, Header, News, framed
from adaptdrive.recording.reader import read_session
from adaptdrive.recording.segments import segments
from adaptdrive.recording.session import session_directories
from tests.benchmarks.day_material import CONFIG, STRETCH_s, repeated, stretch
from tests.benchmarks.rows import Extent, Row
from tests.benchmarks.site import await_broker, broker, enable, start_daemon
from tests.benchmarks.tools import BUSY, PRIORITY, bus_ports, process
from tests.recording.material import INFO
from tests.support import children, resident_MiB

HOURS = 24
LARGEST_MB, VERIFY_s, PLOT_s = 600.0, 30.0, 5.0
GROWTH_MiB = 10.0
SETTLED_s = 60.0
_TRIAL_s = 20 * 60


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


class Growth:
    """Largest resident memory of a process, early and over all."""

    def __init__(self, pid: int) -> None:
        self._pid = pid
        self._early = self._most = 0.0

    def look(self, *, early: bool) -> None:
        """Measure it now."""
        now = resident_MiB(self._pid)
        self._most = max(self._most, now)
        if early:
            self._early = self._most

    def row(self, name: str, note: str, *, judged: bool) -> Row:
        """Return the row; a short run, whose first part closed no segment, is not judged."""
        target = f"at most {GROWTH_MiB:g} MiB more than early"
        met = self._most - self._early <= GROWTH_MiB
        return Row(
            name, self._most, "MiB", self._early, "early", target, met if judged else None, note
        )


def rows(extent: Extent) -> Iterator[Row]:
    """All rows of this file."""
    hours = 2 if extent.quick else HOURS
    with TemporaryDirectory() as name:
        folder = Path(name)
        batches = stretch(STRETCH_s)
        yield from _recorded(folder, batches, hours)
        (session,) = session_directories(folder / "sessions")
        yield from _read(session, hours)


def _recorded(folder: Path, batches: list[Batch], hours: int) -> Iterator[Row]:
    """Record the session with a daemon beside it; what both take."""
    segment_s = _segment_s(folder / "trial", batches)
    with ExitStack() as stack:
        daemon = Growth(_daemon(folder, stack))
        recorder: Growth | None = None
        began_s = time.monotonic()
        for second, pid in _feed(folder / "sessions", batches, hours * 3600, segment_s):
            if second % 600 == 0:
                recorder = recorder or Growth(pid)
                recorder.look(early=second <= hours * 900)
                daemon.look(early=time.monotonic() - began_s < SETTLED_s)
        passed_s = time.monotonic() - began_s
    if recorder is not None:
        note = f"{hours} h at {hours * 3600 / passed_s:.0f} times real time"
        yield recorder.row(
            "largest memory of the recorder",
            f"{note}, early: the first quarter",
            judged=hours == HOURS,
        )
    note = f"{passed_s / 60.0:.1f} min, early: the first {SETTLED_s:g} s"
    judged = passed_s > 2.0 * SETTLED_s
    yield daemon.row("largest memory of a daemon in real time", note, judged=judged)


def _segment_s(folder: Path, batches: list[Batch]) -> float:
    """Return how long this recorder takes for an hour of rows."""
    began_s = ended_s = time.monotonic()
    for second, _ in _feed(folder, batches, _TRIAL_s, 3600.0):
        if second == _TRIAL_s // 4:
            began_s = time.monotonic()
        ended_s = time.monotonic()
    return max(1.0, (ended_s - began_s) * 3600.0 / (0.75 * _TRIAL_s))


def _feed(
    sessions: Path, batches: list[Batch], seconds: int, segment_s: float
) -> Iterator[tuple[int, int]]:
    """Record a session; yield each second that is on disk, and the recorder's process id."""
    info = msgspec.structs.replace(INFO, output_unit="V")
    text = CONFIG.read_text(encoding="utf-8")
    header = Header(info, text, str(sessions), segment_s=segment_s)
    command = [sys.executable, "-m", "adaptdrive.recording.writer", str(sessions)]
    offset_s = info.started.timestamp()
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=BUSY
    ) as recorder:
        assert recorder.stdin is not None
        assert recorder.stdout is not None
        with closing(recorder.stdin) as pipe:
            pipe.write(framed(header))
            for batch in repeated(batches, seconds, offset_s):
                pipe.write(framed(batch))
                pipe.flush()
                if batch.number > 10:  # a few are always under way
                    yield _written(recorder), recorder.pid
        recorder.stdout.read()
    if recorder.returncode:
        raise RuntimeError(f"the recorder ended with status {recorder.returncode}")


def _written(recorder: subprocess.Popen[bytes]) -> int:
    """Wait for the next second that is on disk."""
    while recorder.stdout is not None and (line := recorder.stdout.readline()):
        if number := msgspec.json.decode(line, type=News).written:
            return number
    raise RuntimeError("the recorder has ended")


def _daemon(folder: Path, stack: ExitStack) -> int:
    """Start a daemon whose drive runs; return its process id."""
    _, broker_port = stack.enter_context(broker(folder))
    (bus_port,) = bus_ports(1)
    running = start_daemon(stack, folder / "daemon", bus_port, broker_port, {})
    await_broker(running)
    words = [str(bus_port), str(PRIORITY + 10), str(folder / "late")]
    stack.enter_context(process([sys.executable, "-m", "tests.benchmarks.player", *words]))
    enable(running)
    if not children(running.daemon.pid):
        raise RuntimeError("the daemon records nothing")
    return running.daemon.pid


def _read(session: Path, hours: int) -> Iterator[Row]:
    share = hours / HOURS
    size = sum(path.stat().st_size for path in session.rglob("*") if path.is_file()) / 1e6
    parts = len(segments(session, "ticks"))
    note = f"{read_session(session).info.ended}, {parts} segments of ticks"
    target = f"less than {LARGEST_MB * share:g}"
    met = size < LARGEST_MB * share
    yield Row(f"size of {hours} h at 120 Hz", size, "MB", target=target, met=met, note=note)
    for words, limit_s in ((("sessions", "verify"), VERIFY_s), (("plot",), PLOT_s)):
        run = _run(*words, str(session))
        note = f"{run.cpu_s:.1f} s of processor time, {run.MiB:.0f} MiB"
        target, met = f"less than {limit_s:g} s", run.wall_s < limit_s
        yield Row(f"`{words[-1]}` of it", run.wall_s, "s", target=target, met=met, note=note)


def _run(*words: str) -> Run:
    began_s = time.monotonic()
    command = [sys.executable, "-m", "adaptdrive.cli", *words]
    with subprocess.Popen(command, env=BUSY, stdout=subprocess.DEVNULL) as one:
        _, status, usage = os.wait4(one.pid, 0)
        one.returncode = os.waitstatus_to_exitcode(status)
    if one.returncode:
        raise RuntimeError(f"{' '.join(words)} ended with status {one.returncode}")
    cpu_s = usage.ru_utime + usage.ru_stime
    return Run(time.monotonic() - began_s, cpu_s, usage.ru_maxrss / 1024.0)
