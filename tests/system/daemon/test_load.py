"""What surrounds the fast loop stalls or floods it, with everything else at its highest rate.

How many half cycles it costs is measured in `tools.benchmarks`.
"""

from __future__ import annotations

import contextlib
import itertools
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from adaptdrive.recording.session import Ending
from tests.support import resident_MiB, stop_process
from tests.system.conftest import MakeSite
from tests.system.daemon.own_disk import mounted, stalled
from tests.system.daemon.site import BusEar, Site, until

pytestmark = pytest.mark.proof

ROOT = Path(__file__).parents[3]
LOADED_S = 3.0
GROWTH_MiB = 16.0
"""More than any queue in the daemon holds in that time; a leak at these rates would be larger."""

BUSY = {
    "mqtt.telemetry_Hz": "10.0",
    "realtime.priority": "50",
}

Load = Callable[[Site], contextlib.AbstractContextManager[None]]


def stalled_broker(site: Site) -> contextlib.AbstractContextManager[None]:
    return site.stalled(site.broker)


@contextlib.contextmanager
def everything(site: Site) -> Iterator[None]:
    """Set-points without end, processes that take all they can, and a disk that answers nothing."""
    flood = ("-m", "tools.benchmarks.flood", str(site.broker_port), "1000")
    hog = ("-c", "while True: pass")
    disk = Path(site.environment["STATE_DIRECTORY"])
    with background(*flood), background(*hog), background(*hog), stalled(disk):
        yield


@contextlib.contextmanager
def background(*words: str) -> Iterator[None]:
    process = subprocess.Popen([sys.executable, *words], cwd=ROOT, stdin=subprocess.DEVNULL)
    try:
        yield
    finally:
        stop_process(process)


def test_the_fast_loop_goes_on_and_the_rest_recovers(make_site: MakeSite, tmp_path: Path) -> None:
    with mounted(tmp_path) as disk:
        if disk is None:
            pytest.skip("no disk can be mounted here, or e2fsprogs or util-linux is not installed")
        site = make_site(BUSY)
        site.environment["STATE_DIRECTORY"] = str(disk)
        site.start("--initial-voltage", "280")
        site.run_drive()
        for load in (stalled_broker, everything):
            goes_on(site, load)
        the_threads_have_its_priority(site)
        assert site.stop_daemon() == 0
        session = site.session()
        assert session.info.ended is Ending.ORDERLY
        sequences = session.ticks.column("sequence").to_pylist()
        gaps = sum(later - earlier - 1 for earlier, later in itertools.pairwise(sequences))
        assert session.info.dropped.ticks == gaps
        replayed = site.replay()
        assert replayed.returncode == 0, replayed.stdout + replayed.stderr
        assert "Traceback" not in site.daemon_log
        site.close()


def goes_on(site: Site, load: Load) -> None:
    assert site.daemon is not None
    known = len(site.ear.on("telemetry/drive"))
    before = site.ear.next_on("telemetry/drive", after=known).content["ticks"]
    resident_before = resident_MiB(site.daemon.pid)
    with BusEar(site.config) as bus, load(site):
        time.sleep(LOADED_S)
        heard = bus.commands()
        resident = resident_MiB(site.daemon.pid)
    assert len(heard) > 60
    assert heard[-1].bridge
    assert resident - resident_before < GROWTH_MiB
    # what a stalled broker still held is older than the load
    until(lambda: later_report(site, before + 120), "telemetry after the load")
    assert site.await_state(state="running")["trip"] is None
    site.demand("setpoint", 3.0)


def later_report(site: Site, ticks: int) -> dict[str, Any] | None:
    """Telemetry of the drive after so many ticks."""
    newest = site.ear.on("telemetry/drive")[-1].content
    return newest if newest["ticks"] > ticks else None


def the_threads_have_its_priority(site: Site) -> None:
    """An ordinary thread with Python's lock waits for busy processes, and the ticks for it."""
    assert site.daemon is not None
    pid = site.daemon.pid
    if real_time_priority(pid, pid):
        threads = [int(task.name) for task in Path(f"/proc/{pid}/task").iterdir()]
        assert len(threads) >= 2
        assert min(real_time_priority(pid, thread) for thread in threads) > 0


def real_time_priority(pid: int, thread: int) -> int:
    """Real-time priority of a thread as the kernel tells it, 0 for an ordinary one."""
    text = Path(f"/proc/{pid}/task/{thread}/stat").read_text(encoding="utf-8")
    return int(text.rpartition(")")[2].split()[37])
