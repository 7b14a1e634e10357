"""What surrounds the fast loop stalls or floods it, with everything else at its highest rate.

The daemon's own books are the measure: half cycles that passed without a tick. Real-time priority,
which these tests ask for, keeps them away. Where it is refused, or where the machine itself stood
still meanwhile (`witness.py`), they are not judged.
"""

from __future__ import annotations

import contextlib
import itertools
import math
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from adaptdrive.recording.session import Ending
from tests.scenes.system.bus_ear import BusEar
from tests.scenes.system.conftest import MakeSite
from tests.scenes.system.own_disk import mounted, stalled
from tests.scenes.system.site import Site, until
from tests.support import resident_MiB, stop_process

pytestmark = [pytest.mark.slow, pytest.mark.proof]

ROOT = Path(__file__).parents[3]
LOADED_S = 3.0
COMMANDS_PER_S = 1000
HOG = "while True: pass"
GROWTH_MiB = 16.0
"""More than any queue in the daemon holds in that time; a leak at these rates would be larger."""

MISSED_SHARE = 0.01
"""One half cycle may go each second: writing down the start of a load can cost it."""

LOST_S = 0.02
"""Time without any process, above which the machine was too busy to judge."""

BUSY = {
    "mqtt.telemetry_Hz": "10.0",
    "recording.flush_s": "0.25",
    "realtime.priority": "50",
    "realtime.late_us": "4000.0",
    "realtime.spin_us": "100.0",
}

Load = Callable[[Site], contextlib.AbstractContextManager[None]]


@pytest.fixture(scope="module")
def busy_site(
    make_shared_site: MakeSite, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Site]:
    """A site whose log is on a disk of its own, where one may be mounted."""
    with mounted(tmp_path_factory.mktemp("disk")) as disk:
        site = make_shared_site(BUSY)
        if disk is not None:
            site.environment["STATE_DIRECTORY"] = str(disk)
        site.start("--initial-voltage", "280")
        site.run_drive()
        yield site
        site.close()


@contextlib.contextmanager
def stalled_disk(site: Site) -> Iterator[None]:
    """The disk of the log answers nothing."""
    disk = site.environment.get("STATE_DIRECTORY")
    if disk is None:
        pytest.skip("no disk can be mounted here, or e2fsprogs or util-linux is not installed")
    with stalled(Path(disk)):
        yield


def stalled_broker(site: Site) -> contextlib.AbstractContextManager[None]:
    return site.stalled(site.broker)


@contextlib.contextmanager
def commands(site: Site) -> Iterator[None]:
    """Set-points without end, each with an id of its own."""
    words = [str(site.broker_port), str(COMMANDS_PER_S)]
    with background(sys.executable, "-m", "tools.benchmarks.flood", *words):
        yield


@contextlib.contextmanager
def hog(_: Site) -> Iterator[None]:
    with background(sys.executable, "-c", HOG):
        yield


@contextlib.contextmanager
def everything(site: Site) -> Iterator[None]:
    with commands(site), hog(site), hog(site), stalled_disk(site):
        yield


LOADS: list[Load] = [stalled_disk, stalled_broker, commands, hog, everything]


@pytest.mark.parametrize("load", LOADS)
def test_the_fast_loop_goes_on_and_the_rest_recovers(busy_site: Site, load: Load) -> None:
    site = busy_site
    assert site.daemon is not None
    before, resident_before = drive_report(site), resident_MiB(site.daemon.pid)
    with watched() as machine, BusEar(site.config) as bus, load(site):
        known = len(bus.commands())
        time.sleep(LOADED_S)
        heard = bus.commands()[known:]
        resident = resident_MiB(site.daemon.pid)
    assert len(heard) > 60
    assert all(command.bridge for command in heard)
    assert resident - resident_before < GROWTH_MiB
    # what a stalled broker still held is older than the load
    after = until(lambda: later_report(site, before["ticks"] + 120), "telemetry after the load")
    ticks, missed = (after[name] - before[name] for name in ("ticks", "missed"))
    assert site.await_state(state="running")["trip"] is None
    site.demand("setpoint", 3.0)
    if not real_time_priority(site.daemon.pid, site.daemon.pid):
        pytest.skip("missed half cycles not judged: real-time priority was refused")
    if machine.lost_s > LOST_S:
        pytest.skip(f"missed half cycles not judged: the machine stood for {machine.lost_s:.2f} s")
    assert missed <= MISSED_SHARE * ticks


def test_the_record_of_it_is_whole_and_replays(busy_site: Site) -> None:
    assert busy_site.stop_daemon() == 0
    session = busy_site.session()
    assert session.info.ended is Ending.ORDERLY
    sequences = session.ticks.column("sequence").to_pylist()
    gaps = sum(later - earlier - 1 for earlier, later in itertools.pairwise(sequences))
    assert session.info.dropped.ticks == gaps
    replayed = busy_site.replay()
    assert replayed.returncode == 0, replayed.stdout + replayed.stderr
    assert "Traceback" not in busy_site.daemon_log


def test_every_thread_that_could_keep_a_tick_from_running_has_real_time_priority(
    make_site: MakeSite,
) -> None:
    """An ordinary thread with Python's lock waits for busy processes, and the ticks for it."""
    site = make_site(BUSY)
    site.start("--initial-voltage", "280")
    site.run_drive()
    assert site.daemon is not None
    pid = site.daemon.pid
    if not real_time_priority(pid, pid):
        pytest.skip("real-time priority was refused")
    threads = [int(task.name) for task in Path(f"/proc/{pid}/task").iterdir()]
    priorities = {thread: real_time_priority(pid, thread) for thread in threads}
    assert len(priorities) >= 2
    assert min(priorities.values()) > 0, priorities


def drive_report(site: Site) -> dict[str, Any]:
    """The next telemetry of the drive."""
    known = len(site.ear.on("telemetry/drive"))
    return site.ear.next_on("telemetry/drive", after=known).content


def later_report(site: Site, ticks: int) -> dict[str, Any] | None:
    """Telemetry of the drive after so many ticks."""
    newest = site.ear.on("telemetry/drive")[-1].content
    return newest if newest["ticks"] > ticks else None


def real_time_priority(pid: int, thread: int) -> int:
    """Real-time priority of a thread as the kernel tells it, 0 for an ordinary one."""
    text = Path(f"/proc/{pid}/task/{thread}/stat").read_text(encoding="utf-8")
    return int(text.rpartition(")")[2].split()[37])


@dataclass
class Machine:
    """The machine while something was tried on it.

    Attributes:
        lost_s: Time for which it ran not even the most urgent process.
    """

    lost_s: float = math.inf


@contextlib.contextmanager
def watched() -> Iterator[Machine]:
    """Watch the machine for as long as the block runs; see `witness.py`."""
    machine = Machine()
    command = [sys.executable, "-m", "tests.scenes.system.witness"]
    with subprocess.Popen(
        command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as witness:
        assert witness.stdout is not None
        witness.stdout.readline()
        yield machine
        found, _ = witness.communicate()
        machine.lost_s = float(found or math.inf)


@contextlib.contextmanager
def background(*command: str) -> Iterator[None]:
    """A process for as long as the block runs."""
    process = subprocess.Popen(command, cwd=ROOT, stdin=subprocess.DEVNULL)
    try:
        yield
    finally:
        stop_process(process)
