"""The daemon against a drive that shares no code with it, on each bus: hold, stop, each fault.

The drive is a process with a plant and a clock of its own, made of the DBC or the register map
alone. What it did is read from its own log.
"""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from adaptdrive.config import load_configuration
from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import Disable, Enable, Reset, SetSetpoint
from adaptdrive.util.errors import RefusedError
from tests.integration.wire.rig import Rig, rigged, until
from tests.peers.foreign import Foreign
from tests.support import Spawn

HELD_V = 3.2
TOLERANCE_V = 0.02
PATIENCE_s = 120.0
OWN_TIMEOUT_s = 0.5


@pytest.fixture(params=["can", "modbus"])
def foreign(request: pytest.FixtureRequest, tmp_path: Path, spawn: Spawn) -> Foreign:
    """A drive on each bus."""
    return Foreign.build(request.param, tmp_path, spawn)


@pytest.fixture
async def rig(foreign: Foreign) -> AsyncIterator[Rig]:
    """The daemon of that drive, running it."""
    foreign.start()
    async with rigged(load_configuration(foreign.config)) as rig:
        await runs(rig, foreign)
        yield rig


async def runs(rig: Rig, foreign: Foreign) -> None:
    """Run the drive until both sides see its bridge on."""
    await rig.run()
    rig.events.clear()
    await until(lambda: foreign.energised)
    fast = rig.daemon._fast
    await until(lambda: fast.reading is not None and fast.reading.bridge)


# On CAN the daemon holds the voltage, 120 times a second: a busy machine trips it.
@pytest.mark.parametrize(
    "foreign", [pytest.param("can", marks=pytest.mark.proof), "modbus"], indirect=True
)
async def test_it_is_held_at_a_set_point_and_stopped(foreign: Foreign, rig: Rig) -> None:
    """It shares no code with the daemon and its simulators."""
    (ready,) = foreign.events("ready")
    assert not [name for name in ready["modules"] if name.startswith("adaptdrive")]
    await rig.ask(SetSetpoint(HELD_V))
    await until(lambda: abs(foreign.reads_V() - HELD_V) < TOLERANCE_V, poll_s=0.1)
    assert rig.heard("trip") == []
    await rig.ask(Disable())
    await rig.reaches(State.STANDBY)
    assert not foreign.energised
    assert foreign.events("bridge")[-1]["why"] == "command"


@pytest.mark.proof
async def test_a_silent_drive_trips_and_is_not_energised_when_it_speaks_again(
    foreign: Foreign, rig: Rig
) -> None:
    foreign.send(signal.SIGSTOP)
    await rig.reaches(State.TRIPPED)
    assert rig.heard("trip")[0].startswith("stale: measurement is ")
    with pytest.raises(RefusedError, match="stale"):
        await rig.daemon.execute(Reset())
    foreign.send(signal.SIGCONT)
    await rig.recovers()
    await rig.reaches(State.STANDBY)
    assert not foreign.energised
    await runs(rig, foreign)


async def test_a_fault_of_the_drive_trips_and_stays_until_it_is_gone(
    foreign: Foreign, rig: Rig
) -> None:
    foreign.send(signal.SIGUSR1)
    await rig.reaches(State.TRIPPED)
    assert rig.heard("trip")[0].startswith("drive fault: ")
    for request in (Reset(), Enable()):
        with pytest.raises(RefusedError):
            await rig.daemon.execute(request)
    foreign.send(signal.SIGUSR2)
    await rig.recovers()
    assert not foreign.energised
    await runs(rig, foreign)


@pytest.mark.proof
async def test_a_killed_drive_trips_and_its_successor_is_run(foreign: Foreign, rig: Rig) -> None:
    foreign.send(signal.SIGKILL)
    await rig.reaches(State.TRIPPED)
    switched = len(foreign.events("bridge"))
    foreign.start()
    await rig.recovers()
    assert len(foreign.events("bridge")) == switched
    await runs(rig, foreign)


def test_a_killed_daemon_leaves_it_to_its_own_time_out(foreign: Foreign) -> None:
    foreign.start(OWN_TIMEOUT_s)
    daemon = foreign.spawn(sys.executable, Path(__file__).with_name("holder.py"), foreign.config)
    await_bridge(foreign, on=True)
    daemon.kill()
    await_bridge(foreign, on=False)
    off = foreign.events("bridge")[-1]
    assert off["why"] == "timeout"
    assert off["silent_s"] > OWN_TIMEOUT_s


def await_bridge(foreign: Foreign, *, on: bool) -> None:
    """Wait until the drive has switched its bridge, by its own log."""
    deadline_s = time.monotonic() + PATIENCE_s
    while foreign.energised is not on:
        assert time.monotonic() < deadline_s
        time.sleep(0.02)
