"""The archiver process: writes what the log has into the folders of its sessions, and ends.

The control process runs it, and takes what it reports line by line.

It is started as `python -m adaptdrive.recording.archiver LOG AFTER [--no-figure]`, AFTER
being the time after a trip that belongs to its record, and outlives the daemon that started it.
"""

import asyncio
import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec

from adaptdrive.recording.records import Pace
from adaptdrive.runtime.reports import Event, Severity
from adaptdrive.util.clock import in_thread, now_s
from adaptdrive.util.trends import HealthReport

EVENT_KIND = "recording"
"""Kind of the events about the recorder itself."""

NO_FIGURE = "--no-figure"
"""Word of the command line without which the figure of a trip is drawn."""

_PLOT = ("-m", "adaptdrive.cli", "plot")
_FIGURE_PATIENCE_S = 120.0


# The control process.

Line = tuple[Severity, str, str] | HealthReport
"""What the archiver reports: severity, detail and kind of an event, or the health of the load."""

Report = Callable[[Line], None]


async def run(log: Path, pace: Pace, report: Report, *words: str) -> str:
    """Run the archiver until it ends; it continues where this is cancelled.

    Args:
        log: Folder of the log.
        pace: Time after a trip, and what a thread does first.
        report: Takes what it reports, in the event loop.
        words: More words of its command line.

    Returns:
        Why it failed, empty where it did not.
    """
    loop = asyncio.get_running_loop()
    program = [sys.executable, "-P", "-m", "adaptdrive.recording.archiver"]

    def notify(line: Line) -> None:
        with contextlib.suppress(RuntimeError):  # the loop has ended
            loop.call_soon_threadsafe(report, line)

    def call() -> str:
        pace.start_thread()
        return _run([*program, str(log), str(pace.trip_s), *words], notify)

    try:
        return await asyncio.wrap_future(in_thread(call, "archiver"))
    except (OSError, RuntimeError) as problem:  # no further process or thread
        return str(problem)


def _run(command: Sequence[str], notify: Report) -> str:
    with subprocess.Popen(  # noqa: S603 - this program itself
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        # Ctrl-C on the terminal is for the control process
        start_new_session=True,
    ) as process:
        for line in process.stdout or ():
            with contextlib.suppress(msgspec.DecodeError):
                notify(msgspec.json.decode(line, type=Line))
        reported = b"" if process.stderr is None else process.stderr.read()
    if process.returncode == 0:
        return ""
    lines = reported.decode(errors="replace").strip().splitlines()
    return lines[-1] if lines else f"the archiver ended with status {process.returncode}"


# The process itself.


def step_aside() -> None:
    """Leave the processor and the signals to the control process, whose child this is."""
    # A service manager and a terminal signal every process; this one ends with its work.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGABRT):
        signal.signal(number, signal.SIG_IGN)
    # Real-time priority is inherited. Where the system forbids a change, it works all the same.
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        os.nice(5)


def publish(found: Event | HealthReport) -> None:
    """Report to the control process, if it is still there."""
    line: Line = (found.severity, found.detail, found.kind) if isinstance(found, Event) else found
    with contextlib.suppress(OSError):
        os.write(sys.stdout.fileno(), msgspec.json.encode(line) + b"\n")


def report(severity: Severity, detail: str) -> None:
    """Report an event of the recording."""
    publish(Event(EVENT_KIND, severity, detail, -1))


def draw(directory: Path) -> bool:
    """Draw the figure of a trip, where the libraries for that are installed."""
    command = [sys.executable, "-P", *_PLOT, str(directory)]
    try:
        drawn = subprocess.run(  # noqa: S603 - this program itself
            command, capture_output=True, timeout=_FIGURE_PATIENCE_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return drawn.returncode == 0


class _LeftOut:
    """Keeps libraries from this process that Arrow would load, and that nothing here uses."""

    @staticmethod
    def find_spec(name: str, *_: object) -> None:
        """Refuse NumPy and pandas: together they take 70 MiB."""
        if name in {"numpy", "pandas"}:
            raise ModuleNotFoundError(name)


def main() -> None:
    """Archive, report the records of trips, and draw their figures."""
    step_aside()
    sys.meta_path.insert(0, _LeftOut)
    os.environ["ARROW_DEFAULT_MEMORY_POOL"] = "system"  # it gives back what it took
    from adaptdrive.recording.archive import ERRORS, archive  # noqa: PLC0415 - after that

    try:
        trips = archive(Path(sys.argv[1]), now_s(), float(sys.argv[2]), report, publish)
    except ERRORS as problem:
        sys.exit(str(problem))
    for directory in trips:
        words = f"the record of the trip is in {directory}; `adaptdrive plot {directory}` draws it"
        report(Severity.INFO, words)
    for directory in trips:
        if NO_FIGURE not in sys.argv and draw(directory):
            report(Severity.INFO, f"the figure of the trip is in {directory}")


if __name__ == "__main__":
    main()
