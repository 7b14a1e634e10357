"""A course of references and loads, the designed loop and a run over it, and runs in processes."""

from __future__ import annotations

import math
import multiprocessing
import signal
from array import array
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import MofNCompleteColumn, Progress

from adaptdrive.control.design.pole_placement import desired_polynomial
from adaptdrive.control.design.reference import AHEAD
from adaptdrive.control.loads.discretise import held_model
from adaptdrive.control.loads.load import Load
from adaptdrive.control.signals import Decision, Mode, Stage
from adaptdrive.control.vectors import Vector, total

Array = NDArray[np.float64]
Floats = Sequence[float]

COLUMNS = (
    *("output", "measured", "boost_reference_V", "applied_V", "adaptive", "accepted"),
    *("verdict", "innovation", "handover_step_V", "fallback"),
)
"""First columns of a run."""

_FLAGS = ("adaptive", "accepted", "fallback")

NO_TRIPS = (math.inf, math.inf)

PERIODS = ("time_s", "reference", "output", "adaptive")
"""First columns of a run of the daemon, whose slow periods follow the line's frequency."""


@dataclass(frozen=True, slots=True)
class Course:
    """Events in the course of a run.

    Attributes:
        references: r[k].
        sizes: Size that the load is to have in each slow period, as a multiple of the nominal one.
        disturbances: Measurement noise of every tick, and of one more.
        mode: Controller asked for.
        pole: Closed-loop pole.
        over_s: How long a change of the size takes.
        trips: Boost voltage in V and output above which the run ends early.
        burdens: What the load is disturbed by in each slow period, as its `disturb` takes it:
            torque in N m, or an inflow relative to that at the start. Empty for nothing.
        offset: What the sensor of the output shows in addition to the output.
        stops: Slow periods in which the drive is off; it precharges in the last of each.
        preview: Whether the controller receives the references to come.
        start: Output at which everything rests before; the first reference when left out.
    """

    references: Array
    sizes: Array
    disturbances: Array
    mode: Mode = Mode.FIXED
    pole: float = math.nan
    over_s: float = 0.0
    trips: tuple[float, float] = NO_TRIPS
    burdens: Array = field(default_factory=lambda: np.empty(0))
    offset: float = 0.0
    stops: tuple[range, ...] = ()
    preview: bool = False
    start: float | None = None

    def stage(self, k: int) -> Stage:
        """Return what the drive is to do in a slow period."""
        stop = next((one for one in self.stops if k in one), None)
        if stop is None:
            return Stage.RUN
        return Stage.PRECHARGE if k == stop[-1] else Stage.OFF

    def upcoming(self, k: int) -> tuple[float, ...]:
        """Return the references to come that the controller receives in a slow period."""
        if not self.preview:
            return ()
        last = len(self.references) - 1
        return tuple(float(self.references[min(k + i, last)]) for i in range(1, AHEAD))


def moving(
    times_s: Array, starts_s: Floats, levels: Floats, ramps_s: Floats | float = 0.0
) -> Array:
    """Return a quantity that moves from level to level.

    Args:
        times_s: When it is asked for.
        starts_s: When it begins to move to the next level.
        levels: One more than there are starts.
        ramps_s: How long each movement takes, or all of them; the next one ends it early.
    """
    found = np.full(times_s.size, levels[0])
    if isinstance(ramps_s, float):
        ramps_s = (ramps_s,) * len(starts_s)
    ends_s = [*starts_s, np.inf][1:]
    value = levels[0]
    for start_s, end_s, level, ramp_s in zip(starts_s, ends_s, levels[1:], ramps_s, strict=True):
        share = np.clip((times_s - start_s) / ramp_s, 0.0, 1.0) if ramp_s else np.ones(times_s.size)
        course = np.where(share < 1.0, value + share * (level - value), level)
        found = np.where(times_s >= start_s, course, found)
        reached = min(1.0, (end_s - start_s) / ramp_s) if ramp_s else 1.0
        value += reached * (level - value)
    return found


# The loop as it was designed: true load, no limits, delays or noise.


def follow_ideal(
    references: Array, loads: Sequence[Load], pole: float, period_s: float, *, paper: bool = False
) -> Array:
    """Follow set-points with the loop as it was designed.

    Args:
        references: r[k].
        loads: The true load in each slow period; all of one order.
        pole: Closed-loop pole.
        period_s: T_k.
        paper: Whether it was designed as in the paper.

    Returns:
        y[k], from rest on the first reference.
    """
    desired = desired_polynomial(pole, 2 * loads[0].order)
    first = float(references[0])
    moves = (references - first).tolist()
    weights: Vector = []
    outputs = [0.0] * len(moves)
    for k, load in enumerate(loads):
        if k == 0 or load != loads[k - 1]:
            weights = _weights(load, desired, period_s, paper=paper)
        for i in range(min(k + 1, len(weights))):
            outputs[k] += weights[i] * moves[k - i]
        for i in range(1, min(k + 1, len(desired))):
            outputs[k] -= desired[i] * outputs[k - i]
    return np.array(outputs) + first


def _weights(load: Load, desired: Vector, period_s: float, *, paper: bool) -> Vector:
    """A_m(1)/B(1) · B."""
    model = list(load.numerator), list(load.denominator)
    if paper:
        _, b = load.paper_model(*model, period_s)
    else:
        _, b = held_model(*model, period_s, 0.0, 0.0)
    scale = total(desired) / total(b)
    return [one * scale for one in b]


# The table of what a run has shown.


@dataclass(slots=True)
class Run:
    """A table with a row for each slow period, taken at its first tick.

    Attributes:
        trace: The numbers; NaN where the drive was off, and after the end of the run.
        names: Names of the columns: `COLUMNS`, the parameters of the load, their shown standard
            deviations (`NAME_std`), and what the runner has added; of a daemon `PERIODS` and the
            states of the plant.
        interlock: Cause that ended the run, 0 for nothing.
        trip: The trip of the daemon that ended it.
        refused: Answers to requests that the daemon refused.
        decisions: Of the controller.
        fast_output: Output without noise at every tick, where asked for.
        fast_voltage_V: Boost voltage at every tick, where asked for.
    """

    trace: Array
    names: tuple[str, ...]
    interlock: int = 0
    trip: str = ""
    refused: list[str] = field(default_factory=list)
    decisions: list[Decision] = field(default_factory=list)
    fast_output: array[float] = field(default_factory=lambda: array("d"))
    fast_voltage_V: array[float] = field(default_factory=lambda: array("d"))

    @classmethod
    def empty(cls, periods: int, load: tuple[str, ...]) -> Run:
        """Return a run in which nothing has happened yet.

        Args:
            periods: Its slow periods.
            load: Names of the parameters of the load.
        """
        names = (*COLUMNS, *load, *(f"{name}_std" for name in load))
        return cls(np.full((periods, len(names)), np.nan), names)

    def __getitem__(self, name: str) -> Array:
        """A column by its name; writing to it changes the table."""
        return self.trace[:, self.names.index(name)]

    def table(self, **constant: str) -> pa.Table:
        """Return the columns of a run, and of its decisions what the columns do not have.

        Args:
            constant: Columns that have one value.
        """
        rest = len(self.trace) - len(self.decisions)
        columns: dict[str, Any] = {name: self[name] for name in self.names}
        columns |= {name: self[name] > 0.0 for name in _FLAGS if name in self.names}
        columns["reason"] = [one.reason for one in self.decisions] + [""] * rest
        columns["gains"] = [list(one.gains) for one in self.decisions] + [None] * rest
        columns["excitation"] = [one.excitation for one in self.decisions] + [None] * rest
        columns |= {name: [value] * len(self.trace) for name, value in constant.items()}
        return pa.table(columns)

    def beside(self, **columns: Array) -> Run:
        """Return the run with more columns."""
        trace = np.column_stack((self.trace, *columns.values()))
        return replace(self, trace=trace, names=(*self.names, *columns))


# Runs in processes of their own, and the bar that shows how many are done.


def processes(count: int) -> ProcessPoolExecutor:
    """Return processes that inherit nothing and end quietly on Ctrl-C."""
    context, quietly = multiprocessing.get_context("spawn"), (signal.SIGINT, signal.SIG_DFL)
    return ProcessPoolExecutor(count, context, initializer=signal.signal, initargs=quietly)


@contextmanager
def progress(total: int) -> Iterator[Callable[[int, str], None]]:
    """Show a bar on a terminal, nothing in a pipe.

    Yields:
        Takes how many more of the total are done, and what to show about it.
    """
    columns = (*Progress.get_default_columns(), MofNCompleteColumn())
    console = Console(stderr=True)
    hidden = not console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=hidden) as bar:
        task = bar.add_task("", total=total)
        yield lambda count, what: bar.update(task, advance=count, description=what)
