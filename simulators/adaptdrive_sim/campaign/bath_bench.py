"""Runs a scenario of a bath: plant, controller and course from what was drawn."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
from numpy.typing import NDArray

from adaptdrive.control.load import Load
from adaptdrive.control.loads.bath import realise
from adaptdrive.control.signals import Mode
from adaptdrive_sim.campaign.bath_reach import bath_parameters
from adaptdrive_sim.campaign.bath_scenario import BathScenario
from adaptdrive_sim.campaign.drawn import Deployed, DrawnRun, read_deployed
from adaptdrive_sim.campaign.life import moving
from adaptdrive_sim.course import Course
from adaptdrive_sim.plants.bath import Bath, BathParameters
from adaptdrive_sim.plants.coupling import CouplingParameters
from adaptdrive_sim.world import World, WorldParameters

Array = NDArray[np.float64]


@cache
def deployed_bath() -> Deployed:
    """The example configuration."""
    return read_deployed("bath.toml")


class BathStand(DrawnRun):
    """The course of one scenario of a bath."""

    scenario: BathScenario

    def __init__(self, scenario: BathScenario) -> None:
        super().__init__(deployed_bath(), scenario)
        ramps_s = (scenario.fill_s,) * len(scenario.fill_times_s)
        times_s, volumes = scenario.fill_times_s, scenario.volumes_gal
        self.volumes_gal = moving(self.times_s, times_s, volumes, ramps_s)
        self.inflows = scenario.inflows_at(self.times_s)
        self.references = scenario.references_at(self.times_s)

    @property
    def offset(self) -> float:
        """Offset of the sensor."""
        return self.scenario.offset_K

    @property
    def largest_movement(self) -> float:
        """Movement of the output by the reference's step or by the largest change of the inflow."""
        flows = self.scenario.inflows
        return max(self.step, (max(flows) / min(flows) - 1.0) * self.scenario.reference.high)

    @property
    def size(self) -> tuple[str, Array]:
        """The volume in US gallons."""
        return "volume_gal", self.volumes_gal

    @property
    def change_times_s(self) -> tuple[float, ...]:
        """Times at which the volume begins to change."""
        return self.scenario.fill_times_s

    def course(self, mode: Mode) -> Course:
        """Return what happens in the run."""
        scenario, own = self.scenario, self.own
        ticks = self.times_s.size * own.settings.rates.ticks_per_period
        moves = scenario.inflow_times_s
        return Course(
            self.references,
            scenario.targets_gal_at(self.times_s) / scenario.volumes_gal[0],
            scenario.fill_s,
            scenario.disturbances(ticks + 1),
            mode,
            own.pole,
            scenario.wire(),
            own.interlocks,
            self.inflows / scenario.inflows[0] if moves else np.empty(0),
            scenario.offset_K,
        )

    def world(self) -> World:
        """Return the plant as it is at the start."""
        scenario = self.scenario
        parameters = dataclasses.replace(
            self._parameters(0),
            drift_K_per_h=scenario.drift_K_per_h,
            turn_s=scenario.turn_s,
            ageing_per_h=scenario.ageing_per_h,
        )
        return World(Bath(parameters), WorldParameters(line=scenario.line()))

    def true_load(self, k: int) -> Load:
        """Return the model of the true bath in a slow period; its input is a new heater's power."""
        stage, nominal = CouplingParameters(), self.own.load
        model = Bath(self._parameters(k)).model(stage.ratio, stage.droop_Ohm)
        power = model["heater_W_per_V2"] / nominal.input_gain
        numerator, denominator = realise([model["resistance_K_per_W"] * power, model["tau_s"]])
        return dataclasses.replace(
            nominal, numerator=tuple(numerator), denominator=tuple(denominator)
        )

    def true_loads(self) -> list[Load]:
        """Return the same for all slow periods."""
        return [self.true_load(k) for k in range(self.times_s.size)]

    def _parameters(self, k: int) -> BathParameters:
        """Return the bath as it is in a slow period, without what moves it."""
        scenario = self.scenario
        aged = 1.0 + scenario.ageing_per_h * float(self.times_s[k]) / 3600.0
        volume = float(self.volumes_gal[k]) / BathParameters().volume_gal
        return bath_parameters(volume, float(self.inflows[k]), scenario.resistance * aged)
