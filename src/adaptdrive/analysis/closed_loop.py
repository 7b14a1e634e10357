"""A simulated closed loop as tables, and the response of a loop, simulated or recorded."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import polars as pl

from adaptdrive.analysis.curves import Array, Quality, quality_of
from adaptdrive.analysis.loop import Loop, Plant, PlantRig
from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings
from adaptdrive.config import Configuration
from adaptdrive.config.load import AnyLoad
from adaptdrive.control import signals
from adaptdrive.control.controller import Controller
from adaptdrive.identification.excerpt import means_of
from adaptdrive.safety.timing import timing_of
from adaptdrive.util.errors import IdentificationError

# A plant in closed loop with the controller of a configuration.


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

    @property
    def columns(self) -> dict[str, Array]:
        """The columns of the ticks."""
        return {name: self.ticks[name].to_numpy() for name in _TICKS}


_TICKS = ("time_s", "reference", "output", "boost_voltage_V", "load_power_W")


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
        voltage_V: v_bst at the start; the lowest V_c when None.
        prior: Parameters that an earlier run trusted, in the order of `Load.names`.

    Raises:
        IdentificationError: The plant has no step, or returns a value that is not finite.
    """
    controller = Controller(controller_settings(configuration), build_load(configuration), prior)
    loop = Loop(controller, PlantRig(configuration, plant, voltage_V))
    half_cycle_s, ticks, slow = configuration.drive.half_cycle_s, [], list[dict[str, Any]]()
    fault = ""
    for one, order, decided in loop.readings(course, configuration.bus.ticks_per_reading):
        known = one.output, one.boost_voltage_V, one.load_power_W
        ticks.append((one.tick * half_cycle_s, order.reference, *known))
        if decided and loop.snapshot is not None and loop.decision is not None:
            slow.append(_slow_row(loop.snapshot, loop.decision, half_cycle_s))
            if fault := loop.decision.fault:
                break
    table = pl.DataFrame(ticks, dict.fromkeys(_TICKS, pl.Float64), orient="row")
    return Simulation(table, pl.DataFrame(slow), fault, configuration)


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


# The response of a loop, simulated or recorded, as means over slow periods.

_RESPONSE = ("reference", "output", "boost_voltage_V")


@dataclass(frozen=True, slots=True)
class Response:
    """Response of a loop, as means over slow periods.

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


def response_of(
    columns: Mapping[str, Array], samples: int, time_s: Array, section: AnyLoad, fault: str = ""
) -> Response:
    """Return the response of a loop.

    Args:
        columns: Set-point, output and boost voltage at each reading; those before the first slow
            period are left out.
        samples: Readings in a slow period.
        time_s: Time of each slow period.
        section: The load, with its slow period and the range of its set-points.
        fault: Cause that ended the loop early, empty for none.
    """
    first = (len(columns["output"]) // samples - len(time_s)) * samples
    reference, output, volts = (columns[name][first:] for name in _RESPONSE)
    reference = reference[samples - 1 :: samples]
    output, volts = means_of(output, samples), means_of(volts, samples)
    span = section.reference_max - section.reference_min
    quality = quality_of(reference, output, volts, section.period_s, span)
    return Response(time_s, reference, output, volts, quality, fault)
