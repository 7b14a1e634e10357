"""The two ends of the contract: a drive that only remembers, and clients that nobody here wrote."""

from __future__ import annotations

import asyncio
import json
import shutil
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from aiomqtt import Client, Message

from adaptdrive.config.services import Mqtt
from adaptdrive.control.signals import (
    SAFE_COMMAND,
    Decision,
    Estimate,
    Measurement,
    Mode,
    Order,
    Snapshot,
    Stage,
)
from adaptdrive.mqtt.contract import Output, Profile
from adaptdrive.mqtt.service import MqttService
from adaptdrive.runtime.reports import (
    DriveReport,
    Hub,
    LoadReport,
    SensorReport,
    State,
    StateReport,
)
from adaptdrive.runtime.requests import Disable, Enable, Request, Reset, SetMode, SetSetpoint
from adaptdrive.runtime.timebase import Quantiles
from adaptdrive.safety.trips import Trip, TripKind
from adaptdrive.util.errors import RefusedError
from adaptdrive.util.trends import HealthQuantity, HealthReport
from tests.support import Broker
from tests.unit.mqtt.logs import keeping
from tests.unit.mqtt.memory_broker import MemoryBroker, MemoryClient

PATIENCE_S = 120.0
STANDBY = StateReport(
    state=State.STANDBY,
    mode=Mode.FIXED,
    controller=Mode.FIXED,
    reason="",
    enabled=False,
    setpoint=0.0,
    waveform=None,
    pole=0.7,
    trip=None,
)

OVER_VOLTAGE = Trip(TripKind.OVER_VOLTAGE, "over-voltage: v_bst = 431.2 V, limit 430 V")


@dataclass
class RememberingHost:
    """Stands in for the runtime: notes what it is asked, and has one limit."""

    hub: Hub = field(default_factory=Hub)
    highest: float = 4.0
    asked: list[Request] = field(default_factory=list)
    report: StateReport = STANDBY
    gate: asyncio.Event | None = None
    busy: asyncio.Event = field(default_factory=asyncio.Event)

    async def execute(self, request: Request) -> State:
        if isinstance(request, SetSetpoint) and not 0.0 <= request.value <= self.highest:
            raise RefusedError(f"setpoint {request.value} is outside 0…{self.highest}")
        self.asked.append(request)
        self.busy.set()
        if self.gate is not None:
            await self.gate.wait()
        if isinstance(request, SetSetpoint):
            self.show(replace(self.report, setpoint=request.value))
        if isinstance(request, Enable):
            self.show(replace(self.report, state=State.RUNNING))
        if isinstance(request, Reset):
            self.show(replace(self.report, state=State.STANDBY, trip=None, trip_kind=None))
        if isinstance(request, SetMode):
            self.show(replace(self.report, mode=request.value))
        return self.report.state

    def trip(self, cause: Trip) -> None:
        told = replace(self.report, trip=cause.text, trip_kind=cause.kind)
        self.show(replace(told, state=State.TRIPPED))

    def stop(self) -> State:
        self.asked.append(Disable())
        if self.report.state in (State.STARTING, State.RUNNING):
            self.show(replace(self.report, state=State.STANDBY))
        return self.report.state

    def show(self, report: StateReport) -> None:
        self.report = report
        self.hub.publish(report)


@dataclass
class Bench:
    """A service that runs, and the drive behind it."""

    drive: str
    broker: Broker | MemoryBroker
    host: RememberingHost
    service: MqttService

    @property
    def hub(self) -> Hub:
        return self.host.hub

    def topic(self, name: str) -> str:
        return f"adaptdrive/{self.drive}/{name}"


WORN = HealthQuantity(
    value=21.0,
    std=0.05,
    change_percent=5.0,
    change_std=0.4,
    trend_percent=1.0,
    trend_std=0.04,
    since=None,
    meaning="dry friction and load torque up 1 ± 0.04 % a week",
    outside=True,
)
HEALTH = HealthReport(
    time=datetime(2026, 11, 30, 8, tzinfo=UTC),
    running_h=560.0,
    starts=56,
    quantities={"friction": WORN, "inertia": replace(WORN, outside=False)},
    times_s=(1.79e9, 1.8e9),
    courses={"friction": (0.0, 5.0), "inertia": (0.0, None)},
    changes=("2026-11-24T09Z load",),
)


@asynccontextmanager
async def serving(
    broker: Broker | MemoryBroker,
    drive: str,
    folder: Path,
    host: RememberingHost | None = None,
    *,
    await_online: bool = True,
    home_assistant: str | None = None,
    **around: Any,
) -> AsyncIterator[Bench]:
    """Run a service for one drive; stop it orderly at the end."""
    host = host or RememberingHost()
    async with keeping(folder / f"{drive}.log", host.hub) as log:
        surroundings = replace(log, **({"uniform": lambda low, _: low * 0.1} | around))
        settings = settings_of(broker).model_copy(update={"home_assistant": home_assistant})
        service = MqttService(profile(drive), settings, host, host.hub, surroundings)
        host.show(host.report)
        task = asyncio.create_task(service.run())
        bench = Bench(drive, broker, host, service)
        try:
            if await_online:
                await expect_retained(bench, "availability", "online")
            yield bench
        finally:
            task.cancel()
            await asyncio.wait([task])
            if not task.cancelled():
                task.result()


def settings_of(broker: Broker | MemoryBroker) -> Mqtt:
    """Address of a broker."""
    return Mqtt(host=broker.host, port=broker.port) if isinstance(broker, Broker) else Mqtt()


def profile(drive: str) -> Profile:
    """A drive whose output is a speed of up to 4 V."""
    return Profile(
        drive, Output("speed", "V"), {"setpoint": (0.0, 4.0), "power_W": (None, 900.0)}, version="9"
    )


@dataclass(frozen=True)
class Heard:
    """One message as mosquitto_sub printed it."""

    topic: str
    payload: str
    retained: bool
    qos: int

    @property
    def content(self) -> dict[str, Any]:
        content = json.loads(self.payload, parse_constant=_no_constant)
        assert isinstance(content, dict)
        return content


def _no_constant(name: str) -> None:
    raise AssertionError(f"{name} is not JSON")


class Ear:
    """A running mosquitto_sub, or a client of a broker in this process."""

    def __init__(self, read: Callable[[], Awaitable[Heard]]) -> None:
        self._read = read
        self._passed = 0
        self.heard: list[Heard] = []

    async def until(self, wanted: Callable[[Heard], bool]) -> Heard:
        """Listen until a message is wanted; all of them are kept."""
        async with asyncio.timeout(PATIENCE_S):
            while True:
                message = await self._next()
                if wanted(message):
                    return message

    async def on(self, topic: str) -> Heard:
        """Listen until a message comes on a topic."""
        return await self.until(lambda message: message.topic == topic)

    async def _next(self) -> Heard:
        if self._passed == len(self.heard):
            self.heard.append(await self._read())
        self._passed += 1
        return self.heard[self._passed - 1]

    def start_over(self, unwanted: str) -> None:
        """Forget messages on a topic, and listen to the others once more."""
        self.heard = [message for message in self.heard if message.topic != unwanted]
        self._passed = 0


@asynccontextmanager
async def listening(broker: Broker | MemoryBroker, *topics: str) -> AsyncIterator[Ear]:
    """Have a client listen; it is subscribed when the context is entered."""
    if isinstance(broker, MemoryBroker):
        hearing = _hearing_in_memory(broker, *topics)
    else:
        hearing = _hearing(broker, *topics)
    async with hearing as ear:
        yield ear


@asynccontextmanager
async def _hearing_in_memory(broker: MemoryBroker, *topics: str) -> AsyncIterator[Ear]:
    client, heard = MemoryClient(broker), asyncio.Queue[Heard]()

    def take(message: Message) -> None:
        payload = bytes(message.payload).decode()
        heard.put_nowait(Heard(message.topic.value, payload, message.retain, message.qos))

    client.receive = take
    async with client:
        for topic in topics:
            await client.subscribe(topic)
        yield Ear(heard.get)


@asynccontextmanager
async def _hearing(broker: Broker, *topics: str) -> AsyncIterator[Ear]:
    ready = f"tests/ready/{id(topics)}/{id(broker)}"
    filters = [word for topic in (*topics, ready) for word in ("-t", topic)]
    process = await asyncio.create_subprocess_exec(
        _program("mosquitto_sub"),
        *_address(broker),
        *filters,
        *("-q", "1", "-F", "%r\t%q\t%t\t%p"),
        stdout=asyncio.subprocess.PIPE,
    )
    assert process.stdout is not None
    stream = process.stdout

    async def read() -> Heard:
        line = (await stream.readline()).decode().rstrip("\n")
        assert line, "mosquitto_sub ended"
        retained, qos, topic, payload = line.split("\t", 3)
        return Heard(topic, payload, retained == "1", int(qos))

    ear = Ear(read)
    try:
        await _await_subscription(broker, ear, ready)
        yield ear
    finally:
        process.kill()
        await process.wait()


async def _await_subscription(broker: Broker, ear: Ear, ready: str) -> None:
    async def call() -> None:
        while True:  # a call that the broker hung up on is followed by the next
            await _try_to_publish(broker, ready, b"ready", "-s")
            await asyncio.sleep(0.05)

    calling = asyncio.create_task(call())
    try:
        await ear.on(ready)
    finally:
        calling.cancel()
        await asyncio.wait([calling])
    ear.start_over(ready)


async def publish(
    broker: Broker | MemoryBroker, topic: str, payload: str | bytes, *more: str
) -> None:
    """Have another client publish one message with QoS 1."""
    content = payload if isinstance(payload, bytes) else payload.encode()
    if isinstance(broker, MemoryBroker):
        broker.publish(topic, content, retain="-r" in more)
        return
    options = ("-s" if payload else "-n", *more)
    assert await _try_to_publish(broker, topic, content, *options) == 0


async def _try_to_publish(broker: Broker, topic: str, content: bytes, *options: str) -> int | None:
    """Have mosquitto_pub publish; its exit status."""
    process = await asyncio.create_subprocess_exec(
        _program("mosquitto_pub"),
        *_address(broker),
        *("-t", topic, "-q", "1", *options),
        stdin=asyncio.subprocess.PIPE,
    )
    try:
        await process.communicate(content)
    finally:
        if process.returncode is None:  # cancelled meanwhile
            process.kill()
            await process.wait()
    return process.returncode


async def expect_retained(bench: Bench, name: str, payload: str) -> None:
    """Wait until a topic of the drive holds a retained payload."""
    async with listening(bench.broker, bench.topic(name)) as ear:
        await ear.until(lambda message: message.payload == payload)


async def ask(bench: Bench, verb: str, payload: str | bytes, *more: str) -> dict[str, Any]:
    """Publish a command and return the first reply to anything that follows."""
    async with listening(bench.broker, bench.topic("reply")) as ear:
        await publish(bench.broker, bench.topic(f"command/{verb}"), payload, *more)
        reply = await ear.on(bench.topic("reply"))
    assert not reply.retained
    assert reply.qos == 1
    return reply.content


def _address(broker: Broker) -> tuple[str, ...]:
    return ("-h", broker.host, "-p", str(broker.port), "-V", "311")


def _program(name: str) -> str:
    found = shutil.which(name)
    if found is None:
        pytest.skip(f"{name} is not installed")
    return found


@asynccontextmanager
async def commands(
    broker: Broker, drive: str
) -> AsyncIterator[asyncio.Queue[tuple[str, dict[str, Any]]]]:
    """What a drive is asked: each verb and its payload come into a queue."""
    heard: asyncio.Queue[tuple[str, dict[str, Any]]] = asyncio.Queue()
    async with Client(broker.host, broker.port) as client, asyncio.TaskGroup() as tasks:
        await client.subscribe(f"adaptdrive/{drive}/command/#")

        async def listen() -> None:
            async for message in client.messages:
                verb = message.topic.value.rpartition("/")[2]
                heard.put_nowait((verb, json.loads(bytes(message.payload))))

        hearing = tasks.create_task(listen())
        yield heard
        hearing.cancel()


def drive_report(ticks: int) -> DriveReport:
    """A report of the fast loop after so many ticks."""
    measurement = Measurement(
        tick=ticks,
        tick_period_s=1 / 120,
        boost_voltage_V=300.5,
        line_voltage_V=119.0,
        load_power_W=42.0,
        output=3.1,
    )
    times = Quantiles(10.0, 20.0, 30.0)
    nothing = Quantiles(float("nan"), float("nan"), float("nan"))
    bus = {"received": ticks, "sent": ticks}
    thermocouples = SensorReport(
        name="thermocouples",
        up=False,
        detail="unplugged",
        values={"hot": 310.0},
        age_s={"hot": 1.5},
        bus={"timeouts": 3},
    )
    return DriveReport(
        measurement=measurement,
        age_s=0.004,
        command=SAFE_COMMAND,
        ticks=ticks,
        missed=1,
        held=2,
        lateness_us=times,
        histograms={"lateness_us": (3,), "turnaround_us": (0, 3), "tick_us": (0, 2, 1)},
        turnaround_us=nothing,
        bus=bus,
        sensors=(thermocouples,),
    )


def load_report(k: int) -> LoadReport:
    """A report of one slow period, with an estimate that is not known yet."""
    order = Order(Stage.RUN, 3.0, Mode.ADAPTIVE, 0.7)
    snapshot = Snapshot(k, 120 * k, 1.0, order, 2.9, (2.9,), (300.0,), 301.0, True, 1)
    decision = Decision(
        k=k,
        boost_reference_V=302.0,
        controller=Mode.FIXED,
        accepted=False,
        reason="warming up",
        estimates={"gain": Estimate(0.0111, float("nan"))},
        gains=(1.0, 2.0),
        innovation=0.01,
        excitation=0.5,
        handover_step_V=0.2,
    )
    return LoadReport(snapshot, decision)
