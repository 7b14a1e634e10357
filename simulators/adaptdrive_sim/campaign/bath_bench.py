"""Runs a scenario of a bath: plant, controller and course from what was drawn."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np

from adaptdrive.control.load import Load
from adaptdrive.control.loads.bath import realise
from adaptdrive.control.signals import Mode
from adaptdrive_sim.campaign.bath_scenario import BathScenario
from adaptdrive_sim.campaign.bath_settings import bath_parameters
from adaptdrive_sim.campaign.drawn import Deployed, DrawnRun, Row, read_deployed
from adaptdrive_sim.campaign.life import moving
from adaptdrive_sim.course import Course
from adaptdrive_sim.plants.bath import Bath, BathParameters
from adaptdrive_sim.plants.coupling import CouplingParameters
from adaptdrive_sim.world import World, WorldParameters


@cache
def deployed_bath() -> Deployed:
    """The example configuration."""
    return read_deployed("bath.toml")


class BathStand(DrawnRun):
    """The course of one scenario of a bath; its size is the volume in US gallons."""

    size_name = "volume_gal"

    def __init__(self, scenario: BathScenario) -> None:
        super().__init__(deployed_bath(), scenario, scenario.offset_K, scenario.reference.low)
        self.scenario = scenario
        self.change_times_s = scenario.fill_times_s
        ramps_s = (scenario.fill_s,) * len(self.change_times_s)
        self.sizes = moving(self.times_s, self.change_times_s, scenario.volumes_gal, ramps_s)
        self.inflows = scenario.inflows_at(self.times_s)
        self.references = scenario.references_at(self.times_s)
        flows = scenario.inflows
        moved_K = (max(flows) / min(flows) - 1.0) * scenario.reference.high
        self.largest_movement = max(self.step, moved_K)

    def columns(self) -> Row:
        """Return the drawn values as columns of the results."""
        return self.scenario.columns()

    def course(self, mode: Mode) -> Course:
        """Return what happens in the run."""
        scenario, own = self.scenario, self.own
        ticks = self.times_s.size * own.settings.rates.ticks_per_period
        moves = scenario.inflow_times_s
        return Course(
            self.references,
            scenario.targets_gal_at(self.times_s) / scenario.volumes_gal[0],
            scenario.fill_s,
            scenario.disturbances(ticks + 1, self.offset),
            mode,
            own.pole,
            own.interlocks,
            self.inflows / scenario.inflows[0] if moves else np.empty(0),
            self.offset,
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

    def _parameters(self, k: int) -> BathParameters:
        """Return the bath as it is in a slow period, without what moves it."""
        scenario = self.scenario
        aged = 1.0 + scenario.ageing_per_h * float(self.times_s[k]) / 3600.0
        volume = float(self.sizes[k]) / BathParameters().volume_gal
        return bath_parameters(volume, float(self.inflows[k]), scenario.resistance * aged)
