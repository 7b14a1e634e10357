"""The daemon's controller in closed loop with a plant, in virtual time.

The order of calls is that of `control.schedule`: nothing waits, and time passes as fast as the
machine counts it. A command that is computed from the measurement at tick n is latched by the drive
at the end of the half cycle after it, and acts from tick n+1.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from adaptdrive.analysis.curves import Array
from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings
from adaptdrive.config import Configuration
from adaptdrive.control import signals
from adaptdrive.control.controller import Controller
from adaptdrive.control.schedule import Schedule
from adaptdrive.safety.timing import timing_of
from adaptdrive.util.errors import IdentificationError

if TYPE_CHECKING:
    from polars import DataFrame  # the simulators do without

# A controller in front of a drive with its load, tick after tick.


class Loop(ABC):
    """A controller in front of a drive with its load.

    Attributes:
        controller: The controller.
        snapshot: The last snapshot, None before the first.
        decision: What the slow half made of it.
        upcoming: Set-points to come that no order has.
        interlock: Number of the interlock that the last measurement trips, 0 for none.
    """

    upcoming: tuple[float, ...] = ()
    interlock = 0

    def __init__(self, controller: Controller) -> None:
        """Begin with nothing decided."""
        self.controller = controller
        self.snapshot: signals.Snapshot | None = None
        self.decision: signals.Decision | None = None
        self._schedule = Schedule(controller, controller.settings.rates.latency_ticks)

    @abstractmethod
    def measure(self, tick: int) -> signals.Measurement:
        """Return what the drive reports at a tick, which is asked for once."""

    @abstractmethod
    def step(self, command: signals.Command) -> None:
        """Let the time until the next report pass; the drive latches the command at its end."""

    def control(
        self, measurement: signals.Measurement, order: signals.Order
    ) -> tuple[signals.Command, bool]:
        """Run the controller for one tick; return whether it has decided."""
        command = self._schedule.tick(measurement, order)
        snapshot = self._schedule.take_snapshot()
        if snapshot is not None:
            if self.upcoming:
                snapshot = replace(snapshot, upcoming=self.upcoming)
            self.snapshot, self.decision = snapshot, self._schedule.decide(snapshot)
        return command, snapshot is not None

    def readings(
        self, course: Iterable[signals.Order], stride: int = 1
    ) -> Iterator[tuple[signals.Measurement, signals.Order, bool]]:
        """Run over a course, until an interlock trips.

        Args:
            course: The order at each reading of the drive.
            stride: Ticks from one reading to the next.

        Yields:
            The measurement, the order, and whether the controller has decided, at each reading.
        """
        for number, order in enumerate(course):
            measurement = self.measure(number * stride)
            if self.interlock:
                return
            command, decided = self.control(measurement, order)
            yield measurement, order, decided
            self.step(command)


# A plant of the user behind the output stage of a drive.


class Plant(Protocol):
    """A load behind the boost capacitor."""

    def step(self, boost_voltage_V: float, duration_s: float) -> tuple[float, float]:
        """Advance under a boost voltage.

        Args:
            boost_voltage_V: Mean boost voltage over the step.
            duration_s: Length of the step.

        Returns:
            The output at the end of the step, and the mean power drawn, in W.
        """


class PlantLoop(Loop):
    """The controller of a configuration in front of a plant behind the output stage of its drive.

    Where the daemon controls it, the stage is a boost capacitor on an ideal line, which the
    rectifier keeps at the line's peak at least. A drive with a loop of its own follows V_c.

    Attributes:
        voltage_V: v_bst at the end of the last step.
        output: Output of the plant at the end of the last step.
    """

    def __init__(
        self,
        configuration: Configuration,
        plant: Plant,
        voltage_V: float | None = None,
        prior: tuple[float, ...] | None = None,
        *,
        follows: bool = False,
    ) -> None:
        """Put a plant behind the output stage of a configuration, and take its first step.

        Args:
            configuration: The drive.
            plant: The plant.
            voltage_V: v_bst at the start; the lowest V_c, or 0 where that is negative, when None.
            prior: Parameters that an earlier run trusted, in the order of `Load.names`.
            follows: Whether v_bst follows V_c, whoever controls it.

        Raises:
            IdentificationError: The plant has no step, or returns a value that is not finite.
        """
        settings, drive = controller_settings(configuration), configuration.drive
        super().__init__(Controller(settings, build_load(configuration), prior))
        self._drive, self._step_s = drive, timing_of(configuration).reading_s
        self._follows = follows or configuration.voltage_loop.where == "drive"
        self._floor_V = -math.inf if self._follows else math.sqrt(2.0) * drive.line_voltage_V
        lag_s = settings.rates.lag_ticks * settings.rates.nominal_tick_s
        self._share = -math.expm1(-self._step_s / lag_s) if lag_s else 1.0
        own_s = getattr(plant, "step_s", None)
        self._plant = plant if own_s is None else OwnStep(plant, float(own_s))
        self._latched: signals.Command | None = None
        start_V = max(0.0, drive.limits.boost_reference_min_V) if voltage_V is None else voltage_V
        self.voltage_V = max(self._floor_V, start_V)
        self._steps = 0
        self._advance(self.voltage_V)

    @property
    def time_s(self) -> float:
        """Time so far."""
        return self._steps * self._step_s

    def measure(self, tick: int) -> signals.Measurement:
        """Return what the drive reports at a tick."""
        line_V, half_cycle_s = self._drive.line_voltage_V, self._drive.half_cycle_s
        known = self.voltage_V, line_V, self._power_W, self.output
        return signals.Measurement(tick, half_cycle_s, *known)

    def step(self, command: signals.Command) -> None:
        """Advance to the next reading under the command before; latch this one.

        Raises:
            IdentificationError: The plant returns a value that is not finite.
        """
        acting, before_V = self._latched or command, self.voltage_V
        self._latched = command
        self.voltage_V = max(self._floor_V, self._next_V(acting))
        self._steps += 1
        self._advance(0.5 * (before_V + self.voltage_V))

    def _next_V(self, command: signals.Command) -> float:
        before_V = self.voltage_V
        if self._follows:
            return before_V + self._share * (command.boost_reference_V - before_V)
        fed_W = command.current_scale_S * self._drive.line_voltage_V**2
        kept_V2 = 2.0 * self._step_s / self._drive.boost_capacitance_F * (fed_W - self._power_W)
        return math.sqrt(max(0.0, before_V**2 + kept_V2))

    def _advance(self, voltage_V: float) -> None:
        # a plant may count in numpy, whose numbers keep their own precision in all that follows
        self.output, self._power_W = map(float, self._plant.step(voltage_V, self._step_s))
        if not (math.isfinite(self.output) and math.isfinite(self._power_W)):
            returned = f"output {self.output} and power {self._power_W} W"
            raise IdentificationError(f"the plant returned {returned} at {self.time_s:g} s")


class OwnStep:
    """Steps a plant at its own rate; between two of its steps its output is held.

    A plant states the rate in an attribute `step_s`, the seconds of one step.
    """

    def __init__(self, plant: Plant, step_s: float) -> None:
        """Take a plant.

        Args:
            plant: The plant.
            step_s: Length of each of its steps.

        Raises:
            IdentificationError: That is no length of time.
        """
        if not 0.0 < step_s < math.inf:
            raise IdentificationError(f"step_s of the plant is {step_s}, and must be above 0 s")
        self._plant, self._step_s = plant, step_s
        self._elapsed_s = self._fed_Vs = self._due_s = 0.0
        self._answer: tuple[float, float] | None = None

    def step(self, boost_voltage_V: float, duration_s: float) -> tuple[float, float]:
        """Advance by as many steps as end until then, under the mean voltage since the last one.

        Args:
            boost_voltage_V: Mean boost voltage over the time.
            duration_s: The time.

        Returns:
            The output at the end of the last step, and the mean power since the one before, in W.
        """
        self._elapsed_s += duration_s
        self._fed_Vs += boost_voltage_V * duration_s
        self._due_s += duration_s
        count = math.floor(self._due_s / self._step_s + 1e-9)
        if self._answer is not None and count <= 0:
            return self._answer
        count = max(1, count)  # a slow plant too has an output from the start on
        mean_V = self._fed_Vs / self._elapsed_s
        answers = [self._plant.step(mean_V, self._step_s) for _ in range(count)]
        self._elapsed_s = self._fed_Vs = 0.0
        self._due_s -= count * self._step_s
        self._answer = answers[-1][0], sum(power_W for _, power_W in answers) / count
        return self._answer


# A plant in closed loop with the controller of a configuration.


@dataclass(frozen=True, slots=True)
class Simulation:
    """A simulated closed loop.

    Attributes:
        columns: Time, set-point, output, boost voltage and load power at each reading.
        steps: Each slow step: output, V_c, controller, reason, estimates and their deviations.
        fault: Cause that ended it early, empty for none.
        configuration: The one that the controller ran with.
    """

    columns: dict[str, Array]
    steps: list[dict[str, Any]]
    fault: str
    configuration: Configuration

    @property
    def ticks(self) -> DataFrame:
        """The readings as a table."""
        return _table(self.columns)

    @property
    def slow(self) -> DataFrame:
        """The slow steps as a table."""
        return _table(self.steps)


def _table(content: Any) -> DataFrame:  # noqa: ANN401 - columns or rows
    from polars import DataFrame  # noqa: PLC0415 - see above

    return DataFrame(content)


_COLUMNS = ("time_s", "reference", "output", "boost_voltage_V", "load_power_W")


def simulate(
    configuration: Configuration,
    plant: Plant,
    course: Iterable[signals.Order],
    voltage_V: float | None = None,
    prior: tuple[float, ...] | None = None,
) -> Simulation:
    """Run the controller of a configuration on a plant.

    Args:
        configuration: The configuration.
        plant: The plant.
        course: The order at each reading of the drive.
        voltage_V: As of `PlantLoop`.
        prior: As of `PlantLoop`.

    Raises:
        IdentificationError: The plant has no step, or returns a value that is not finite.
    """
    loop = PlantLoop(configuration, plant, voltage_V, prior)
    rows, steps, fault = [], list[dict[str, Any]](), ""
    for one, order, decided in loop.readings(course, configuration.bus.ticks_per_reading):
        known = one.output, one.boost_voltage_V, one.load_power_W
        rows.append((loop.time_s, order.reference, *known))
        if decided and loop.snapshot is not None and loop.decision is not None:
            steps.append(_slow_row(loop.snapshot, loop.decision, one.tick_period_s))
            if fault := loop.decision.fault:
                break
    columns = np.array(rows).reshape(len(rows), len(_COLUMNS)).T.copy()
    return Simulation(dict(zip(_COLUMNS, columns, strict=True)), steps, fault, configuration)


def setpoints(
    configuration: Configuration,
    setpoint: Callable[[float], float],
    duration_s: float,
    mode: signals.Mode,
) -> Iterator[signals.Order]:
    """Yield the orders of a course of the set-point.

    Args:
        configuration: The drive, whose pole is kept.
        setpoint: Set-point at each time, in s.
        duration_s: Length of the course.
        mode: Controller asked for.

    Raises:
        IdentificationError: A set-point is not finite.
    """
    reading_s, pole = timing_of(configuration).reading_s, configuration.load.pole
    for number in range(round(duration_s / reading_s)):
        wanted = float(setpoint(number * reading_s))
        if not math.isfinite(wanted):
            raise IdentificationError(f"the set-point at {number * reading_s:g} s is {wanted}")
        yield signals.Order(signals.Stage.RUN, wanted, mode, pole)


def _slow_row(
    snapshot: signals.Snapshot, decision: signals.Decision, half_cycle_s: float
) -> dict[str, Any]:
    return {
        "time_s": snapshot.tick * half_cycle_s,
        "reference": snapshot.order.reference,
        "output": snapshot.output,
        "boost_reference_V": decision.boost_reference_V,
        "controller": str(decision.controller),
        "accepted": decision.accepted,
        "reason": decision.reason,
        **{f"estimate_{name}": one.value for name, one in decision.estimates.items()},
        **{f"estimate_{name}_std": one.std for name, one in decision.estimates.items()},
    }
