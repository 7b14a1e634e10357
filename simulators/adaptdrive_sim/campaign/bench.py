"""Runs a scenario of a motor: plant, controller and course from what was drawn."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
from numpy.typing import NDArray

from adaptdrive.control.load import Load
from adaptdrive.control.loads.motor import motor_load
from adaptdrive.control.signals import Mode
from adaptdrive_sim.campaign.drawn import Deployed, DrawnRun, read_deployed
from adaptdrive_sim.campaign.scenario import Scenario
from adaptdrive_sim.course import Course
from adaptdrive_sim.plants.coupling import CouplingParameters
from adaptdrive_sim.plants.motor import Motor, MotorParameters
from adaptdrive_sim.world import World, WorldParameters

Array = NDArray[np.float64]

WARM_UP_s = 90.0


@cache
def deployed() -> Deployed:
    """The example configuration, for a run that starts at rest."""
    return at_rest(read_deployed("motor.toml"))


def at_rest(own: Deployed) -> Deployed:
    """Return the same for a run that starts at rest."""
    settings = own.settings
    settings = dataclasses.replace(
        settings,
        learning=dataclasses.replace(settings.learning, settle_periods=0),
        jacket=dataclasses.replace(
            settings.jacket, warm_up_periods=round(WARM_UP_s / own.period_s)
        ),
    )
    return dataclasses.replace(own, settings=settings)


class Stand(DrawnRun):
    """The course of one scenario of a motor."""

    scenario: Scenario

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(deployed(), scenario)
        self.inertias = scenario.inertias_at(self.times_s)
        self.references = scenario.references_at(self.times_s)
        ticks = self.times_s.size * self.own.settings.rates.ticks_per_period
        self._disturbances = scenario.life.offset + scenario.disturbances(ticks + 1)

    @property
    def offset(self) -> float:
        """Offset of the tachometer."""
        return self.scenario.life.offset

    @property
    def largest_movement(self) -> float:
        """Movement of the output by the reference's step or by the largest load torque."""
        return self.scenario.largest_movement

    @property
    def size(self) -> tuple[str, Array]:
        """The inertia in disks."""
        return "inertia", self.inertias

    @property
    def change_times_s(self) -> tuple[float, ...]:
        """Times at which the inertia begins to change."""
        return self.scenario.change_times_s

    def course(self, mode: Mode) -> Course:
        """Return what happens in the run."""
        scenario, own = self.scenario, self.own
        return Course(
            self.references,
            self.inertias,
            0.0,
            self._disturbances,
            mode,
            own.pole,
            scenario.wire(),
            own.interlocks,
            scenario.life.torques_at(self.times_s),
            scenario.life.offset,
            self.stops(),
        )

    def stops(self) -> tuple[range, ...]:
        """Return the slow periods in which the drive is off."""
        return self.scenario.life.stops(self.own.period_s)

    def world(self) -> World:
        """Return the plant as it is at the start."""
        motor = Motor(self.scenario.motor())
        motor.resize(float(self.inertias[0]), 0.0)
        return World(motor, WorldParameters(line=self.scenario.line()))

    def true_load(self, k: int) -> Load:
        """Return the model of the true motor in a slow period."""
        return self._true_load(float(self.inertias[k]))

    def true_loads(self) -> list[Load]:
        """Return the same for all slow periods."""
        inertias = self.inertias.tolist()
        models = {inertia: self._true_load(inertia) for inertia in set(inertias)}
        return [models[inertia] for inertia in inertias]

    def _true_load(self, inertia: float) -> Load:
        motor, coupling = Motor(self.scenario.motor()), CouplingParameters()
        motor.set_inertia(MotorParameters().disk_kgm2 * inertia)
        reference = self.scenario.reference
        middle = 0.5 * (reference.low + reference.high) - self.scenario.life.offset
        motor.speed_rad_s = middle / motor.parameters.tachometer_Vs
        model = motor.model(coupling.ratio, coupling.droop_Ohm)
        return motor_load(model["gain"], model["tau_motor_s"], model["tau_filter_s"])
