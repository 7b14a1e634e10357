"""Runs of batteries: the ranges of a file, what a seed draws from them, and the charge.

The whole machine of the daemon runs, as a charge begins below the EMF and may end by itself.
"""

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from adaptdrive.config.file import validate_configuration
from adaptdrive.config.root import Configuration
from adaptdrive.control.signals import Mode
from adaptdrive_sim import course, site
from adaptdrive_sim.campaign.drawn import Row, columns_of, each, uniform
from adaptdrive_sim.campaign.settings import CampaignFile, CampaignTable, LineRanges, Range, within
from adaptdrive_sim.parameters import EXAMPLES, example_tables
from adaptdrive_sim.plants.battery import Battery, BatteryParameters
from adaptdrive_sim.plants.boost import CouplingParameters, LineParameters
from adaptdrive_sim.world import NoiseParameters, World

_BEGINS_s = 60.0
_NEAR_LIMIT = 0.99

EXAMPLE_V = 82.0
EXAMPLE_A = 14.0
"""The example's charger, of which every other one has the power."""

CELL_FULL_V = 4.10
_AGES = (0.4, 0.6)
_LOWERED = (0.7, 0.85)


class BatteryRanges(CampaignTable):
    """The battery; resistances and times are relative to the settings of the controller.

    Attributes:
        full_V: Terminal voltage at which it is full; drawn evenly on a logarithmic scale.
        rate_per_h: Largest current over the capacity: the EMF rises faster with it.
        charge: State of charge at the start.
        series: Series resistance.
        relaxation: Resistance of the relaxation element.
        relaxation_s: Its time constant.
        second: Resistance of a second, slower relaxation element, relative to the first.
        second_s: Its time constant in s.
        aged: Share of runs in which the series resistance grows.
        growth: By which factor.
    """

    full_V: Annotated[Range, within(12.0, 400.0)]
    rate_per_h: Annotated[Range, within(0.05, 5.0)]
    charge: Annotated[Range, within(0.0, 0.9)]
    series: Annotated[Range, within(0.2, 5.0)]
    relaxation: Annotated[Range, within(0.2, 5.0)]
    relaxation_s: Annotated[Range, within(0.2, 5.0)]
    second: Annotated[Range, within(0.0, 2.0)]
    second_s: Annotated[Range, within(50.0, 1e4)]
    aged: float = Field(ge=0.0, le=1.0)
    growth: Annotated[Range, within(1.0, 5.0)]


class CurrentRanges(CampaignTable):
    """The charging current, which is lowered for a while in the second half of the run.

    Attributes:
        share: Of the largest one.
        lowered: To this share of itself.
        ripple: `load.probe_share`.
        noise: Standard deviation of each sample, as a share of the largest current.
    """

    share: Annotated[Range, within(0.1, 1.0)]
    lowered: Annotated[Range, within(0.1, 0.95)]
    ripple: Annotated[Range, within(0.0, 0.1)]
    noise: Annotated[Range, within(0.0, 0.1)]


class BatteryCampaign(CampaignFile):
    """A whole file."""

    type: Literal["battery"]
    duration_s: float = Field(ge=300.0, le=1e6)
    battery: BatteryRanges
    current: CurrentRanges
    line: LineRanges


@dataclass(frozen=True, slots=True)
class BatteryScenario:
    """Drawn values of a run: one for each range of `BatteryRanges` and `CurrentRanges`, and these.

    It has what `drawn.DrawnRun` has for the results, and is judged at constant current, over the
    step of the set-point.

    Attributes:
        cycle_periods: Slow periods at the end of a run that show whether it is stable.
        seed: It was drawn from this.
        duration_s: Length.
        cells: In series.
        growth: Factor by which the series resistance grows, 1 for none.
        line_voltage: Relative line voltage.
        frequency_Hz: Of the line.
    """

    cycle_periods: ClassVar[int] = 100

    seed: int
    duration_s: float
    cells: int
    rate_per_h: float
    charge: float
    series: float
    relaxation: float
    relaxation_s: float
    second: float
    second_s: float
    growth: float
    share: float
    lowered: float
    ripple: float
    noise: float
    line_voltage: float
    frequency_Hz: float

    @property
    def scale(self) -> float:
        """Voltage over that of the example; its resistances grow with the square."""
        return CELL_FULL_V * self.cells / EXAMPLE_V

    @property
    def largest_A(self) -> float:
        """The charger's largest current."""
        return EXAMPLE_A / self.scale

    @property
    def current_A(self) -> float:
        """The set-point at the start."""
        return self.share * self.largest_A

    @property
    def step(self) -> float:
        """By how many amperes it is lowered; nothing moves the current further."""
        return (1.0 - self.lowered) * self.current_A

    largest_movement = step

    def setpoint_at(self, time_s: float) -> float:
        """Return the current that is asked for."""
        first, last = (share * self.duration_s for share in _LOWERED)
        return self.current_A - (self.step if first <= time_s < last else 0.0)

    def series_at(self, time_s: float) -> float:
        """Return the series resistance over that at the start."""
        first, last = (share * self.duration_s for share in _AGES)
        grown = min(max((time_s - first) / (last - first), 0.0), 1.0)
        return 1.0 + (self.growth - 1.0) * grown

    def battery(self) -> BatteryParameters:
        """The true battery at the start."""
        nominal, ohms = BatteryParameters(), self.scale**2
        relaxation_Ohm = nominal.relaxation_Ohm * ohms * self.relaxation
        return BatteryParameters(
            cells=self.cells,
            capacity_Ah=self.largest_A / self.rate_per_h,
            charge=self.charge,
            series_Ohm=nominal.series_Ohm * ohms * self.series,
            relaxation_Ohm=relaxation_Ohm,
            relaxation_s=nominal.relaxation_s * self.relaxation_s,
            relaxation_2_Ohm=relaxation_Ohm * self.second,
            relaxation_2_s=self.second_s,
        )

    def world(self, load: Battery) -> World:
        """The true drive, line and sensor in front of the battery."""
        nominal = CouplingParameters()
        line = LineParameters.steady(self.line_voltage, self.frequency_Hz)
        droop_Ohm = nominal.droop_Ohm * self.scale**2
        stage = CouplingParameters(nominal.ratio * self.scale, droop_Ohm)
        noise = NoiseParameters(sigma=self.noise * self.largest_A)
        return World(load, line=line, coupling=stage, noise=noise, seed=self.seed)

    def configuration(self) -> Configuration:
        """The daemon's: the example's for this voltage, with its model of the battery."""
        tables, ohms = example_tables("battery.toml"), self.scale**2
        load, model = tables["load"], tables["load"]["model"]
        load |= {"reference_max": self.largest_A, "probe_share": self.ripple}
        model["turns_ratio"] *= self.scale
        for name in ("droop_Ohm", "internal_Ohm", "relaxation_Ohm"):
            model[name] *= ohms
        load["charge"]["voltage_max_V"] = CELL_FULL_V * self.cells
        load["charge"]["end_current_A"] /= self.scale
        tables["interlocks"]["output_max"] /= self.scale
        return validate_configuration(tables, EXAMPLES / "battery.toml")

    def columns(self) -> Row:
        """Return the drawn values as columns of the results."""
        row = columns_of(self) | {"full_V": CELL_FULL_V * self.cells, "current_A": self.current_A}
        return row | {"changes": int(self.growth > 1.0), "shape": "square"}

    def run(self, mode: Mode) -> course.Run:
        """Charge the battery."""
        plant = Battery(self.battery())
        drive = site.OperatedDrive(self.configuration(), self.world(plant))
        drive.begin(mode)
        series_Ohm = plant.resistance_Ohm

        def age(time_s: float) -> None:
            plant.resistance_Ohm = series_Ohm * self.series_at(time_s)

        run = drive.follow(self.duration_s, self.setpoint_at, age)
        run.interlock = int(bool(run.trip))
        return run

    def errors(self, run: course.Run) -> course.Array:
        """Return the differences to the designed loop at constant current."""
        if run.trip:
            return np.array([np.inf])
        pole = self.configuration().load.pole
        errors: course.Array = (run["output"] - ideal_current(run["reference"], pole)) / self.step
        errors = errors[self._constant(run)]
        return errors if errors.size else np.zeros(1)  # at the voltage limit from the start

    def seen(self, run: course.Run) -> Row:
        """Return the share of constant current with adaptive in force, and the ripple."""
        constant = self._constant(run)
        if run.trip or not np.any(constant):
            return {"adaptive_share": 0.0, "ripple_found": math.nan, "constant_s": 0.0}
        outputs = run["output"][constant & (run["time_s"] < 0.7 * self.duration_s)]
        return {
            "adaptive_share": float(np.mean(run["adaptive"][constant])),
            "ripple_found": float(np.ptp(outputs) / self.current_A) if outputs.size else math.nan,
            "constant_s": float(np.count_nonzero(constant)),
        }

    def _constant(self, run: course.Run) -> NDArray[np.bool_]:
        """Return the slow periods at constant current: from its start to the voltage limit."""
        near_V = _NEAR_LIMIT * CELL_FULL_V * self.cells
        reached = np.flatnonzero(run["terminal_voltage_V"] >= near_V)
        end = reached[0] if reached.size else len(run.trace)
        within: NDArray[np.bool_] = run["time_s"] >= _BEGINS_s
        return within & (np.arange(len(run.trace)) < end)


def draw_battery(campaign: BatteryCampaign, seed: int) -> BatteryScenario:
    """Return the run of a campaign that a seed stands for."""
    rng = np.random.default_rng([seed, 4])
    own = campaign.battery
    log_low, log_high = np.log(own.full_V)
    resistances = ("series", "relaxation", "relaxation_s", "second", "second_s")
    return BatteryScenario(
        seed=seed,
        duration_s=campaign.duration_s,
        cells=max(3, round(float(np.exp(uniform(rng, (log_low, log_high)))) / CELL_FULL_V)),
        **each(rng, own, "rate_per_h", "charge", *resistances),
        growth=uniform(rng, own.growth) if rng.random() < own.aged else 1.0,
        **each(rng, campaign.current, "share", "lowered", "ripple", "noise"),
        line_voltage=uniform(rng, campaign.line.voltage),
        frequency_Hz=uniform(rng, campaign.line.frequency_Hz),
    )


def ideal_current(references: course.Array, pole: float) -> course.Array:
    """Return the current of the loop as designed: its zero cancels one of two poles.

    Args:
        references: What was asked for in each slow period.
        pole: Closed-loop pole.
    """
    found = np.array(references, dtype=float)
    for k in range(1, found.size):
        found[k] = pole * found[k - 1] + (1.0 - pole) * references[k - 1]
    return found


def summarise(rows: list[Row]) -> str:
    """Return the time that adaptive was in force, and the largest ripple."""
    shares = np.array([row["adaptive_share"] for row in rows])
    ripples = np.array([row["ripple_found"] for row in rows])
    largest = 100.0 * np.max(ripples, initial=0.0, where=np.isfinite(ripples))
    half = np.count_nonzero(shares >= 0.5)
    return (
        f"adaptive in force for half of the constant current or more in {half} of "
        f"{len(rows)} runs, median {100.0 * np.median(shares):.0f} %; "
        f"largest ripple {largest:.2f} % peak to peak"
    )
