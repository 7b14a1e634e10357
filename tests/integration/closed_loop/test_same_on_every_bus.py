"""Motor and bath over CAN, Modbus, SCPI, and with sensors beside the drive: one result.

Each run is the daemon on a real bus against the simulated hardware, in virtual time. It is held
against the same controller without any bus.
"""

from __future__ import annotations

import math
import socket
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from adaptdrive.config import Configuration
from adaptdrive.config.file import validate_configuration
from adaptdrive.control.signals import Decision, Mode, Snapshot
from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import Enable, SetMode, SetSetpoint
from adaptdrive_sim.device import DeviceSettings, build_world
from adaptdrive_sim.plants.bath import Bath
from adaptdrive_sim.site import OperatedDrive
from adaptdrive_sim.world import World
from tests.integration.closed_loop.life import SMALL_BATH, change
from tests.integration.closed_loop.wire import WAIT_s, wired
from tests.support import free_port, sample

TACHOMETER = "-modbus-rtu+tachometer"
TICK_s = 1.0 / 120.0
EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"

pytestmark = pytest.mark.usefixtures("outside")


@dataclass(frozen=True)
class Course:
    """One load, and its set-points: one each `hold` periods.

    Attributes:
        settings: The plant.
        changes: What of the examples is changed, by section.
        setpoints: In the unit of the output.
        hold: Slow periods for each.
        rms: How far apart two runs may be, as a share of a step.
        estimates: How far apart two estimates of one parameter may be, as a share of it.
    """

    settings: DeviceSettings
    changes: Mapping[str, Mapping[str, float]]
    setpoints: tuple[float, ...]
    hold: int
    rms: float
    estimates: float

    @property
    def step(self) -> float:
        return abs(self.setpoints[1] - self.setpoints[0])

    def mode(self, number: int) -> Mode:
        """Return the mode from a set-point on: fixed until each bus has seen enough to be trusted.

        A bus that samples less often sees more noise, and is trusted some periods later.
        """
        return Mode.ADAPTIVE if number >= 2 else Mode.FIXED

    def prepare(self, world: World) -> None:
        """A bath with a fifth of the water is five times as fast."""
        if isinstance(world.load, Bath):
            world.load.fill(0.12)


LEARNT = {"motor": ("gain", "tau_sum_s"), "bath": ("resistance_K_per_W", "tau_s")}
COURSES = {
    "motor": Course(
        settings=DeviceSettings(noise_V=0.002, initial_voltage_V=273.0, seed=3),
        changes={"supervisor": {"warm_up_s": 45.0}},
        setpoints=(3.0, 3.6, 3.0, 3.6),
        hold=25,
        rms=0.01,
        estimates=0.05,
    ),
    "bath": Course(
        settings=DeviceSettings(noise_V=0.02, initial_voltage_V=276.0, seed=3),
        changes=SMALL_BATH,
        setpoints=(10.0, 13.0, 10.0, 13.0),
        hold=12,
        rms=0.01,
        estimates=0.05,
    ),
}


@dataclass
class Run:
    """What came of a run: reference, output and estimates of each slow period."""

    references: list[float] = field(default_factory=list)
    outputs: list[float] = field(default_factory=list)
    estimates: dict[str, float] = field(default_factory=dict)
    adaptive: int = 0

    def note(self, snapshot: Snapshot, decision: Decision) -> None:
        """Add a slow period."""
        self.references.append(snapshot.order.reference)
        self.outputs.append(snapshot.output)
        self.adaptive += decision.controller is Mode.ADAPTIVE
        self.estimates = {name: one.value for name, one in decision.estimates.items()}


def with_tachometer_on_can(tables: dict[str, Any]) -> None:
    """Take the speed from a bus of its own instead of from the drive."""
    del tables["signals"]["output"]
    tables["sensor_bus"] = [
        {
            "name": "tachometer",
            "type": "can",
            "interface": "udp_multicast",
            "channel": "239.74.163.6",
            "udp_port": free_port(socket.SOCK_DGRAM),
            "database": str(EXAMPLES / "adaptdrive.dbc"),
            "integrity": {"DriveLoad": {"counter": "LoadAlive", "checksum": "LoadCrc"}},
            "cycle_s": 0.05,
            "signals": {"output": "DriveLoad.Tachometer"},
        }
    ]


def configured(name: str, folder: Path) -> tuple[Configuration, Path]:
    """An example on ports of its own."""
    name, _, more = name.partition("+")
    tables: dict[str, Any] = tomllib.loads((EXAMPLES / f"{name}.toml").read_text(encoding="utf-8"))
    bus = tables["bus"]
    match bus["type"]:
        case "can":
            bus["udp_port"] = free_port(socket.SOCK_DGRAM)
            bus["database"] = str(EXAMPLES / bus["database"])
        case "modbus-tcp" | "scpi":
            bus["port"] = free_port(socket.SOCK_STREAM)
    if more:
        with_tachometer_on_can(tables)
    change(tables, COURSES[tables["load"]["type"]].changes)
    path = folder / f"{name}.toml"
    return validate_configuration(tables, path), path


def without_bus(configuration: Configuration, course: Course) -> Run:
    """The controller in front of the plant, and nothing between them."""
    world = build_world(configuration, course.settings)
    course.prepare(world)
    drive = OperatedDrive(configuration, world)
    for _ in range(round(WAIT_s / TICK_s)):
        drive.tick()
    drive.carry_out(Enable())
    while drive.machine.state is not State.RUNNING:
        drive.tick()
    drive.tick()
    run = Run()
    for number, setpoint in enumerate(course.setpoints):
        drive.carry_out(SetSetpoint(setpoint))
        drive.carry_out(SetMode(course.mode(number)))
        for _ in range(course.hold):
            while not drive.tick():
                pass
            assert drive.snapshot is not None
            assert drive.decision is not None
            run.note(drive.snapshot, drive.decision)
    return run


async def on_the_wire(name: str, folder: Path, course: Course) -> Run:
    """The daemon on the bus of an example, and the simulated hardware at its other end."""
    configuration, path = configured(name, folder)
    run = Run()
    async with wired(configuration, course.settings, path) as wire:
        course.prepare(wire.world)
        await wire.until_running()
        for number, setpoint in enumerate(course.setpoints):
            await wire.daemon.execute(SetSetpoint(setpoint))
            await wire.daemon.execute(SetMode(course.mode(number)))
            for _ in range(course.hold):
                report = await wire.period()
                run.note(report.snapshot, report.decision)
    return run


@cache
def expected_of(load: str) -> Run:
    """The run without any bus."""
    configuration, _ = configured(load, EXAMPLES)
    return without_bus(configuration, COURSES[load])


@pytest.mark.parametrize(
    ("load", "bus"),
    sample(
        [
            *(("motor", bus) for bus in ("", "-modbus-tcp", "-scpi", TACHOMETER)),
            ("bath", "-thermocouples"),
            ("motor", "-modbus-rtu"),
            *(("bath", bus) for bus in ("", "-modbus-tcp", "-modbus-rtu")),
        ],
        4,
    ),
)
async def test_the_control_result_does_not_depend_on_the_bus(
    load: str, bus: str, tmp_path: Path
) -> None:
    course, expected = COURSES[load], expected_of(load)
    found = await on_the_wire(f"{load}{bus}", tmp_path, course)
    assert found.references == expected.references
    assert found.adaptive > course.hold
    assert rms(found.outputs, expected.outputs) < course.rms * course.step
    for name in LEARNT[load]:
        assert found.estimates[name] == pytest.approx(
            expected.estimates[name], rel=course.estimates
        )


def rms(first: list[float], second: list[float]) -> float:
    return math.sqrt(sum((a - b) ** 2 for a, b in zip(first, second, strict=True)) / len(first))
