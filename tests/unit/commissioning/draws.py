"""Random loads that no configuration describes, behind a drive in virtual time."""

from __future__ import annotations

import dataclasses
import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import tomlkit

from adaptdrive.analysis.replay import reconfigured
from adaptdrive.app.loads import build_load
from adaptdrive.commissioning.course import ExperimentCourse, Phase, Target, build_target
from adaptdrive.config.root import Configuration
from adaptdrive_sim.parameters import EXAMPLES, example_tables
from adaptdrive_sim.plants.bath import Bath, BathParameters
from adaptdrive_sim.plants.battery import Battery, BatteryParameters
from adaptdrive_sim.plants.motor import Motor, MotorParameters
from adaptdrive_sim.world import SimulatedLoad

Random = np.random.Generator

SAMPLE_S = 0.1
"""Time between two messages of the daemon."""

SLEW_V_PER_S = 100.0
LAG_S = 9.0 / 120.0
"""Lag of the daemon's voltage loop."""

BITS = 12
NOISE_SHARE = 0.01


@dataclass(frozen=True)
class Draw:
    """A load and the configuration of its drive, whose model is that of the example.

    Attributes:
        load: The load.
        ratio: N2 of the dc/dc stage.
        droop_Ohm: R_d of it.
        text: Configuration with the limits of drive and output, and a wrong `[load.model]`.
        step_s: Step of the simulation.
        delay_steps: Dead time of the sensor, in steps.
    """

    load: SimulatedLoad
    ratio: float
    droop_Ohm: float
    text: str
    step_s: float
    delay_steps: int = 0

    @cached_property
    def configuration(self) -> Configuration:
        return reconfigured(self.text, EXAMPLES / "drawn.toml", ())

    @property
    def target(self) -> Target:
        return build_target(self.configuration, 0.05)

    @property
    def truth(self) -> dict[str, float]:
        """Parameters by the names of `Load.names`."""
        model = self.load.model(self.ratio, self.droop_Ohm)
        return {name: model[name] for name in build_load(self.configuration).names}

    @property
    def model(self) -> dict[str, float]:
        """The load as `[load.model]` describes it."""
        if isinstance(self.load, Battery):
            own = self.load.parameters
            names = ("relaxation_Ohm", "relaxation_s")
            return {"internal_Ohm": own.series_Ohm, **{one: getattr(own, one) for one in names}}
        keys = type(self.configuration.load.model).model_fields
        model = self.load.model(self.ratio, self.droop_Ohm)
        return {key: value for key, value in model.items() if key in keys}


def span(random: Random, low: float, high: float) -> float:
    """A factor, even on a logarithmic scale."""
    return float(np.exp(random.uniform(np.log(low), np.log(high))))


def motor(random: Random) -> Draw:
    size = span(random, 0.3, 3.0)
    nominal = MotorParameters()
    parameters = dataclasses.replace(
        nominal,
        tachometer_Vs=nominal.tachometer_Vs * size,
        disk_kgm2=nominal.disk_kgm2 * span(random, 0.1, 10.0),
        filter_s=nominal.filter_s * span(random, 0.1, 10.0),
        friction_Nms=nominal.friction_Nms * span(random, 0.3, 3.0),
    )
    load = Motor(parameters)
    load.torque_Nm = float(random.uniform(0.0, 0.5))
    highest = load.model(0.25, 1.0)["gain"] * 400.0
    top = highest * span(random, 0.7, 2.0)
    return Draw(
        load, 0.25, 1.0, configuration_text("motor", top), 1 / 120, int(random.integers(0, 4))
    )


def encoder_motor(random: Random) -> Draw:
    """A motor whose speed is measured without a filter: its load has a single lag."""
    draw = motor(random)
    assert isinstance(draw.load, Motor)
    load = Motor(dataclasses.replace(draw.load.parameters, filter_s=0.01))
    load.torque_Nm = draw.load.torque_Nm
    return dataclasses.replace(draw, load=load)


def bath(random: Random) -> Draw:
    nominal = BathParameters()
    size = span(random, 0.2, 5.0)
    load = Bath(dataclasses.replace(nominal, inflow_L_per_min=nominal.inflow_L_per_min / size))
    top = 21.0 * size * span(random, 0.7, 2.0)
    return Draw(load, 0.25, 1.0, configuration_text("bath", top), SAMPLE_S)


def battery(random: Random) -> Draw:
    cells = max(3, round(span(random, 12.0, 400.0) / 3.8))
    full_V = 4.15 * cells
    scale = (full_V / 82.0) ** 2
    nominal = BatteryParameters()
    load = Battery(
        dataclasses.replace(
            nominal,
            cells=cells,
            capacity_Ah=nominal.capacity_Ah * 82.0 / full_V * span(random, 0.5, 5.0),
            charge=float(random.uniform(0.1, 0.7)),
            series_Ohm=nominal.series_Ohm * scale * span(random, 0.5, 2.0),
            relaxation_Ohm=nominal.relaxation_Ohm * scale * span(random, 0.5, 2.0),
            relaxation_s=nominal.relaxation_s * span(random, 0.3, 3.0),
        )
    )
    ratio, droop_Ohm = full_V * random.uniform(1.05, 1.3) / 400.0, 1.0 * scale
    top = 14.0 * 82.0 / full_V
    text = configuration_text(
        "battery",
        top,
        model={"turns_ratio": ratio, "droop_Ohm": droop_Ohm},
        charge={"voltage_max_V": full_V},
    )
    return Draw(load, ratio, droop_Ohm, text, 1 / 120, int(random.integers(0, 4)))


KINDS: dict[str, Callable[[Random], Draw]] = {"motor": motor, "bath": bath, "battery": battery}


def configuration_text(name: str, reference_max: float, **changes: dict[str, float]) -> str:
    """The configuration of an example with its own range and dc/dc stage, as TOML."""
    tables = example_tables(f"{name}.toml")
    tables["load"]["reference_max"] = reference_max
    tables["load"]["reference_min"] = 0.0
    tables["interlocks"]["output_max"] = 1.2 * reference_max
    for section, values in changes.items():
        tables["load"][section].update(values)
    return tomlkit.dumps(tables)


class Rig:
    """A load behind a drive that follows V_c with the slew and the lag of the daemon's loop."""

    def __init__(self, draw: Draw, random: Random, noise_share: float = NOISE_SHARE) -> None:
        self.draw = draw
        self.time_s = 0.0
        self.voltage_V = self.slewed_V = 170.0
        self.rest = self.highest = self.lowest = math.nan
        top = draw.configuration.load.reference_max
        self._noise = noise_share * top
        self._quantum = 1.25 * top / 2**BITS
        self._random = random
        self._late = deque([draw.load.output] * (draw.delay_steps + 1), draw.delay_steps + 1)
        self._share = -math.expm1(-draw.step_s / LAG_S)

    def sample(self, voltage_V: float) -> tuple[float, float, float]:
        """Run until the next message: its time, boost voltage and output."""
        draw = self.draw
        for _ in range(round(SAMPLE_S / draw.step_s)):
            self._step(voltage_V, draw.step_s)
        noisy = self._late[0] + self._noise * self._random.standard_normal()
        output = round(noisy / self._quantum) * self._quantum
        return self.time_s, self.voltage_V, output

    def begin(self) -> None:
        """Note the rest from which the true output moves."""
        self.rest = self.highest = self.lowest = self.draw.load.output

    @property
    def movement(self) -> tuple[float, float]:
        """Largest fall and rise of the true output, in movements; 0 before it has begun."""
        if math.isnan(self.rest):
            return 0.0, 0.0
        move = self.draw.target.move
        return (self.lowest - self.rest) / move, (self.highest - self.rest) / move

    def _step(self, wanted_V: float, step_s: float) -> None:
        draw, load = self.draw, self.draw.load
        if wanted_V != self.slewed_V:
            way_V = SLEW_V_PER_S * step_s
            self.slewed_V += min(max(wanted_V - self.slewed_V, -way_V), way_V)
        self.voltage_V += (self.slewed_V - self.voltage_V) * self._share
        source_V = draw.ratio * self.voltage_V
        if source_V > load.emf_V:
            load.drive(source_V, draw.droop_Ohm, step_s)
        else:
            load.coast(step_s)
        self.time_s += step_s
        output = load.output
        if output > self.highest:
            self.highest = output
        elif output < self.lowest:
            self.lowest = output
        self._late.append(output)


def finish(found: ExperimentCourse, rig: Rig) -> None:
    """Feed an experiment until it is complete."""
    limits = rig.draw.configuration.drive.limits
    voltage_V = limits.boost_reference_min_V
    while not found.done:
        voltage_V = found.take(*rig.sample(voltage_V))
        assert limits.boost_reference_min_V <= voltage_V <= limits.boost_reference_max_V
        if math.isnan(rig.rest) and found.phase is Phase.CLIMB:
            rig.begin()
