"""The daemon's controller in closed loop with a plant, in virtual time.

The order of calls is that of `control.schedule`. A command that is computed from the measurement
at tick n is latched by the drive at the end of the half cycle after it, and acts from tick n+1.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import polars as pl

from adaptdrive.analysis.curves import Array, Quality, quality_of
from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings
from adaptdrive.config import Configuration
from adaptdrive.config.load import AnyLoad
from adaptdrive.control import signals
from adaptdrive.control.controller import Controller
from adaptdrive.control.schedule import Schedule
from adaptdrive.identification.excerpt import means_of
from adaptdrive.safety.timing import timing_of
from adaptdrive.util.errors import IdentificationError

# The daemon's controller in closed loop with a plant, in virtual time.


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


@dataclass(frozen=True, slots=True)
class Simulation:
    """A simulated closed loop.

    Attributes:
        ticks: Time, set-point, output, boost voltage and load power at each reading.
        slow: Each slow step: output, V_c, controller, reason, estimates and their deviations.
        fault: Cause that ended it early, empty for none.
        configuration: The one that the controller ran with.
    """

    ticks: pl.DataFrame
    slow: pl.DataFrame
    fault: str
    configuration: Configuration


_TICKS = ("time_s", "reference", "output", "boost_voltage_V", "load_power_W")

Start = tuple[float | None, tuple[float, ...] | None]
"""v_bst in V at the start, the lowest V_c when None; and the parameters that an earlier run
trusted, in the order of `Load.names`."""


class BoostStage:
    """Output stage of a drive, which the controller commands.

    Where the daemon controls it, that is a boost capacitor on an ideal line, which the rectifier
    keeps at the line's peak at least. A drive with a loop of its own follows V_c as it is.

    Attributes:
        voltage_V: v_bst at the end of the last step.
    """

    def __init__(self, configuration: Configuration, voltage_V: float | None) -> None:
        """Build the boost stage of a configuration.

        Args:
            configuration: The drive.
            voltage_V: v_bst at the start; the lowest V_c, or 0 where that is negative, when None.
        """
        drive, loop = configuration.drive, configuration.voltage_loop
        rates = controller_settings(configuration).rates
        by_daemon = loop.where == "daemon"
        self._floor_V = math.sqrt(2.0) * drive.line_voltage_V if by_daemon else -math.inf
        self._line_V = drive.line_voltage_V
        self._capacitance_F = drive.boost_capacitance_F
        self._lag_s = rates.lag_ticks * rates.nominal_tick_s
        self._by_daemon = by_daemon
        start_V = max(0.0, drive.limits.boost_reference_min_V) if voltage_V is None else voltage_V
        self.voltage_V = max(self._floor_V, start_V)

    def step(self, command: signals.Command, power_W: float, duration_s: float) -> float:
        """Advance under a command and a load.

        Args:
            command: The command that the drive has latched.
            power_W: Power drawn, as of the step before.
            duration_s: Length of the step.

        Returns:
            The mean voltage over the step, in V.
        """
        before_V = self.voltage_V
        if not self._by_daemon:
            share = -math.expm1(-duration_s / self._lag_s) if self._lag_s else 1.0
            self.voltage_V += share * (command.boost_reference_V - before_V)
        else:
            fed_W = command.current_scale_S * self._line_V**2
            square = before_V**2 + 2.0 * duration_s / self._capacitance_F * (fed_W - power_W)
            self.voltage_V = math.sqrt(max(0.0, square))
        self.voltage_V = max(self._floor_V, self.voltage_V)
        return 0.5 * (before_V + self.voltage_V)


def run_loop(
    configuration: Configuration,
    plant: Plant,
    order: Callable[[int], signals.Order],
    readings: int,
    start: Start = (None, None),
) -> Simulation:
    """Run the controller of a configuration on a plant.

    Args:
        configuration: The configuration.
        plant: The plant.
        order: The order at each reading, by its number.
        readings: Number of readings of the drive.
        start: Where it starts; at the lowest V_c with nothing learnt when left out.

    Raises:
        IdentificationError: The plant returns a value that is not finite.
    """
    start_V, prior = start
    settings, load = controller_settings(configuration), build_load(configuration)
    schedule = Schedule(Controller(settings, load, prior), configuration.load.latency_ticks)
    boost, plant = BoostStage(configuration, start_V), at_own_step(plant)
    half_cycle_s, stride = configuration.drive.half_cycle_s, configuration.bus.ticks_per_reading
    line_V, period_s = configuration.drive.line_voltage_V, half_cycle_s * stride
    output, power_W = advanced(plant, boost.voltage_V, period_s, 0)
    latched: signals.Command | None = None
    ticks, slow, fault = [], [], ""
    for number in range(readings):
        wanted, volts = order(number), boost.voltage_V
        tick = number * stride
        measured = signals.Measurement(tick, half_cycle_s, volts, line_V, power_W, output)
        command = schedule.tick(measured, wanted)
        ticks.append((number * period_s, wanted.reference, output, volts, power_W))
        if (snapshot := schedule.take_snapshot()) is not None:
            decision = schedule.decide(snapshot)
            slow.append(_slow_row(snapshot, decision, half_cycle_s))
            if fault := decision.fault:
                break
        mean_V = boost.step(latched or command, power_W, period_s)
        latched = command
        output, power_W = advanced(plant, mean_V, period_s, number + 1)
    table = pl.DataFrame(ticks, dict.fromkeys(_TICKS, pl.Float64), orient="row")
    return Simulation(table, pl.DataFrame(slow), fault, configuration)


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


def advanced(plant: Plant, voltage_V: float, duration_s: float, number: int) -> tuple[float, float]:
    """Advance a plant and return its output and power as numbers.

    Args:
        plant: The plant.
        voltage_V: Mean boost voltage over the step.
        duration_s: Length of the step.
        number: Number of the step, for the message.

    Raises:
        IdentificationError: One of them is not finite.
    """
    # a plant may count in numpy, whose numbers keep their own precision in all that follows
    output, power_W = map(float, plant.step(voltage_V, duration_s))
    if not (math.isfinite(output) and math.isfinite(power_W)):
        raise IdentificationError(
            f"step {number} of the plant returned output {output} and power {power_W} W"
        )
    return output, power_W


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


def at_own_step(plant: Plant) -> Plant:
    """Return a plant that takes any step: itself where it has no `step_s`."""
    step_s = getattr(plant, "step_s", None)
    return plant if step_s is None else OwnStep(plant, float(step_s))


# A plant of the user in closed loop.


def simulated(
    configuration: Configuration,
    plant: Plant,
    setpoint: Callable[[float], float],
    duration_s: float,
    mode: signals.Mode,
) -> Simulation:
    """Run the controller of a configuration on a plant.

    Args:
        configuration: The configuration.
        plant: The plant.
        setpoint: Set-point at each time, in s.
        duration_s: Simulated time.
        mode: Controller asked for.

    Raises:
        IdentificationError: A set-point, or a value that the plant returns, is not finite.
    """
    reading_s = timing_of(configuration).reading_s
    pole = configuration.load.pole

    def order(number: int) -> signals.Order:
        wanted = float(setpoint(number * reading_s))
        if not math.isfinite(wanted):
            raise IdentificationError(f"the set-point at {number * reading_s:g} s is {wanted}")
        return signals.Order(signals.Stage.RUN, wanted, mode, pole)

    return run_loop(configuration, plant, order, round(duration_s / reading_s))


# The course of a loop, simulated or recorded, as means over slow periods.


@dataclass(frozen=True, slots=True)
class LoopCourse:
    """Course of a loop, as means over slow periods.

    Attributes:
        time_s: Time of each slow period.
        reference: Set-point at its end.
        output: The regulated quantity.
        boost_voltage_V: v_bst.
        quality: Judgement of it.
        fault: Cause that ended it early, empty for none.
    """

    time_s: Array
    reference: Array
    output: Array
    boost_voltage_V: Array
    quality: Quality
    fault: str = ""


def course_of(
    ticks: pl.DataFrame, samples: int, time_s: Array, section: AnyLoad, fault: str = ""
) -> LoopCourse:
    """Return the course of a loop.

    Args:
        ticks: Set-point, output and boost voltage at each reading.
        samples: Readings in a slow period.
        time_s: Time of each slow period.
        section: The load, with its slow period and the range of its set-points.
        fault: Cause that ended the loop early, empty for none.
    """
    output, volts = (means_of(ticks[n].to_numpy(), samples) for n in ("output", "boost_voltage_V"))
    reference = ticks["reference"].to_numpy()[samples - 1 :: samples]
    span = section.reference_max - section.reference_min
    quality = quality_of(reference, output, volts, section.period_s, span)
    return LoopCourse(time_s, reference, output, volts, quality, fault)
