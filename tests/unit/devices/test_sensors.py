"""Sensors beside the drive: what the fast loop gets of them, and what it never waits for."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator, Callable
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.app.ports import publish_samples
from adaptdrive.config.root import Derived
from adaptdrive.control.signals import SAFE_COMMAND, Command
from adaptdrive.devices.port import PortStatistics, SensorListener
from adaptdrive.devices.sensors import RULES, SensorBus, SensoredPort, derived_value
from adaptdrive.runtime.accounts import sensor_report
from adaptdrive.runtime.fast_loop import FastLoop
from adaptdrive.runtime.reports import SensorSample, State
from adaptdrive.runtime.requests import Enable, Reset
from adaptdrive.runtime.state_machine import Machine
from adaptdrive.safety.facts import Reading
from adaptdrive.util.errors import RefusedError
from tests.loopback_port import LoopbackPort
from tests.unit.runtime.bench import CALM, FAST, MACHINE, TICK_S, Around, MotorController

STALE_s = 0.5


class ScriptedSensors:
    """Sensors that say what a test makes them say."""

    description = "scripted"
    statistics = PortStatistics()

    def __init__(self) -> None:
        self.listener: SensorListener | None = None
        self.failure: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    async def run(self, listener: SensorListener) -> None:
        self.listener = listener
        await self.failure

    def say(self, taken_s: float, **values: float) -> None:
        assert self.listener is not None
        self.listener.on_values(values, taken_s)


class Bench:
    """A fast loop whose output comes from sensors, in a time that the test sets."""

    def __init__(self) -> None:
        self.around = Around()
        self.sent: list[Command] = []
        self.drive = LoopbackPort(self.sent.append)
        self.sensors = ScriptedSensors()
        self.bus = SensorBus("thermo", self.sensors, STALE_s, ("hot", "cold"))
        rules = {"output": Derived(rule="difference", of=["hot", "cold"])}
        self.port = SensoredPort(self.drive, [self.bus], rules, self.around.now_s)
        self.machine = Machine(MACHINE)
        settings = replace(FAST, drive_clocks=False)
        self.loop = FastLoop(self.port, MotorController(), self.machine, settings, self.around)
        self.counter = 0
        self.told: list[tuple[bool, str]] = []

    def on_reading(self, reading: Reading) -> None:
        self.loop.on_reading(reading)

    def on_bus(self, up: bool, detail: str) -> None:
        self.told.append((up, detail))

    def frames(self, count: int, *, late: bool = False) -> None:
        """Send frames of a drive that obeys, or still reports its bridge on."""
        for _ in range(count):
            self.around.now += TICK_S
            self.counter += 1
            now, bridge = self.around.now, late or (bool(self.sent) and self.sent[-1].bridge)
            frame = replace(CALM, arrival_s=now, oldest_s=now, counter=self.counter, bridge=bridge)
            self.drive.deliver(replace(frame, output=math.nan))

    def say(self, age_s: float = 0.0, **values: float) -> None:
        self.sensors.say(self.around.now - age_s, **values)

    def state(self) -> State:
        return self.machine.state

    def ask(self, request: Enable | Reset) -> None:
        self.machine.carry_out(request, self.loop.tick, 2.0, self.loop.cause)


@contextlib.asynccontextmanager
async def bench() -> AsyncIterator[Bench]:
    one = Bench()
    serving = asyncio.create_task(one.port.run(one, one.loop.begin))
    try:
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        yield one
    finally:
        serving.cancel()
        await asyncio.wait([serving])


async def test_each_new_value_is_sampled_once_at_the_tick_that_uses_it() -> None:
    async with bench() as one:
        samples: list[SensorSample] = []
        publish_samples(one.port, samples.append, one.around.now_s)
        one.frames(3)
        for number in range(50):
            one.say(age_s=0.002, hot=300.0 + number)
            one.frames(1)
            one.frames(number % 3)
        assert [sample.values["thermo.hot"] for sample in samples] == [
            300.0 + number for number in range(50)
        ]
        assert all(
            sample.age_s["thermo.hot"] == pytest.approx(TICK_S + 0.002) for sample in samples
        )


async def test_the_output_is_derived_from_what_the_sensors_said_last() -> None:
    async with bench() as one:
        one.say(hot=302.5, cold=300.0)
        one.frames(1)
        assert one.loop.reading is not None
        assert one.loop.reading.output == 2.5
        assert one.loop.reading.boost_voltage_V == CALM.boost_voltage_V
        one.say(hot=303.0)
        one.frames(1)
        assert one.loop.reading.output == 3.0


async def test_before_the_sensors_have_spoken_the_drive_cannot_be_enabled() -> None:
    async with bench() as one:
        one.frames(3)
        with pytest.raises(RefusedError, match=r"thermo\.hot: no measurement yet"):
            one.ask(Enable())
        one.say(hot=302.5)
        with pytest.raises(RefusedError, match=r"thermo\.cold: no measurement yet"):
            one.ask(Enable())
        one.say(cold=300.0)
        one.frames(1)
        one.ask(Enable())
        one.frames(3)
        assert one.machine.state is State.RUNNING
        assert all(command == SAFE_COMMAND for command in one.sent[:3])


async def test_a_sensor_that_falls_silent_trips_at_its_own_limit_however_fresh_the_drive() -> None:
    async with bench() as one:
        one.say(hot=302.5, cold=300.0)
        one.frames(1)
        one.ask(Enable())
        one.frames(3)
        held = int(STALE_s / TICK_S)
        one.frames(held - 5)
        assert one.state() is State.RUNNING
        ticks = one.loop.ticks
        one.frames(10)
        assert one.loop.ticks == ticks + 10
        assert one.state() is State.TRIPPED
        assert str(one.machine.trip).startswith("stale: thermo.hot is 50")
        assert one.sent[-1] == SAFE_COMMAND
        with pytest.raises(RefusedError, match="cause is still there: stale"):
            one.ask(Reset())
        one.say(hot=302.5, cold=300.0)
        one.frames(1)
        one.ask(Reset())
        assert one.machine.state is State.STANDBY


async def test_half_of_the_values_do_not_make_the_others_younger() -> None:
    async with bench() as one:
        one.say(hot=302.5, cold=300.0)
        one.frames(1)
        one.ask(Enable())
        for _ in range(int(STALE_s / TICK_S) + 2):
            one.say(hot=302.5)
            one.frames(1)
        assert one.machine.state is State.TRIPPED
        assert "thermo.cold is 50" in str(one.machine.trip)


async def test_a_value_that_comes_late_is_as_old_as_its_measurement() -> None:
    async with bench() as one:
        one.frames(1)
        one.say(age_s=2 * STALE_s, hot=302.5, cold=300.0)
        one.frames(1)
        with pytest.raises(RefusedError, match=r"stale: thermo\.hot is 100"):
            one.ask(Enable())


async def test_loss_and_return_of_a_sensor_bus_are_told_with_its_name() -> None:
    async with bench() as one:
        one.bus.on_bus(up=False, detail="unplugged")
        one.frames(1)
        assert one.told == [(False, "sensor bus thermo: unplugged")]
        assert str(one.port.trip_cause) == "stale: thermo.hot: no measurement yet (unplugged)"
        report = sensor_report(one.bus, 0.0)
        assert (report.up, report.detail, report.values) == (False, "unplugged", {})


async def run_until_the_sensors_die(one: Bench, meanwhile: Callable[[], None]) -> None:
    """Run the drive, let the task of its sensors die, and wait until the port has ended."""
    serving = asyncio.create_task(one.port.run(one, one.loop.begin))
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    one.say(hot=302.5, cold=300.0)
    one.frames(3)
    one.machine.carry_out(Enable(), one.loop.tick, 2.5, one.loop.cause)
    one.frames(5)
    assert one.sent[-1].bridge
    one.sensors.failure.set_exception(RuntimeError("a bug"))
    while not serving.done():
        await asyncio.sleep(0.001)
        meanwhile()
    (outcome,) = await asyncio.gather(serving, return_exceptions=True)
    assert isinstance(outcome, BaseExceptionGroup)
    assert outcome.subgroup(RuntimeError) is not None
    assert not one.drive.send(SAFE_COMMAND)  # its bus is closed


async def test_when_the_task_of_a_sensor_bus_dies_the_drive_is_left_safe() -> None:
    one = Bench()
    await run_until_the_sensors_die(one, lambda: None)
    assert one.sent[-3:] == [SAFE_COMMAND] * 3


@pytest.mark.parametrize("late", [True, False])
async def test_frames_that_come_while_a_sensor_bus_dies_energise_nothing(late: bool) -> None:
    one, commands = Bench(), 0

    def frame() -> None:
        nonlocal commands
        commands = commands or len(one.sent)
        if one.drive.statistics.received < 50:
            one.frames(1, late=late)

    await run_until_the_sensors_die(one, frame)
    assert len(one.sent) > commands
    assert set(one.sent[commands:]) == {SAFE_COMMAND}


@given(values=st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=5))
@pytest.mark.parametrize(
    ("rule", "expected"), [("sum", math.fsum), ("smallest", min), ("largest", max)]
)
def test_rules_do_what_their_names_say(
    rule: str, expected: Callable[[list[float]], float], values: list[float]
) -> None:
    assert RULES[rule](values) == pytest.approx(expected(values), abs=1e-6)  # type: ignore[index]
    with_nothing = [*values, math.nan]
    assert math.isnan(RULES[rule](with_nothing))  # type: ignore[index]


@given(first=st.floats(-1e6, 1e6), second=st.floats(-1e6, 1e6))
def test_pairs(first: float, second: float) -> None:
    assert RULES["difference"]([first, second]) == first - second
    assert RULES["product"]([first, second]) == first * second
    ratio = RULES["ratio"]([first, second])
    assert math.isnan(ratio) if second == 0.0 else ratio == first / second


def test_a_power_is_made_of_voltage_and_current_and_a_speed_of_a_tachometer() -> None:
    power = Derived(rule="product", of=["volts", "amperes"])
    assert derived_value(power, {"volts": 80.0, "amperes": 2.5}) == 200.0
    assert math.isnan(derived_value(power, {"volts": 80.0}))
    speed = Derived(rule="sum", of=["tachometer"], scale=1000.0 / 7.0 * math.pi / 30.0)
    assert derived_value(speed, {"tachometer": 7.0}) == pytest.approx(104.72, abs=0.01)
