"""One drawn run of any load: its course, its plant, and the controllers that run it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings
from adaptdrive.config.file import validate_configuration
from adaptdrive.control.controller import Controller
from adaptdrive.control.load import Load
from adaptdrive.control.settings import ControllerSettings
from adaptdrive.control.signals import Decision, Mode
from adaptdrive.control.waveform import Waveform
from adaptdrive_sim.compiled import bench
from adaptdrive_sim.compiled.run import run_compiled
from adaptdrive_sim.compiled.sources import compiled_modules
from adaptdrive_sim.course import Course, Run, TripLevels, run_course, start_at_rest
from adaptdrive_sim.experiments.examples import FOLDER, example_tables
from adaptdrive_sim.world import World

Array = NDArray[np.float64]
Row = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Deployed:
    """The daemon's default controller for a load."""

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
        interlock: Cause that ended the run, 0 for nothing.
    """

    trace: Array
    interlock: int


def read_deployed(name: str) -> Deployed:
    """Return what the daemon makes of an example configuration."""
    return deploy(name, example_tables(name))


def deploy(name: str, tables: dict[str, Any]) -> Deployed:
    """Return what the daemon makes of the tables of an example that may have been changed."""
    configuration = validate_configuration(tables, FOLDER / name)
    limits = configuration.interlocks
    return Deployed(
        settings=controller_settings(configuration),
        load=build_load(configuration),
        interlocks=TripLevels(limits.boost_voltage_max_V, limits.output_max),
        pole=configuration.load.pole,
        period_s=configuration.load.period_s,
    )


class DrawnScenario(Protocol):
    """Drawn values that the runs of all loads have."""

    @property
    def seed(self) -> int:
        """The seed that it was drawn from."""

    @property
    def duration_s(self) -> float:
        """Length."""

    @property
    def reference(self) -> Waveform:
        """The set-point."""

    @property
    def step(self) -> float:
        """Height of the reference's step."""

    def columns(self) -> Row:
        """Return the drawn values as columns of the results."""


class DrawnRun(ABC):
    """The course of one scenario, for as many controllers as are to run it.

    Attributes:
        own: The controller.
        scenario: What was drawn.
        times_s: The slow instants.
        references: r[k].
        seed: The seed that it was drawn from.
        step: Height of the reference's step.
        cycle_periods: Slow periods in one period of the reference.
    """

    scenario: DrawnScenario
    references: Array

    def __init__(self, own: Deployed, scenario: DrawnScenario) -> None:
        self.own, self.scenario = own, scenario
        self.seed, self.step = scenario.seed, scenario.step
        self.cycle_periods = round(scenario.reference.period_s / own.period_s)
        self.times_s: Array = own.period_s * np.arange(
            round(scenario.duration_s / own.period_s), dtype=np.float64
        )

    @property
    @abstractmethod
    def offset(self) -> float:
        """Offset of the sensor of the output."""

    @property
    @abstractmethod
    def largest_movement(self) -> float:
        """Movement of the output by the reference's step or by the largest disturbance."""

    @property
    @abstractmethod
    def size(self) -> tuple[str, Array]:
        """Name of what changes of the load, and its course."""

    @property
    @abstractmethod
    def change_times_s(self) -> tuple[float, ...]:
        """Times at which it begins to change."""

    @abstractmethod
    def course(self, mode: Mode) -> Course:
        """Return what happens in the run."""

    @abstractmethod
    def world(self) -> World:
        """Return the plant as it is at the start."""

    @abstractmethod
    def true_load(self, k: int) -> Load:
        """Return the model of the true load in a slow period."""

    @abstractmethod
    def true_loads(self) -> list[Load]:
        """Return the same for all slow periods."""

    def run(self, mode: Mode) -> RunOutcome:
        """Run compiled code, which knows no stops: a run with stops is interpreted."""
        course = self.course(mode)
        if course.stops:
            return self.run_deployed(mode)[0]
        return RunOutcome(*run_compiled(*self._start(course), course))

    def run_deployed(self, mode: Mode) -> tuple[RunOutcome, list[Decision]]:
        """Run the deployed controller itself, interpreted."""
        course = self.course(mode)
        run = run_course(*self._start(course), course, self.own.settings.rates)
        trace = _trace(run, len(course.references), self.own.load.names)
        return RunOutcome(trace, run.interlock), run.decisions

    def stops(self) -> tuple[range, ...]:
        """Return the slow periods in which the drive is off."""
        return ()

    def running(self) -> NDArray[np.bool_]:
        """Return in which slow periods the drive runs and is regulated.

        In the first one after a stop the controller collects what its first decision needs.
        """
        found = np.full(self.times_s.size, fill_value=True)
        for stop in self.stops():
            found[stop.start : stop.stop + 1] = False
        return found

    def ideal(self) -> Array:
        """Output of the loop as designed, at each slow instant."""
        loads = self.true_loads()
        numerators = np.array([one.numerator for one in loads])
        denominators = np.array([one.denominator for one in loads])
        follow: Any = compiled_modules()[bench.__name__].follow_ideal
        own = self.own
        found: Array = follow(self.references, numerators, denominators, own.pole, own.period_s)
        return found

    def truth_at(self, k: int) -> Array:
        """Return the true physical parameters in a slow period."""
        load = self.true_load(k)
        return np.array(load.physical(list(load.numerator), list(load.denominator)))

    def _start(self, course: Course) -> tuple[Controller, World]:
        """Everything at rest on the first reference."""
        world = self.world()
        controller = Controller(self.own.settings, self.own.load)
        start_at_rest(controller, world, course, float(course.references[0]))
        return controller, world


def _trace(run: Run, periods: int, names: tuple[str, ...]) -> Array:
    """Return a run in the columns of `compiled.bench`."""
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
