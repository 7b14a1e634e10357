"""The guide against a drive that is not heard, or whose clock is set, on a real broker."""

from __future__ import annotations

import asyncio
import itertools
import json
import re
import uuid
from collections.abc import Callable
from contextlib import aclosing
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adaptdrive.commission.experiment import LoadExperiment
from adaptdrive.commission.guide import Guide
from adaptdrive.commission.readings import fast_readings
from adaptdrive.commission.samples import Samples
from adaptdrive.commission.target import build_target
from adaptdrive.config.file import load_configuration
from adaptdrive.config.services import Mqtt
from adaptdrive.errors import CommissionError
from adaptdrive.operation.conversation import NoAnswerError
from adaptdrive.operation.steady import SteadyClient
from adaptdrive.watch.ending import whole
from tests.commission.answering_drive import answering_drive
from tests.support import Broker

EXAMPLES = Path(__file__).parents[2] / "deploy" / "examples"
PATIENCE_S = 60.0
STEADY_S = 2.0
"""Time between two moments at which the clock of a drive is set."""

POLL_S = 0.2
JITTER_S = 0.005
"""Poll of a slow drive, and what a busy host adds to the times that it publishes."""

MEASUREMENT = {"boost_voltage_V": 280.0, "output": 1.0, "command": {"bridge": False}}

Telemetry = Callable[[float], dict[str, Any]]
"""Returns a message of a drive at a time since the begin, in s."""


async def publish(broker: Broker, drive: str, telemetry: Telemetry) -> None:
    """Publish a drive in standby, and its telemetry twenty times a second."""
    place, begin_s = f"adaptdrive/{drive}", asyncio.get_running_loop().time()
    async with SteadyClient(broker.host, broker.port) as client:
        await client.publish(f"{place}/availability", "online", retain=True)
        await client.publish(f"{place}/state", json.dumps({"state": "standby"}), retain=True)
        while True:
            message = telemetry(asyncio.get_running_loop().time() - begin_s)
            await client.publish(f"{place}/telemetry/drive", json.dumps(message))
            await asyncio.sleep(0.05)


async def watch(broker: Broker, telemetry: Telemetry, duration_s: float) -> Samples:
    """Return what the guide sees of a drive in standby that publishes some telemetry."""
    drive = f"heard-{uuid.uuid4()}"
    publishing = asyncio.create_task(publish(broker, drive, telemetry))
    try:
        async with asyncio.timeout(PATIENCE_S):
            guide = Guide(Mqtt(host=broker.host, port=broker.port), drive, 20.0)
            return await guide.watch_standby(duration_s)
    finally:
        publishing.cancel()
        await asyncio.wait([publishing])


def stamped(time: datetime, **fields: object) -> dict[str, Any]:
    """Return a message of a drive by the clock of its host."""
    return MEASUREMENT | {"time": time.isoformat(), "age_s": 0.0} | fields


async def test_a_value_that_is_held_is_no_measurement(mosquitto: Broker) -> None:
    def held(passed_s: float) -> dict[str, Any]:
        return stamped(datetime.now(UTC), age_s=passed_s)

    with pytest.raises(NoAnswerError, match="no measurement for 4 s"):
        await watch(mosquitto, held, 30.0)


@pytest.mark.parametrize("step_s", [-600.0, 600.0])
async def test_a_clock_that_is_set_ends_the_experiment(mosquitto: Broker, step_s: float) -> None:
    def telemetry(passed_s: float) -> dict[str, Any]:
        return stamped(datetime.now(UTC) + passed_s // STEADY_S * timedelta(seconds=step_s))

    with pytest.raises(CommissionError, match=re.escape(f"moved by {step_s:+.0f} s against")):
        await watch(mosquitto, telemetry, 60.0)


async def test_a_clock_that_is_slewed_or_set_by_one_second_ends_nothing(
    mosquitto: Broker,
) -> None:
    def telemetry(passed_s: float) -> dict[str, Any]:
        step_s = passed_s // STEADY_S % 2.0
        return stamped(datetime.now(UTC) + timedelta(seconds=step_s + 5e-4 * passed_s))

    samples = await watch(mosquitto, telemetry, 4.0)
    assert samples.times_s[-1] - samples.times_s[0] >= 4.0


async def test_a_value_that_is_published_again_is_no_sample_of_the_noise(mosquitto: Broker) -> None:
    random = np.random.default_rng(3)
    outputs = 20.0 + 0.02 * random.standard_normal(10_000)

    def polled(passed_s: float) -> dict[str, Any]:
        number, age_s = divmod(passed_s, POLL_S)
        late = timedelta(seconds=random.uniform(0.0, JITTER_S))
        return stamped(datetime.now(UTC) + late, age_s=age_s, output=outputs[int(number)])

    samples = await watch(mosquitto, polled, 8.0)
    assert all(a != b for a, b in itertools.pairwise(samples.outputs))
    assert samples.noise(0.0, samples.times_s[-1]) == pytest.approx(0.02, rel=0.4)


async def test_a_drive_that_goes_off_is_seen_before_its_next_measurement(mosquitto: Broker) -> None:
    drive = f"heard-{uuid.uuid4()}"

    def held(passed_s: float) -> dict[str, Any]:
        command = {"bridge": passed_s < STEADY_S}
        return stamped(datetime.now(UTC), age_s=passed_s, command=command)

    publishing = asyncio.create_task(publish(mosquitto, drive, held))
    try:
        async with asyncio.timeout(PATIENCE_S):
            readings = fast_readings(Mqtt(host=mosquitto.host, port=mosquitto.port), drive)
            async with aclosing(readings):
                bridges = [(await anext(readings)).bridge for _ in range(2)]
    finally:
        publishing.cancel()
        await asyncio.wait([publishing])
    assert bridges == [True, False]


@pytest.mark.parametrize(
    "wrong", [{"boost_voltage_V": None}, {"age_s": None}, {"age_s": "0.0"}, {"age_s": [0.0]}]
)
async def test_a_message_without_a_voltage_or_its_age_is_no_measurement(
    mosquitto: Broker, wrong: dict[str, object]
) -> None:
    def telemetry(passed_s: float) -> dict[str, Any]:
        return stamped(datetime.now(UTC), **wrong)

    with pytest.raises(NoAnswerError, match="no measurement for 4 s"):
        await watch(mosquitto, telemetry, 30.0)


@pytest.mark.parametrize("device", ["maxon-epos4", "cascadia-pm", "odrive-s1"])
def test_an_experiment_rests_the_load_at_0_where_its_drive_may_turn_it_backwards(
    device: str,
) -> None:
    configuration = load_configuration(EXAMPLES.parent / "devices" / f"{device}.toml")
    assert configuration.drive.limits.boost_reference_min_V < 0.0
    assert build_target(configuration, 0.05).low_V == 0.0


async def test_a_drive_that_another_operator_has_enabled_is_left_alone(mosquitto: Broker) -> None:
    name = f"taken-{uuid.uuid4()}"
    target = build_target(load_configuration(EXAMPLES / "motor.toml"), 0.05)
    async with answering_drive(mosquitto, name) as drive:
        drive.state = "running"
        guide = Guide(Mqtt(host=mosquitto.host, port=mosquitto.port), name, 20.0)
        with pytest.raises(CommissionError, match="is running: commissioning begins in standby"):
            await guide.carry_out(LoadExperiment(target), lambda *_: None)
    assert drive.verbs == []


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
