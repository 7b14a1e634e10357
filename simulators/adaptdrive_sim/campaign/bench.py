"""Runs a scenario: plant, controller and course from what was drawn."""

from __future__ import annotations

import dataclasses
import tomllib
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings
from adaptdrive.config.file import validate_configuration
from adaptdrive.control.controller import Controller
from adaptdrive.control.load import Load
from adaptdrive.control.loads.motor import motor_load
from adaptdrive.control.settings import ControllerSettings
from adaptdrive.control.signals import Decision, Mode
from adaptdrive_sim.campaign.scenario import Scenario
from adaptdrive_sim.compiled import bench
from adaptdrive_sim.compiled.run import run_compiled
from adaptdrive_sim.compiled.sources import compiled_modules
from adaptdrive_sim.course import Course, Run, TripLevels, run_course, start_at_rest
from adaptdrive_sim.experiments.examples import FOLDER
from adaptdrive_sim.plants.coupling import CouplingParameters
from adaptdrive_sim.plants.motor import Motor, MotorParameters
from adaptdrive_sim.world import World, WorldParameters

Array = NDArray[np.float64]

WARM_UP_s = 90.0


@dataclass(frozen=True, slots=True)
class Deployed:
    """The daemon's default controller for the motor."""

    settings: ControllerSettings
    load: Load
    interlocks: TripLevels
    pole: float
    period_s: float


@dataclass(frozen=True, slots=True)
class RunOutcome:
    """One run with one controller.

    Attributes:
        trace: A row of `compiled.bench` columns for each slow period.
        interlock: What ended the run, 0 for nothing.
    """

    trace: Array
    interlock: int


@cache
def deployed() -> Deployed:
    """The example configuration, for a run that starts at rest."""
    path = FOLDER / "motor.toml"
    tables = tomllib.loads(path.read_text(encoding="utf-8"))
    configuration = validate_configuration(tables, path)
    settings = controller_settings(configuration)
    period_s = configuration.load.period_s
    settings = dataclasses.replace(
        settings,
        learning=dataclasses.replace(settings.learning, settle_periods=0),
        jacket=dataclasses.replace(settings.jacket, warm_up_periods=round(WARM_UP_s / period_s)),
    )
    limits = configuration.interlocks
    return Deployed(
        settings=settings,
        load=build_load(configuration),
        interlocks=TripLevels(limits.boost_voltage_max_V, limits.output_max),
        pole=configuration.load.pole,
        period_s=period_s,
    )


class Stand:
    """The course of one scenario, for as many controllers as are to run it."""

    def __init__(self, scenario: Scenario) -> None:
        own = deployed()
        self.scenario = scenario
        periods = round(scenario.duration_s / own.period_s)
        self.times_s: Array = own.period_s * np.arange(periods, dtype=np.float64)
        self.inertias = scenario.inertias_at(self.times_s)
        self.references = scenario.references_at(self.times_s)
        ticks = self.times_s.size * own.settings.rates.ticks_per_period
        self._disturbances = scenario.life.offset + scenario.disturbances(ticks + 1)

    def run(self, mode: Mode) -> RunOutcome:
        """Run compiled code, which knows no stops: a run with stops is interpreted."""
        course = self.course(mode)
        if course.stops:
            return self.run_deployed(mode)[0]
        return RunOutcome(*run_compiled(*self._start(course), course))

    def running(self) -> NDArray[np.bool_]:
        """Return in which slow periods the drive runs and is regulated.

        In the first one after a stop the controller collects what its first decision needs.
        """
        found = np.full(self.times_s.size, fill_value=True)
        for stop in self.scenario.life.stops(deployed().period_s):
            found[stop.start : stop.stop + 1] = False
        return found

    def run_deployed(self, mode: Mode) -> tuple[RunOutcome, list[Decision]]:
        """Run the deployed controller itself, interpreted."""
        course = self.course(mode)
        run = run_course(*self._start(course), course, deployed().settings.rates)
        return RunOutcome(_trace(run, len(course.references)), run.interlock), run.decisions

    def ideal(self) -> Array:
        """Output of the loop as designed, at each slow instant."""
        own = deployed()
        models = {
            inertia: self._true_load(inertia) for inertia in np.unique(self.inertias).tolist()
        }
        numerators = np.array([models[inertia].numerator for inertia in self.inertias.tolist()])
        denominators = np.array([models[one].denominator for one in self.inertias.tolist()])
        follow: Any = compiled_modules()[bench.__name__].follow_ideal
        found: Array = follow(self.references, numerators, denominators, own.pole, own.period_s)
        return found

    def truth_of(self, inertia: float) -> Array:
        """True physical parameters at an inertia."""
        load = self._true_load(inertia)
        return np.array(load.physical(list(load.numerator), list(load.denominator)))

    def _true_load(self, inertia: float) -> Load:
        motor, coupling = Motor(self.scenario.motor()), CouplingParameters()
        motor.set_inertia(MotorParameters().disk_kgm2 * inertia)
        reference = self.scenario.reference
        middle = 0.5 * (reference.low + reference.high) - self.scenario.life.offset
        motor.speed_rad_s = middle / motor.parameters.tachometer_Vs
        model = motor.model(coupling.ratio, coupling.droop_Ohm)
        return motor_load(model["gain"], model["tau_motor_s"], model["tau_filter_s"])

    def course(self, mode: Mode) -> Course:
        """Return what happens in the run."""
        return Course(
            self.references,
            self.inertias,
            0.0,
            self._disturbances,
            mode,
            deployed().pole,
            self.scenario.wire(),
            deployed().interlocks,
            self.scenario.life.torques_at(self.times_s),
            self.scenario.life.offset,
            self.scenario.life.stops(deployed().period_s),
        )

    def world(self) -> World:
        """Return the plant as it is at the start."""
        motor = Motor(self.scenario.motor())
        motor.resize(float(self.inertias[0]), 0.0)
        return World(motor, WorldParameters(line=self.scenario.line()))

    def _start(self, course: Course) -> tuple[Controller, World]:
        """Everything at rest on the first reference."""
        own, world = deployed(), self.world()
        controller = Controller(own.settings, own.load)
        start_at_rest(controller, world, course, float(course.references[0]))
        return controller, world


def _trace(run: Run, periods: int) -> Array:
    """Return a run in the columns of `compiled.bench`."""
    names = deployed().load.names
    trace = np.full((periods, bench.VALUES + 2 * len(names)), np.nan)
    rows = np.full((len(run.decisions), trace.shape[1]), np.nan)
    rows[:, bench.OUTPUT] = run.outputs
    rows[:, bench.MEASURED] = [one.output for one in run.snapshots]
    rows[:, bench.REFERENCE_V] = [one.boost_reference_V for one in run.decisions]
    rows[:, bench.APPLIED_V] = [one.applied_V for one in run.snapshots]
    rows[:, bench.ADAPTIVE] = [one.controller is Mode.ADAPTIVE for one in run.decisions]
    rows[:, bench.ACCEPTED] = [one.accepted for one in run.decisions]
    rows[:, bench.VERDICT] = run.verdicts
    rows[:, bench.FALLBACK] = run.fallbacks
    rows[:, bench.INNOVATION] = [one.innovation for one in run.decisions]
    rows[:, bench.HANDOVER_V] = [one.handover_step_V for one in run.decisions]
    for i, name in enumerate(names, bench.VALUES):
        rows[:, i] = [one.estimates[name].value for one in run.decisions]
        rows[:, i + len(names)] = [one.estimates[name].std for one in run.decisions]
    trace[run.periods] = rows
    return trace
