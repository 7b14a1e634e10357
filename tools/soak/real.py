"""A drive at 120 Hz in real time with all its processes, and a panel with an operator.

Broker with users, simulated drive, daemon and log are those of a site. Figures of
each process must stay flat, and the session must hold all that the panel heard.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import urlsplit

from adaptdrive.recording.reader import Session
from adaptdrive.recording.session import Dropped, Ending
from tests.support import Process
from tests.system.daemon.site import Site
from tests.system.panel.browser import panel_site_in
from tools.soak.meters import HEAD, Meter, of_process
from tools.soak.watcher import Watcher

SAMPLES = 200
SHORTEST_s = 5.0
ACT_s = 10.0
MOSQUITTO = "/usr/sbin/mosquitto"
SEGMENTS = {"recording.segment_s": "600.0"}
"""A dozen segments in two hours: memory that a closed segment keeps shows as a slope."""


def soak(minutes: float, seed: int) -> tuple[list[str], bool]:
    """Run a site for some minutes.

    Args:
        minutes: Real time.
        seed: Of what the operator does.

    Returns:
        Lines of a report, and whether all of it is as it should be.
    """
    load_before = os.getloadavg()[0]
    with (
        TemporaryDirectory(ignore_cleanup_errors=True) as folder,
        panel_site_in(Path(folder), MOSQUITTO, SEGMENTS) as found,
    ):
        site = found.site
        with Watcher(urlsplit(found.address).port or 0, seed) as panel:
            meters = _watched(site, panel, minutes)
            panel.ask("disable")
            late = site.ear.on("telemetry/drive")[-1].content
        site.stop_daemon()
        flaws = list(_flaws(site, panel))
        ticks = site.session().ticks.num_rows
    lines = [
        f"{minutes:g} minutes, seed {seed}: {ticks:,} ticks, of which {late['held']} stand-in and "
        f"{late['missed']} missed; {sum(panel.heard.values()):,} messages heard, "
        f"{len(panel.replies):,} commands answered, {len(panel.events):,} events; load of the "
        f"machine {load_before:.1f} before, {os.getloadavg()[0]:.1f} after. "
        + ("The session replays bit-equal and holds all that was heard." if not flaws else ""),
        *flaws,
        "",
        *HEAD,
        *(line for meter in meters for line in meter.lines()),
    ]
    flat = all(one.flat for meter in meters for one in meter.trends().values())
    return lines, flat and not flaws


def _watched(site: Site, panel: Watcher, minutes: float) -> list[Meter]:
    """Operate the drive and measure its processes."""
    site.run_drive()
    assert site.daemon is not None
    meters = [
        _meter("daemon", site.daemon.pid),
        _meter("broker", _pid(site.broker)),
        _meter("simulated drive", _pid(site.device)),
    ]
    began_s = acted_s = time.monotonic()
    step_s = max(60.0 * minutes / SAMPLES, SHORTEST_s)
    while time.monotonic() - began_s < 60.0 * minutes:
        time.sleep(step_s)
        hours = (time.monotonic() - began_s) / 3600.0
        for meter in meters:
            meter.look(hours)
        if time.monotonic() - acted_s > ACT_s:
            acted_s = time.monotonic()
            panel.operate()
    return meters


def _meter(name: str, pid: int) -> Meter:
    return Meter(name, lambda: of_process(pid))


def _pid(process: Process | None) -> int:
    assert process is not None
    return process.pid


def _flaws(site: Site, panel: Watcher) -> Iterator[str]:
    """Yield what the record lacks, and what of it does not replay."""
    command = [sys.executable, "-m", "adaptdrive.cli", "replay", str(site.session_folder())]
    replayed = subprocess.run(command, check=False, capture_output=True, text=True)
    if replayed.returncode:
        yield f"the replay is not exact: {replayed.stdout[-500:]} {replayed.stderr[-500:]}"
    session: Session = site.session()
    if session.info.ended is not Ending.ORDERLY or session.info.dropped != Dropped():
        yield f"the session ended {session.info.ended}, dropped {session.info.dropped}"
    recorded = {(one.tick, one.kind, one.detail) for one in session.events}
    lost = panel.events - recorded
    if lost:
        yield f"{len(lost)} events are in no session: {sorted(lost)[:3]}"
    unknown = panel.replies.keys() - {one.id for one in session.commands}
    if unknown:
        yield f"{len(unknown)} answered commands are in no session: {sorted(unknown)[:3]}"
    if len([*(site.folder / "sessions").glob("[!.]*/")]) > 1:
        yield "there is more than one session"
