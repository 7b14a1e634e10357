"""Runs a scenario of a motor: plant, controller and course from what was drawn."""

from __future__ import annotations

import dataclasses
from functools import cache

from adaptdrive.control.load import Load
from adaptdrive.control.loads.motor import motor_load
from adaptdrive.control.signals import Mode
from adaptdrive_sim.campaign.drawn import Deployed, DrawnRun, Row, read_deployed
from adaptdrive_sim.campaign.scenario import Scenario
from adaptdrive_sim.course import Course
from adaptdrive_sim.plants.coupling import CouplingParameters
from adaptdrive_sim.plants.motor import Motor, MotorParameters
from adaptdrive_sim.world import World, WorldParameters

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
    """The course of one scenario of a motor; its size is the inertia in disks."""

    size_name = "inertia"

    def __init__(self, scenario: Scenario) -> None:
        life = scenario.life
        super().__init__(deployed(), scenario, life.offset, scenario.reference.value(0.0))
        self.scenario = scenario
        self.sizes = scenario.inertias_at(self.times_s)
        self.references = scenario.references_at(self.times_s)
        self.change_times_s = scenario.change_times_s
        self.largest_movement = scenario.largest_movement
        self.stops = life.stops(self.own.period_s)
        ticks = self.times_s.size * self.own.settings.rates.ticks_per_period
        self._disturbances = life.offset + scenario.disturbances(ticks + 1)

    def columns(self) -> Row:
        """Return the drawn values as columns of the results."""
        return self.scenario.columns()

    def course(self, mode: Mode) -> Course:
        """Return what happens in the run."""
        return Course(
            self.references,
            self.sizes,
            0.0,
            self._disturbances,
            mode,
            self.own.pole,
            self.own.interlocks,
            self.scenario.life.torques_at(self.times_s),
            self.offset,
            self.stops,
        )

    def world(self) -> World:
        """Return the plant as it is at the start."""
        motor = Motor(self.scenario.motor())
        motor.resize(float(self.sizes[0]), 0.0)
        return World(motor, WorldParameters(line=self.scenario.line()))

    def true_load(self, k: int) -> Load:
        """Return the model of the true motor in a slow period."""
        return self._true_load(float(self.sizes[k]))

    def true_loads(self) -> list[Load]:
        """Return the same for all slow periods."""
        inertias = self.sizes.tolist()
        models = {inertia: self._true_load(inertia) for inertia in set(inertias)}
        return [models[inertia] for inertia in inertias]

    def _true_load(self, inertia: float) -> Load:
        motor, coupling = Motor(self.scenario.motor()), CouplingParameters()
        motor.set_inertia(MotorParameters().disk_kgm2 * inertia)
        reference = self.scenario.reference
        middle = 0.5 * (reference.low + reference.high) - self.offset
        motor.speed_rad_s = middle / motor.parameters.tachometer_Vs
        model = motor.model(coupling.ratio, coupling.droop_Ohm)
        return motor_load(model["gain"], model["tau_motor_s"], model["tau_filter_s"])
