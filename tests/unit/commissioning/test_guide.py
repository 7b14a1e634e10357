"""The guide, and a drive that answers it in this process: not heard, set clocks, and its end."""

from __future__ import annotations

import asyncio
import itertools
import re
from collections.abc import AsyncIterator, Callable
from contextlib import aclosing
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
import pytest

from adaptdrive.commissioning.client import HOLD_S, Guide, fast_readings
from adaptdrive.commissioning.course import ExperimentCourse, Samples, build_target
from adaptdrive.commissioning.experiment import load_experiment
from adaptdrive.config.file import load_configuration
from adaptdrive.mqtt.client import DriveStatus, NoAnswerError
from adaptdrive.mqtt.connection import Broker
from adaptdrive.mqtt.contract import Reply
from adaptdrive.tui.terminal import whole
from adaptdrive.util.errors import CommissionError
from tests.unit.commissioning.test_experiment import TARGET, lag
from tests.unit.devices.bench import EXAMPLES

BROKER = Broker(host="localhost", port=1883)
BEGAN = datetime(2026, 11, 29, tzinfo=UTC)
TELEMETRY_S = 0.05
STEADY_S = 2.0
"""Time between two moments at which the clock of a drive is set."""

POLL_S = 0.2
JITTER_S = 0.005
"""Poll of a slow drive, and what a busy host adds to the times that it publishes."""


@dataclass
class PretendDrive:
    """A drive in standby that publishes some telemetry and does at once what it is asked for.

    Attributes:
        message: Returns a message of the drive at a time since the begin, in s.
        state: Its state.
        voltage_V: Last voltage that it was asked for.
        verbs: Commands that came, without the repeated ones.
        stopped: Set when a `disable` came.
        answers_stop: Lets the answer to it go.
    """

    message: Callable[[float], dict[str, Any]]
    state: dict[str, Any] = field(default_factory=lambda: {"state": "standby", "mode": "fixed"})
    voltage_V: float = 200.0
    verbs: list[str] = field(default_factory=list)
    stopped: asyncio.Event = field(default_factory=asyncio.Event)
    answers_stop: asyncio.Event = field(default_factory=asyncio.Event)

    async def telemetry(self, *_: object) -> AsyncIterator[tuple[str, dict[str, Any]]]:
        loop = asyncio.get_running_loop()
        begin_s = loop.time()
        while True:
            yield "drive", self.message(loop.time() - begin_s)
            await asyncio.sleep(TELEMETRY_S)

    async def read_status(self, *_: object) -> DriveStatus:
        return DriveStatus("online", dict(self.state))

    async def send_command(
        self, _broker: object, _drive: object, verb: str, value: Any, *_: object, **__: object
    ) -> Reply:
        if verb not in self.verbs[-1:]:
            self.verbs.append(verb)
        if verb == "mode":
            self.state["mode"] = value
        elif verb == "enable":
            self.state |= {"state": "running", "coasting": True}
        elif verb == "voltage":
            self.state["coasting"], self.voltage_V = False, value
        elif verb == "disable":
            self.state |= {"state": "standby", "coasting": False}
            self.stopped.set()
            await self.answers_stop.wait()
        return Reply("1", verb, accepted=True, reason="", state=None)


def stamped(passed_s: float, **fields: object) -> dict[str, Any]:
    """A message of a drive by the clock of its host."""
    time = BEGAN + timedelta(seconds=passed_s)
    measured = {"boost_voltage_V": 280.0, "output": 1.0, "command": {"bridge": False}}
    return {"time": time.isoformat(), "age_s": 0.0} | measured | fields


Pretend = Callable[[Callable[[float], dict[str, Any]]], PretendDrive]


@pytest.fixture
def pretend(monkeypatch: pytest.MonkeyPatch) -> Pretend:
    """Let a drive in this process answer."""

    def put(message: Callable[[float], dict[str, Any]]) -> PretendDrive:
        drive = PretendDrive(message)
        monkeypatch.setattr("adaptdrive.commissioning.client.telemetry", drive.telemetry)
        for name in ("read_status", "send_command"):
            monkeypatch.setattr(f"adaptdrive.commissioning.client.{name}", getattr(drive, name))
        return drive

    return put


async def watch(duration_s: float) -> Samples:
    return await Guide(BROKER, "bench", 20.0).watch_standby(duration_s)


@pytest.mark.parametrize(
    "wrong", [None, {"boost_voltage_V": None}, {"age_s": None}, {"age_s": "0.0"}, {"age_s": [0.0]}]
)
async def test_a_value_that_is_held_is_no_measurement(
    pretend: Pretend, wrong: dict[str, object] | None
) -> None:
    """Nor is a message without a voltage or its age."""
    pretend(lambda s: stamped(s, age_s=s) if wrong is None else stamped(s, **wrong))
    with pytest.raises(NoAnswerError, match="no measurement for 4 s"):
        await watch(30.0)


@pytest.mark.parametrize("step_s", [-600.0, 600.0])
async def test_a_clock_that_is_set_ends_the_experiment(pretend: Pretend, step_s: float) -> None:
    pretend(lambda s: stamped(s + s // STEADY_S * step_s))
    with pytest.raises(CommissionError, match=re.escape(f"moved by {step_s:+.0f} s against")):
        await watch(60.0)


async def test_a_clock_that_is_slewed_or_set_by_one_second_ends_nothing(pretend: Pretend) -> None:
    pretend(lambda s: stamped(s + s // STEADY_S % 2.0 + 5e-4 * s))
    samples = await watch(600.0)
    assert samples.times_s[-1] - samples.times_s[0] >= 600.0


async def test_a_value_that_is_published_again_is_no_sample_of_the_noise(pretend: Pretend) -> None:
    random = np.random.default_rng(3)
    outputs = 20.0 + 0.02 * random.standard_normal(10_000)

    def polled(passed_s: float) -> dict[str, Any]:
        number, age_s = divmod(passed_s, POLL_S)
        late_s = random.uniform(0.0, JITTER_S)
        return stamped(passed_s + late_s, age_s=age_s, output=outputs[int(number)])

    pretend(polled)
    samples = await watch(60.0)
    assert all(a != b for a, b in itertools.pairwise(samples.outputs))
    assert samples.noise(0.0, samples.times_s[-1]) == pytest.approx(0.02, rel=0.2)


async def test_a_drive_that_goes_off_is_seen_before_its_next_measurement(pretend: Pretend) -> None:
    pretend(lambda s: stamped(s, age_s=s, command={"bridge": s < STEADY_S}))
    async with aclosing(fast_readings(BROKER, "bench")) as readings:
        assert [(await anext(readings)).bridge for _ in range(2)] == [True, False]


@pytest.mark.parametrize("device", ["maxon-epos4", "cascadia-pm", "odrive-s1"])
def test_an_experiment_rests_the_load_at_0_where_its_drive_may_turn_it_backwards(
    device: str,
) -> None:
    configuration = load_configuration(EXAMPLES.parent / "devices" / f"{device}.toml")
    assert configuration.drive.limits.boost_reference_min_V < 0.0
    assert build_target(configuration, 0.05).low_V == 0.0


async def test_a_drive_that_another_operator_has_enabled_is_left_alone(pretend: Pretend) -> None:
    drive = pretend(stamped)
    drive.state["state"] = "running"
    with pytest.raises(CommissionError, match="is running: commissioning begins in standby"):
        await begun(Guide(BROKER, "bench", 20.0))
    assert drive.verbs == []


async def begun(guide: Guide) -> ExperimentCourse:
    experiment = load_experiment(TARGET)
    await guide.carry_out(experiment, lambda *_: None)
    return experiment


ORDERLY = ["mode", "enable", "voltage", "disable", "mode"]


def obedient(pretend: Pretend) -> PretendDrive:
    """A drive with a load of first order."""
    load = lag(0.01, 2.0, noise=0.002)

    def message(passed_s: float) -> dict[str, Any]:
        running = {"bridge": drive.state["state"] == "running"}
        volts = drive.voltage_V
        return stamped(passed_s, boost_voltage_V=volts, output=load(volts), command=running)

    drive = pretend(message)
    return drive


async def test_a_whole_experiment_leaves_the_drive_off_in_its_old_mode(pretend: Pretend) -> None:
    drive = obedient(pretend)
    drive.answers_stop.set()
    experiment = await begun(Guide(BROKER, "bench", 20.0))
    assert experiment.outcome is not None
    assert experiment.outcome.gain == pytest.approx(0.01, rel=0.1)
    assert drive.verbs == ORDERLY
    assert drive.state == {"state": "standby", "mode": "fixed", "coasting": False}


async def test_an_end_that_is_asked_for_twice_stops_the_drive_once(pretend: Pretend) -> None:
    drive = obedient(pretend)
    running = asyncio.create_task(begun(Guide(BROKER, "bench", 20.0)))
    await asyncio.sleep(3.0)
    running.cancel()
    await drive.stopped.wait()
    running.cancel()
    await asyncio.sleep(1.0)
    assert not running.done()
    drive.answers_stop.set()
    with pytest.raises(asyncio.CancelledError):
        await running
    assert drive.verbs == ORDERLY
    assert drive.state["mode"] == "fixed"


async def test_a_stop_that_nobody_answers_is_named(pretend: Pretend) -> None:
    drive, guide = obedient(pretend), Guide(BROKER, "bench", 20.0)
    running = asyncio.create_task(begun(guide))
    await asyncio.sleep(3.0)
    running.cancel()
    with pytest.raises(asyncio.CancelledError):
        await running
    assert drive.stopped.is_set()
    assert f"where bench is energised, it trips within {HOLD_S:g} s" in guide.unstopped


@pytest.mark.parametrize("complete", [False, True])
async def test_a_key_at_the_end_of_an_experiment_discards_nothing_that_is_complete(
    *, complete: bool
) -> None:
    begun, answered = asyncio.Event(), asyncio.Event()

    async def stop() -> None:
        begun.set()
        await answered.wait()

    ending = asyncio.create_task(whole(stop(), complete=complete))
    await begun.wait()
    ending.cancel()
    answered.set()
    (outcome,) = await asyncio.gather(ending, return_exceptions=True)
    assert isinstance(outcome, asyncio.CancelledError) is not complete
