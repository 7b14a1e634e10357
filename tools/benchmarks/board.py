"""`make board`: the daemon on a small board, which a quota of a tenth of a processor stands for.

`--share 0.2` tries another quota, `--build` one build alone. The simulated drive, the broker and
the client are not held back. The daemon has no real-time priority, which no quota holds back. Each
drive runs without the quota first: where it misses ticks then, the machine is too busy to tell.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from statistics import median
from subprocess import DEVNULL
from tempfile import TemporaryDirectory
from typing import Any

from adaptdrive.app.process import NAMESPACE
from adaptdrive.lab import load_session
from tests.support import MosquittoLauncher, free_port, prefer
from tests.system.daemon.site import Site, until
from tools.benchmarks.paired.pairs import BUSY
from tools.builds.run import BUILDS, environments
from tools.pages.marked import with_part

MARKS = "<!-- board: written by `make board PAGE=…` -->\n", "<!-- end of board -->\n"
PERIOD_us = 10_000
"""Of the quota: about a half cycle."""

CELL = "half cycles with a tick, turn-around (99 %), telemetry (of 10/s), start; state"
LEAST_FREE = 0.99
"""Share of ticks of their own without the quota, below which the machine is too busy to tell."""

ALONE = ("nice", "-n", "-20")
"""Other work of the machine delays the daemon little, where that is granted: a board has none."""

GROUPS = Path("/sys/fs/cgroup")


@dataclass(frozen=True, slots=True)
class Drive:
    """A drive at a rate.

    Attributes:
        example: Its configuration.
        changes: Keys of it that differ.
        rate: What one reads.
    """

    example: str
    changes: dict[str, str]
    rate: str


_LONGER = {"interlocks.stale_s": "0.2"}
DRIVES = (
    Drive("motor", _LONGER, "CAN, 120/s"),
    Drive("motor", {**_LONGER, "drive.line_frequency_Hz": "50"}, "CAN, 100/s"),
    Drive("motor-modbus-tcp", {}, "Modbus, 10/s"),
)


@dataclass(frozen=True, slots=True)
class Found:
    """What a daemon did on the board.

    Attributes:
        start_s: From the start of the process to its first message on the broker.
        own: Share of the half cycles that had a tick of their own.
        turnaround_ms: Median of the 99 % of each report.
        telemetry: Messages a second.
        unrecorded: Share of the ticks that the log lacks.
        end: State of the drive at the end, with the cause of a trip.
    """

    start_s: float
    own: float
    turnaround_ms: float
    telemetry: float
    unrecorded: float
    end: str


@contextmanager
def quota(folder: Path, share: float) -> Iterator[tuple[str, list[str]]]:
    """Yield what holds processes back, and the words that start one under it.

    Args:
        folder: For a file.
        share: Of one processor.
    """
    quota_us = round(share * PERIOD_us)
    user = ["systemd-run", "--user", "--scope", "--quiet"]
    user += ["-p", f"CPUQuota={100.0 * share:g}%", "-p", f"CPUQuotaPeriodSec={PERIOD_us}us"]
    try:
        group = _group(quota_us)
    except OSError:
        if shutil.which(user[0]) and not subprocess.call([*user, "true"], stderr=DEVNULL):
            yield "a scope of systemd", user
        else:
            with _pulses(folder / "pid", quota_us * 1e-6) as words:
                yield "SIGSTOP and SIGCONT, no quota of the kernel", words
        return
    try:
        yield "a control group", _entering(group / "cgroup.procs")
    finally:
        until(lambda: not (group / "cgroup.procs").read_text(), "all processes have ended")
        group.rmdir()


def _group(quota_us: int) -> Path:
    """Make a control group with a quota, of either version."""
    if (GROUPS / "cgroup.controllers").exists():
        with suppress(OSError):  # it may be granted already
            (GROUPS / "cgroup.subtree_control").write_text("+cpu")
        group, limits = GROUPS / f"board-{os.getpid()}", {"cpu.max": f"{quota_us} {PERIOD_us}"}
    else:
        group = GROUPS / "cpu" / f"board-{os.getpid()}"
        limits = {"cpu.cfs_period_us": f"{PERIOD_us}", "cpu.cfs_quota_us": f"{quota_us}"}
    group.mkdir()
    try:
        for name, value in limits.items():
            (group / name).write_text(value)
    except OSError:
        group.rmdir()
        raise
    return group


def _entering(file: Path) -> list[str]:
    """Words that write a process into a file before it becomes another program."""
    return ["sh", "-c", f'echo $$ > {file} && exec "$@"', "sh"]


@contextmanager
def _pulses(file: Path, running_s: float) -> Iterator[list[str]]:
    """Stop and continue the group of the process in a file, in each period."""
    ended = threading.Event()

    def pulse() -> None:
        while not ended.wait(running_s):
            with suppress(OSError, ValueError):
                group = int(file.read_text())
                os.killpg(group, signal.SIGSTOP)
                time.sleep(PERIOD_us * 1e-6 - running_s)
                os.killpg(group, signal.SIGCONT)

    thread = threading.Thread(target=pulse)
    thread.start()
    try:
        yield ["setsid", *_entering(file)]
    finally:
        ended.set()
        thread.join()


def run(drive: Drive, environment: dict[str, str], seconds: float, share: float | None) -> Found:
    """Run a daemon and its simulated drive for so long.

    Args:
        drive: The drive.
        environment: Of the daemon's build.
        seconds: How long it is watched.
        share: Of a processor; None for no quota.
    """
    with TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        held = stack.enter_context(quota(folder, share))[1] if share else []
        kind = socket.SOCK_DGRAM if drive.example == "motor" else socket.SOCK_STREAM
        ports = free_port(socket.SOCK_STREAM), free_port(kind)
        mosquitto = MosquittoLauncher("/usr/sbin/mosquitto", folder)
        site = Site(folder, mosquitto, *ports, drive.changes, drive.example)
        stack.enter_context(closing(site))
        site.start_broker()
        site.start_device("--initial-voltage", "280")
        for one in (site.broker, site.device):
            if one is not None:
                prefer(one)
        site.environment.update(environment)
        began_s = time.monotonic()
        site.start_daemon(*held, *ALONE)
        start_s = time.monotonic() - began_s
        _enable(site)
        return _watched(site, start_s, seconds)


def _enable(site: Site) -> None:
    """Enable the drive once it is there, and wait until it runs or has tripped."""
    site.await_measurement()
    until(lambda: site.ask("enable")["accepted"], "the drive is enabled")
    ended = {"running", "tripped"}
    until(lambda: site.state["state"] in ended, "the drive runs or has tripped")
    if site.state["coasting"]:
        site.ask("setpoint", 3.0)


def _watched(site: Site, start_s: float, seconds: float) -> Found:
    heard, began_s = _reports(site), time.monotonic()
    time.sleep(seconds)
    passed_s = time.monotonic() - began_s
    reports, state = _reports(site)[len(heard) - 1 :], site.state
    first, last = reports[0], reports[-1]
    ticks, missed, held = (last[key] - first[key] for key in ("ticks", "missed", "held"))
    site.stop_daemon()
    session = load_session(site.session_folder()).ticks
    numbers = session["sequence"]
    return Found(
        start_s=start_s,
        own=(ticks - held) / (ticks + missed),
        turnaround_ms=1e-3 * median(one["turnaround_us"]["p99"] or 0.0 for one in reports),
        telemetry=(len(reports) - 1) / passed_s,
        unrecorded=1.0 - session.height / (int(numbers[-1]) - int(numbers[0]) + 1),
        end=state["trip"].partition(":")[0] if state["trip"] else state["state"],
    )


def _reports(site: Site) -> list[dict[str, Any]]:
    return [heard.content for heard in site.ear.on("telemetry/drive")]


def main() -> int:
    """Run every drive with every build, and print the table."""
    os.environ.setdefault(NAMESPACE, f"benchmarks-{os.getpid()}")
    parser = argparse.ArgumentParser(prog="make board")
    parser.add_argument("--share", type=float, default=0.1, help="of one processor")
    parser.add_argument("--seconds", type=float, default=15.0, help="for each drive and build")
    parser.add_argument("--build", choices=BUILDS, action="append", help="may be repeated")
    parser.add_argument("--write-page", type=Path, help="page with the marks of the table")
    options = parser.parse_args()
    with TemporaryDirectory() as name:
        builds = environments(Path(name))
        chosen = {build: builds[build] for build in options.build or builds}
        with quota(Path(name), options.share) as (how, _):
            head = f"{datetime.now(UTC):%Y-%m-%d}, {options.share:g} of a processor by {how}"
        lines = list(_lines(chosen, options.seconds, options.share))
    text = "\n".join((f"{head}, {PERIOD_us * 1e-3:g} ms. Cells: {CELL}.", "", *lines, ""))
    sys.stdout.write(text)
    if options.write_page:
        page = options.write_page.read_text(encoding="utf-8")
        options.write_page.write_text(with_part(page, MARKS, text), encoding="utf-8")
    return 0


def _lines(builds: dict[str, dict[str, str]], seconds: float, share: float) -> Iterator[str]:
    """Yield the table: a row for each drive, a column for each build."""
    yield f"| | {' | '.join(builds)} |"
    yield "|---" * (1 + len(builds)) + "|"
    for drive in DRIVES:
        free = run(drive, next(iter(builds.values())), seconds, None)
        cells = (
            BUSY if free.own < LEAST_FREE else cell(run(drive, environment, seconds, share))
            for environment in builds.values()
        )
        yield f"| {drive.rate} | {' | '.join(cells)} |"


def cell(found: Found) -> str:
    """Return what is found of one run, in the order of `CELL`."""
    lost = f", {100.0 * found.unrecorded:.1f} % of the log lost" if found.unrecorded else ""
    return (
        f"{100.0 * found.own:.1f} %, {found.turnaround_ms:.1f} ms, {found.telemetry:.1f}/s{lost}, "
        f"{found.start_s:.1f} s; {found.end}"
    )


if __name__ == "__main__":
    raise SystemExit(main())
