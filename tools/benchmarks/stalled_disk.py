"""Ticks while the disk of the state and of the recordings stands still, against those before it.

The disk is an ext4 file system of its own, frozen for 5 s and free for 5 s in turn; a client sends
five set-points a second throughout. Daemon and simulated drive run with real-time priority. What
is compared are the times of the ticks that the daemon itself recorded.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import polars as pl

from adaptdrive.lab import load_session
from tests.system.daemon.own_disk import mounted, stalled
from tests.system.daemon.site import until
from tools.benchmarks.rows import Extent, Row
from tools.benchmarks.site import prompt_site
from tools.benchmarks.stop import FLOOD
from tools.benchmarks.tools import process

STALL_S = 5.0
CALM_S = 3.0
"""Pause after a stall: what waited is written."""

COMMANDS_PER_S = 5
PATIENCE_s = 60.0
TIMES = ("lateness_us", "turnaround_us", "tick_us")


@dataclass(frozen=True)
class Window:
    """A time of the run, monotonic."""

    stalls: bool
    begin_s: float
    end_s: float


def rows(extent: Extent) -> Iterator[Row]:
    """All rows of this file."""
    with TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        disk = stack.enter_context(mounted(folder))
        if disk is None:
            raise RuntimeError("no file system can be mounted")
        site = stack.enter_context(prompt_site(folder, {"STATE_DIRECTORY": str(disk)}))
        site.start_daemon()
        site.run_drive()
        words = [sys.executable, str(FLOOD), str(site.broker_port), str(COMMANDS_PER_S)]
        stack.enter_context(process(words, stdout=subprocess.DEVNULL))
        windows = list(_windows(disk, extent.pick(20, 3, 1)))
        sessions = disk / "sessions"
        (session,) = sessions.glob("[!.]*/")
        until(lambda: _last_s(session) > windows[-1].end_s, "recording continues", PATIENCE_s)
        if site.stop_daemon() != 0:
            raise RuntimeError(site.daemon_log)
        yield from _compared(session, windows)


def _windows(disk: Path, pairs: int) -> Iterator[Window]:
    """Wait, then freeze the disk, in turn."""
    for _ in range(pairs):
        time.sleep(CALM_S)
        begin_s = time.monotonic()
        time.sleep(STALL_S)
        yield Window(stalls=False, begin_s=begin_s, end_s=time.monotonic())
        with stalled(disk):
            begin_s = time.monotonic()
            time.sleep(STALL_S)
            end_s = time.monotonic()
        yield Window(stalls=True, begin_s=begin_s, end_s=end_s)


def _last_s(session: Path) -> float:
    return float(load_session(session).ticks["monotonic_s"].max() or 0.0)


def _compared(session: Path, windows: list[Window]) -> Iterator[Row]:
    read = load_session(session)
    ticks = read.ticks
    calm = _of(ticks, [one for one in windows if not one.stalls])
    frozen = _of(ticks, [one for one in windows if one.stalls])
    for name in TIMES:
        for label, share in (("median", 0.5), ("p99", 0.99), ("largest", 1.0)):
            ours, against = (_quantile(one, name, share) for one in (frozen, calm))
            title = f"{name.removesuffix('_us')} while the disk stands still, {label}"
            note = f"{frozen.height} and {calm.height} ticks"
            yield Row(title, ours, "us", against, "the same run, disk free", note=note)
    stand_ins = [one.filter(~pl.col("fresh")).height for one in (frozen, calm)]
    yield Row("stand-in ticks", stand_ins[0], "", stand_ins[1], "the same run, disk free")
    missing = int(ticks["sequence"][-1]) + 1 - ticks.height
    yield Row("ticks not recorded", missing, "", target="none", met=not missing)
    off = frozen.filter(~pl.col("bridge")).height
    note = f"{len(windows) // 2} stalls; {read.info.ended}"
    yield Row("safe commands while it stands still", off, "", target="none", met=not off, note=note)


def _of(ticks: pl.DataFrame, windows: list[Window]) -> pl.DataFrame:
    within = [ticks.filter(pl.col("monotonic_s").is_between(w.begin_s, w.end_s)) for w in windows]
    return pl.concat(within)


def _quantile(ticks: pl.DataFrame, name: str, share: float) -> float:
    values = ticks[name].drop_nans()
    return float(values.quantile(share) or 0.0)
