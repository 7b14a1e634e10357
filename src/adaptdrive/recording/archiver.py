"""The archiver process: writes what the log has into the folders of its sessions, and ends.

It is started as `python -m adaptdrive.recording.archiver LOG AFTER [--no-figure]`, AFTER
being the time after a trip that belongs to its record, and outlives the daemon that started it.
"""

import contextlib
import os
import signal
import subprocess
import sys
from pathlib import Path

import msgspec

from adaptdrive.runtime.reports import Severity
from adaptdrive.util.clock import now_s
from adaptdrive.util.errors import escaped

NO_FIGURE = "--no-figure"
"""Word of the command line without which the figure of a trip is drawn."""

_PLOT = ("-m", "adaptdrive.cli", "plot")
_FIGURE_PATIENCE_S = 120.0


def step_aside() -> None:
    """Leave the processor and the signals to the control process, whose child this is."""
    # A service manager and a terminal signal every process; this one ends with its work.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGABRT):
        signal.signal(number, signal.SIG_IGN)
    # Real-time priority is inherited. Where the system forbids a change, it works all the same.
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        os.nice(5)


def report(severity: Severity, detail: str) -> None:
    """Report to the control process, if it is still there."""
    with contextlib.suppress(OSError):
        os.write(sys.stdout.fileno(), msgspec.json.encode((severity, escaped(detail))) + b"\n")


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
        trips = archive(Path(sys.argv[1]), now_s(), float(sys.argv[2]), report)
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
