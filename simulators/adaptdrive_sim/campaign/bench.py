"""Runs of motors: what a seed draws, and plant, controller and course made of it."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cache

import numpy as np

from adaptdrive.control.loads.load import Load
from adaptdrive.control.loads.motor import motor_load
from adaptdrive.control.signals import Shape, Waveform
from adaptdrive_sim.campaign import drawn as draws
from adaptdrive_sim.campaign.drawn import Deployed, Drawn, DrawnRun, Numbers, Row
from adaptdrive_sim.campaign.life import Life, draw_life, volt_Nm
from adaptdrive_sim.campaign.settings import MIDDLE, NOMINAL_GAIN, Campaign, ReferenceRanges, reach
from adaptdrive_sim.course import Array, moving
from adaptdrive_sim.experiments.case import from_rest
from adaptdrive_sim.plants.coupling import CouplingParameters
from adaptdrive_sim.plants.motor import Motor, MotorParameters
from adaptdrive_sim.world import World, WorldParameters


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario(Drawn):
    """Drawn values of a run of a motor.

    Attributes:
        inertias: Inertia in disks, first the initial one.
        change_times_s: When it changes.
        gain: Of the tachometer, relative.
        filter: Time constant of its filter, relative.
        life: What happens besides.
    """

    inertias: Numbers
    change_times_s: Numbers
    gain: float
    filter: float
    life: Life

    def inertias_at(self, times_s: Array) -> Array:
        """Inertia in disks at each time."""
        return moving(times_s, self.change_times_s, self.inertias, self.life.inertia_ramps_s)

    def references_at(self, times_s: Array) -> Array:
        """Return the set-point at each time."""
        read_s = self.life.held_at(times_s).tolist()
        return np.array([self.reference.value(time_s) for time_s in read_s])

    def motor(self) -> MotorParameters:
        """The true motor, with one disk."""
        nominal = MotorParameters()
        return MotorParameters(
            tachometer_Vs=nominal.tachometer_Vs * self.gain,
            filter_s=nominal.filter_s * self.filter,
            coulomb_Nm=self.life.coulomb_V * volt_Nm(),
            drag_Nms2=self.life.drag_V * volt_Nm() * (nominal.tachometer_Vs / MIDDLE) ** 2,
        )


def draw(campaign: Campaign, seed: int) -> Scenario:
    """The run of a campaign that a seed stands for."""
    generator = np.random.default_rng([seed, 0])
    load, reference, noise = campaign.load, campaign.reference, campaign.noise
    inertias = draws.several_sizes(
        generator,
        load.inertia,
        load.unchanged if campaign.duration_s > 2.0 * load.quiet_s else 1.0,
        load.changes,
        load.change_min,
    )
    end_s = max(load.quiet_s, campaign.duration_s - load.quiet_s)
    times_s = draws.times(generator, len(inertias) - 1, load.quiet_s, end_s)
    step = draws.uniform(generator, reference.step)
    shape = reference.shapes[int(generator.integers(len(reference.shapes)))]
    period_s = round(draws.uniform(generator, reference.period_s))
    line, wire = campaign.line, campaign.wire
    gain, above = draws.uniform(generator, load.gain), _low_above(reference, seed)
    life = draw_life(campaign.life, seed, campaign.duration_s, len(times_s))
    held = reach(gain, life.largest_torque_V + life.coulomb_V, life.drag_V)
    low, high = draws.within_reach(reference.low + above, step, held)
    return Scenario(
        seed=seed,
        duration_s=campaign.duration_s,
        inertias=inertias,
        change_times_s=times_s,
        gain=gain,
        filter=draws.uniform(generator, load.filter),
        reference=Waveform(Shape(shape), low, high, float(period_s)),
        sigma=(high - low) * draws.uniform(generator, noise.sigma),
        spike_share=draws.uniform(generator, noise.spike_share),
        spike_sigma=(high - low) * noise.spike_sigma,
        line_voltage=draws.uniform(generator, line.voltage),
        frequency_Hz=draws.uniform(generator, line.frequency_Hz),
        output_delay_ticks=draws.whole(generator, wire.output_delay_ticks),
        output_quantum=draws.uniform(generator, wire.output_V),
        **draws.each(generator, wire, "voltage_V", "power_W", "scale_S"),
        life=life,
    )


def _low_above(reference: ReferenceRanges, seed: int) -> float:
    """Draw from a separate stream, so that a file without it draws the same as ever."""
    return draws.uniform(np.random.default_rng([seed, 2]), reference.low_above)


WARM_UP_s = 90.0


@cache
def deployed() -> Deployed:
    """The example configuration, for a run that starts at rest."""
    return at_rest(draws.deploy("motor.toml"))


def at_rest(own: Deployed) -> Deployed:
    """Return the same for a run that starts at rest."""
    return dataclasses.replace(own, settings=from_rest(own.settings, WARM_UP_s, own.period_s))


class Stand(DrawnRun):
    """The course of one scenario of a motor; its size is the inertia in disks."""

    def __init__(self, scenario: Scenario) -> None:
        life = scenario.life
        super().__init__(deployed(), scenario, life.offset, scenario.reference.value(0.0))
        self.scenario = scenario
        self.sizes = self.targets = scenario.inertias_at(self.times_s)
        self.burdens = life.torques_at(self.times_s)
        self.references = scenario.references_at(self.times_s)
        self.change_times_s = scenario.change_times_s
        self.largest_movement = max(self.step, NOMINAL_GAIN * scenario.gain * life.largest_torque_V)
        self.stops = life.stops(self.own.period_s)
        self.disturbances = life.offset + scenario.disturbances(self.ticks + 1)
        self._true_load = cache(self._load_with)

    def columns(self) -> Row:
        """Return the drawn values as columns of the results; noise is relative to the step."""
        return super().columns() | {"sigma": self.scenario.sigma / self.step}

    def world(self) -> World:
        """Return the plant as it is at the start."""
        motor = Motor(self.scenario.motor())
        motor.resize(float(self.sizes[0]), 0.0)
        return World(motor, WorldParameters(line=self.scenario.line()))

    def true_load(self, k: int) -> Load:
        """Return the model of the true motor in a slow period."""
        return self._true_load(float(self.sizes[k]))

    def _load_with(self, inertia: float) -> Load:
        motor, coupling = Motor(self.scenario.motor()), CouplingParameters()
        motor.set_inertia(MotorParameters().disk_kgm2 * inertia)
        reference = self.scenario.reference
        middle = 0.5 * (reference.low + reference.high) - self.offset
        motor.speed_rad_s = middle / motor.parameters.tachometer_Vs
        model = motor.model(coupling.ratio, coupling.droop_Ohm)
        return motor_load(model["gain"], model["tau_motor_s"], model["tau_filter_s"])
