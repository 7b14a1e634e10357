"""One drawn run of any load: what was drawn, its course, its plant, and what a run of it shows."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields, is_dataclass, replace
from enum import Enum
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings
from adaptdrive.config.file import validate_configuration
from adaptdrive.control import controller, signals
from adaptdrive.control.loads.load import Load
from adaptdrive.control.settings import ControllerSettings
from adaptdrive.control.supervision.supervisor import Verdict
from adaptdrive_sim.campaign.settings import Range, WholeRange
from adaptdrive_sim.course import Array, Course, Run, follow_ideal
from adaptdrive_sim.experiments.case import from_rest
from adaptdrive_sim.parameters import EXAMPLES, example_tables
from adaptdrive_sim.plants.boost import LineParameters
from adaptdrive_sim.site import Site
from adaptdrive_sim.wire import Wire
from adaptdrive_sim.world import World

Numbers = tuple[float, ...]
Row = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Deployed:
    """The daemon's default controller for a load."""

    settings: ControllerSettings
    load: Load
    trips: tuple[float, float]
    pole: float
    period_s: float


def deploy(name: str, tables: dict[str, Any] | None = None) -> Deployed:
    """Return what the daemon makes of an example configuration, or of its changed tables."""
    configuration = validate_configuration(tables or example_tables(name), EXAMPLES / name)
    settings, load = controller_settings(configuration), build_load(configuration)
    limits, section = configuration.interlocks, configuration.load
    trips = limits.boost_voltage_max_V, limits.output_max
    return Deployed(settings, load, trips, section.pole, section.period_s)


WARM_UP_s = 90.0


def at_rest(own: Deployed) -> Deployed:
    """Return the same for a run that starts at rest."""
    return replace(own, settings=from_rest(own.settings, WARM_UP_s, own.period_s))


@dataclass(frozen=True, slots=True)
class Drawn:
    """Drawn values that the runs of motors and baths have.

    Attributes:
        seed: It was drawn from this.
        duration_s: Length.
        reference: The set-point.
        sigma: Noise of every sample, in the unit of the output.
        spike_share: Share of spikes.
        spike_sigma: Noise of the spikes, in the unit of the output.
        line_voltage: Relative line voltage.
        frequency_Hz: Of the line.
        output_delay_ticks: Age of the output's samples.
        output_quantum: Resolution of the output.
        voltage_V: Resolution of voltages.
        power_W: Resolution of the load power.
        scale_S: Resolution of the current scale.
    """

    seed: int
    duration_s: float
    reference: signals.Waveform
    sigma: float
    spike_share: float
    spike_sigma: float
    line_voltage: float
    frequency_Hz: float
    output_delay_ticks: int
    output_quantum: float
    voltage_V: float
    power_W: float
    scale_S: float

    @property
    def step(self) -> float:
        """Height of the reference's step."""
        return self.reference.high - self.reference.low

    def references_at(self, times_s: Array) -> Array:
        """Return the set-point at each time."""
        return np.array([self.reference.value(time_s) for time_s in times_s.tolist()])

    def disturbances(self, count: int, offset: float = 0.0) -> Array:
        """Measurement noise of every tick, and the offset of the sensor."""
        rng = np.random.default_rng([self.seed, 1])
        noise = offset + self.sigma * rng.standard_normal(count)
        if self.spike_share > 0.0:
            struck = np.flatnonzero(rng.random(count) < self.spike_share)
            noise[struck] += self.spike_sigma * rng.standard_normal(struck.size)
        return noise

    def line(self) -> LineParameters:
        """The true line."""
        return LineParameters.steady(self.line_voltage, self.frequency_Hz)

    def wire(self, output: float) -> Wire:
        """Return the connection between drive and controller, at rest at an output."""
        outputs = [output] * (self.output_delay_ticks + 1)
        return Wire(outputs, self.output_quantum, self.voltage_V, self.power_W, self.scale_S)


def columns_of(drawn: Any) -> Row:  # noqa: ANN401 - any dataclass
    """Return drawn values as columns; of several, how many, the first, the last and the largest."""
    row: Row = {}
    for one in fields(drawn):
        value, name = getattr(drawn, one.name), one.name
        if isinstance(value, tuple):
            first, last = (value[0], value[-1]) if value else (0.0, 0.0)
            row |= {f"{name}_count": len(value), f"{name}_first": first, f"{name}_last": last}
            row[f"{name}_largest"] = max(value, default=0.0)
        elif is_dataclass(value):
            row |= columns_of(value)
        else:
            row[name] = value.value if isinstance(value, Enum) else value
    return row


def uniform(rng: np.random.Generator, ends: Range) -> float:
    """Draw a number."""
    return float(rng.uniform(*ends))


def each(rng: np.random.Generator, ranges: object, *names: str) -> dict[str, Any]:
    """Draw a number from each of some ranges, in the order of their names."""
    return {name: uniform(rng, getattr(ranges, name)) for name in names}


def whole(rng: np.random.Generator, ends: WholeRange) -> int:
    """Draw a whole number; both ends are possible."""
    return int(rng.integers(ends[0], ends[1] + 1))


def times(rng: np.random.Generator, count: int, begin_s: float, end_s: float) -> Numbers:
    """Draw whole seconds in their order."""
    return tuple(np.sort(np.round(rng.uniform(begin_s, end_s, count))).tolist())


def several_sizes(
    rng: np.random.Generator, ends: Range, unchanged: float, changes: WholeRange, least: float
) -> Numbers:
    """Draw the size of a load, and those that it changes to in the same run.

    Args:
        rng: Of random numbers.
        ends: Smallest and largest size.
        unchanged: Share of runs in which it never changes.
        changes: How often it changes in the others.
        least: By this factor at least, up or down.
    """
    sizes = [uniform(rng, ends)]
    count = 0 if rng.random() < unchanged else whole(rng, changes)
    for _ in range(count):
        sizes.append(_another(rng, ends, least, sizes[-1]))
    return tuple(sizes)


def _another(rng: np.random.Generator, ends: Range, least: float, present: float) -> float:
    """Draw a size that differs by the least factor, in either direction."""
    low, high = ends
    below, above = present / least, present * least
    room_below, room_above = max(0.0, below - low), max(0.0, high - above)
    if room_below + room_above == 0.0:
        return low if present > 0.5 * (low + high) else high
    place = uniform(rng, (0.0, room_below + room_above))
    return low + place if place < room_below else above + place - room_below


def within_reach(low: float, step: float, reach: Range) -> Range:
    """Return the ends of a step of the set-point, moved into what V_c holds.

    Args:
        low: The lower one that is wanted.
        step: The height that is wanted.
        reach: The least and the largest set-point.
    """
    least, most = reach
    height = min(step, most - least)
    low = min(max(low, least), most - height)
    return low, low + height


class DrawnRun(ABC):
    """The course of one scenario of a load that is regulated from start to end.

    Attributes:
        own: The controller.
        seed: The seed that it was drawn from.
        step: Height of the reference's step.
        cycle_periods: Slow periods at the end of a run that show whether it is stable.
        largest_movement: Movement of the output by the reference's step or by the largest
            disturbance.
        times_s: The slow instants.
        ticks: How many half cycles it has.
        plan: What happens, to the controllers of both modes.
        sizes: What changes of the load.
        change_times_s: Times at which it begins to change.
    """

    plan: Course
    sizes: Array
    change_times_s: Numbers
    largest_movement: float

    def __init__(self, own: Deployed, scenario: Drawn, shown: float) -> None:
        """Begin the course of a scenario.

        Args:
            own: The controller.
            scenario: What was drawn.
            shown: Output that a late sensor shows at first.
        """
        self.own = own
        self.seed, self.step = scenario.seed, scenario.step
        self.cycle_periods = round(scenario.reference.period_s / own.period_s)
        periods = round(scenario.duration_s / own.period_s)
        self.times_s: Array = own.period_s * np.arange(periods, dtype=np.float64)
        self.ticks = periods * own.settings.rates.ticks_per_period
        self._drawn, self._wire = scenario, partial(scenario.wire, shown)

    def columns(self) -> Row:
        """Return the drawn values as columns of the results."""
        row = columns_of(self._drawn) | {"step": self.step, "changes": len(self.change_times_s)}
        return row | {"size_largest": float(np.max(self.sizes))}

    def course(self, mode: signals.Mode) -> Course:
        """Return what happens in the run."""
        return replace(self.plan, mode=mode, pole=self.own.pole, trips=self.own.trips)

    @abstractmethod
    def world(self) -> World:
        """Return the plant as it is at the start."""

    @abstractmethod
    def true_load(self, k: int) -> Load:
        """Return the model of the true load in a slow period."""

    def true_loads(self) -> list[Load]:
        """Return the same for all slow periods."""
        return [self.true_load(k) for k in range(len(self.sizes))]

    def site(self) -> Site:
        """Return the controller and the plant."""
        control = controller.Controller(self.own.settings, self.own.load)
        return Site(control, self.world(), self._wire())

    def run(self, mode: signals.Mode) -> Run:
        """Run the deployed controller."""
        return self.site().run(self.course(mode))

    def described(self, run: Run) -> Run:
        """Return a run with what it was to follow, and the loop as designed."""
        given = {"time_s": self.times_s, "reference": self.plan.references, "size": self.sizes}
        return run.beside(**given, ideal=self.ideal)

    def errors(self, run: Run) -> Array:
        """Return the differences to the designed loop while the drive runs."""
        shown = run["output"] + self.plan.offset
        found: Array = ((shown - self.ideal) / self.step)[self.running()]
        return found

    def seen(self, run: Run) -> Row:
        """Return what the supervisor has done, and the errors of the estimates at the end."""
        in_force, verdicts = run["adaptive"] > 0.0, run["verdict"]
        wanted_V = run["boost_reference_V"]
        saturated = (wanted_V <= 200.0 + 1e-9) | (wanted_V >= 400.0 - 1e-9)
        truth = self.truth_at(self.times_s.size - 1)
        estimates = np.array([run[name][-1] for name in self.own.load.names])
        row: Row = {
            "adaptive_share": float(np.mean(in_force)),
            "accepted_share": float(np.mean(run["accepted"] > 0.0)),
            "switches": int(np.count_nonzero(np.diff(in_force.astype(int)))),
            "estimate_error": float(np.max(np.abs(estimates / truth - 1.0))),
            "saturated_share": float(np.mean(saturated)),
        }
        for verdict in Verdict:
            row[f"verdict_{verdict.name.lower()}"] = int(np.count_nonzero(verdicts == verdict))
        return row

    def running(self) -> NDArray[np.bool_]:
        """Return in which slow periods the drive runs and is regulated.

        In the first one after a stop the controller collects what its first decision needs.
        """
        found = np.full(self.times_s.size, fill_value=True)
        for stop in self.plan.stops:
            found[stop.start : stop.stop + 1] = False
        return found

    @cached_property
    def ideal(self) -> Array:
        """Output of the loop as designed, at each slow instant."""
        own = self.own
        return follow_ideal(self.plan.references, self.true_loads(), own.pole, own.period_s)

    def truth_at(self, k: int) -> Array:
        """Return the true physical parameters in a slow period."""
        load = self.true_load(k)
        return np.array(load.physical(list(load.numerator), list(load.denominator)))
