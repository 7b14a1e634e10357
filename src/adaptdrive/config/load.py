"""`[load]`, how it is learnt, and that of the simulated device.

`[estimator]` and `[supervisor]` state how the load is learnt, and when estimates are used.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from pydantic import BeforeValidator, Field

from adaptdrive.config import section
from adaptdrive.util.errors import Flaw
from adaptdrive.util.quantity import Display

LoadName = Literal["motor", "bath", "battery"]

Period = Annotated[section.PositiveFloat, Field(le=3600.0)]

FORGETTING = 0.985
"""`estimator.forgetting` of the `exact` design where it is left out."""


@dataclass(frozen=True, slots=True)
class LoadTraits:
    """Traits of a kind of load that no key of its section holds.

    Attributes:
        charges: Whether the output is a current that fills it, and never flows back.
        drifts: Whether what acts next to the input moves by itself, as the inflow of a bath does.
        patience_s: Time for which commissioning waits until the output rests.
        lag_periods: Slow periods in the sum of the time constants that commissioning proposes.
        lag_periods_min: Least sum, in slow periods, with which the estimates serve.
        lag_periods_max: Largest sum, as above.
        paper_forgetting: ρ of the paper, or of the `exact` design where the paper has no such load.
        paper_method: Estimator of the paper's experiment; None where it has none.
    """

    charges: bool = False
    drifts: bool = False
    patience_s: float = 60.0
    lag_periods: float = 20.0
    lag_periods_min: float = 4.0
    lag_periods_max: float = 120.0
    paper_forgetting: float = 0.985
    paper_method: str | None = None


class OutputDisplay(section.Section):
    """`[load.output_display]`: the unit in which people see and type the output.

    `output_display = "rpm"` stands for `{ unit = "rpm" }`.
    """

    unit: str = Field(min_length=1)
    """its name; where it stands alone a unit that `load.output_unit` converts to: rpm for rad/s"""
    scale: section.PositiveFloat | None = None
    """its units for each unit of the output; 1 where `offset` stands alone"""
    offset: section.FiniteFloat | None = None
    """its value where the output is 0: 15.0 with `unit = "degC"` for a rise in K above an inflow of
    15 °C"""

    def display_of(self, output_unit: str) -> Display | None:
        """Return the conversion from the unit of the output, None where nobody knows it."""
        name = _SIGNS.get(self.unit, self.unit)
        if self.scale is None and self.offset is None:
            usual = section.from_si(self.unit, output_unit)
            return None if usual is None else Display(name, *usual)
        return Display(name, 1.0 if self.scale is None else self.scale, self.offset or 0.0)


_SIGNS = {"degC": "°C", "degF": "°F"}


def _as_display(given: object) -> object:
    return {"unit": given} if isinstance(given, str) else given


class LoadSection(section.Section):
    """Keys of `[load]` for every type of load."""

    traits: ClassVar[LoadTraits] = LoadTraits()
    rising: ClassVar = ("reference_min", "reference_max")

    period_s: Period
    """slow period T_k, a whole number of half line cycles"""
    pole: section.Fraction
    """closed-loop pole of the load loop; `check` shows the poles that an operator may ask for"""
    design: Literal["exact", "paper"] = "exact"
    """`exact`: held input, delays and filter in the model; `paper`: the paper's controller and
    nothing else"""
    samples: int = section.key(90, ge=1)
    """fast samples averaged for one slow one: more against noise, fewer for less delay; in half
    line cycles, at most a slow period (`exact` only)"""
    resolution: section.NonNegativeFloat = 0.0
    """smallest step of the measured output, such as 0.0049 of 10 bits over 5 V; 0: found in the
    samples (`exact` and `lm-rls` only). State one above 1 % of the set-point range"""
    latency_ticks: int = section.key(2, ge=1)
    """fast ticks from the slow sample to its effect"""
    reference_min: section.FiniteFloat = 0.0
    """lowest set-point"""
    reference_max: section.FiniteFloat
    """highest set-point"""
    reference_slope: section.NonNegativeFloat = 0.0
    """change of the reference in one second on its way to a set-point whose command gives none;
    0: in one step. A waveform is followed as it is"""
    probe_share: float = section.key(0.0, span=(0.0, 0.1))
    """distance by which a constant set-point is moved to learn the load in mode adaptive, as a
    share of the set-point range (of a charging current: lowered by a share of itself); 0: never
    (`exact` and `lm-rls` only)"""
    output_name: str
    """name of the output for people"""
    output_unit: str
    """unit of the output, of its set-points and of its limits"""
    output_display: Annotated[
        OutputDisplay | None,
        BeforeValidator(_as_display, json_schema_input_type=OutputDisplay | str),
    ] = None
    """unit in which people see and type the output, such as "rpm" beside rad/s; left out:
    `output_unit`. This file, telemetry and records keep that"""

    @property
    def display(self) -> Display:
        """Unit in which people see and type the output."""
        chosen = self.output_display
        found = None if chosen is None else chosen.display_of(self.output_unit)
        return found or Display(self.output_unit)

    def flaws(self) -> Iterator[Flaw]:
        """Yield a unit for people that nobody can convert to."""
        yield from super().flaws()
        chosen, found = self.output_display, self.display
        if chosen is None:
            return
        given = "give { unit = …, scale = …, offset = … }"
        if chosen.display_of(self.output_unit) is None:
            flaw = f"{chosen.unit!r} is no unit that {self.output_unit!r} converts to: {given}"
            yield Flaw("output_display", flaw)
        elif self.traits.drifts and chosen.offset is None and found.offset:
            flaw = f"{chosen.unit!r} is absolute, and a bath has a rise above its inflow: {given}"
            yield Flaw("output_display", flaw)


class MotorModel(section.Section):
    """`[load.model]` of a motor: what the fixed controller is designed for."""

    gain: section.PositiveFloat
    """g_m, output per volt of v_bst"""
    tau_motor_s: section.PositiveFloat
    """mechanical time constant τ_m"""
    tau_filter_s: section.PositiveFloat
    """time constant τ_f of the tachometer filter"""


class MotorSection(LoadSection):
    """`[load]` with `type = "motor"`."""

    traits: ClassVar[LoadTraits] = LoadTraits(
        patience_s=30.0, paper_forgetting=0.97, paper_method="lm-rls"
    )

    type: Literal["motor"]
    """kind of load"""
    boost_course: Literal["held", "impulse"] = "held"
    """`impulse`: each change of V_c is exaggerated for half a slow period, as the `paper` design
    assumes"""
    model: MotorModel

    def flaws(self) -> Iterator[Flaw]:
        """Yield a course that only the paper's design has."""
        yield from super().flaws()
        if self.boost_course == "impulse" and self.design != "paper":
            yield Flaw("boost_course", "'impulse' needs load.design 'paper'")


class BathModel(section.Section):
    """`[load.model]` of a bath: what the fixed controller is designed for."""

    resistance_K_per_W: section.PositiveFloat
    """thermal resistance R to the inflow"""
    tau_s: section.PositiveFloat
    """time constant R C"""
    lag_s: section.NonNegativeFloat = 0.0
    """second time constant, of a sensor that lags; 0 for none"""
    delay_s: Annotated[section.NonNegativeFloat, Field(le=600.0)] = 0.0
    """dead time from heater to sensor"""
    turns_ratio: section.PositiveFloat
    """N2, secondary volts per boost volt"""
    droop_Ohm: section.FiniteFloat = Field(ge=0.0)
    """R_d of the dc/dc stage"""
    heater_Ohm: section.PositiveFloat
    """R_h of the heater"""


class BathSection(LoadSection):
    """`[load]` with `type = "bath"`."""

    traits: ClassVar[LoadTraits] = LoadTraits(
        drifts=True,
        patience_s=600.0,
        lag_periods=10.0,
        lag_periods_min=2.0,
        lag_periods_max=60.0,
        paper_forgetting=0.99,
        paper_method="rls",
    )

    type: Literal["bath"]
    """kind of load"""
    samples: int = section.key(600, ge=1)
    model: BathModel

    def flaws(self) -> Iterator[Flaw]:
        """Yield what the paper's bath has not."""
        yield from super().flaws()
        for name in ("lag_s", "delay_s"):
            if self.design == "paper" and (value := getattr(self.model, name)) > 0.0:
                problem = f"{value} s needs load.design 'exact': the paper's bath has neither"
                yield Flaw(f"model.{name}", problem)


class BatteryModel(section.Section):
    """`[load.model]` of a battery: what the fixed controller is designed for."""

    turns_ratio: section.PositiveFloat
    """N2, secondary volts per boost volt"""
    droop_Ohm: section.FiniteFloat = Field(ge=0.0)
    """R_d of the dc/dc stage"""
    internal_Ohm: section.PositiveFloat
    """series resistance R_0 of the battery"""
    relaxation_Ohm: section.PositiveFloat
    """R_1 of the relaxation element"""
    relaxation_s: section.PositiveFloat
    """R_1 C_1"""


class Charge(section.Section):
    """`[load.charge]`: constant current, then constant voltage, then the end."""

    voltage_max_V: section.PositiveFloat
    """terminal voltage that the charge is regulated to; it may be passed for a while by 2 % at
    most: the battery must stand that"""
    end_current_A: section.PositiveFloat
    """tapering current at which charging ends"""
    longest_h: section.PositiveFloat | None = None
    """time on without a break after which the drive trips: more than an empty battery needs;
    without it a charge whose current is measured too high never ends"""


class BatterySection(LoadSection):
    """`[load]` with `type = "battery"`; the set-point is the charging current."""

    traits: ClassVar[LoadTraits] = LoadTraits(charges=True)

    type: Literal["battery"]
    """kind of load"""
    model: BatteryModel
    charge: Charge


AnyLoad = MotorSection | BathSection | BatterySection


class Estimator(section.Section):
    """`[estimator]`: the recursive least squares that learn the load."""

    method: Literal["lm-rls", "rls"] = "lm-rls"
    """λ-filtered or direct recursive least squares"""
    forgetting: float | None = section.key(None, gt=0.5, le=1.0)
    """forgetting factor ρ: the memory is 1/(1 - ρ) slow periods; lower for a load that changes
    fast, nearer 1 against noise; 0.985 when left out, in the `paper` design 0.97, for a bath
    0.99"""
    tau_lambda_s: section.PositiveFloat = 10.0
    """time constant of the λ filters: half the sum of the load's time constants; longer against
    noise"""
    bias: bool = True
    """estimate a constant too, such as a load torque (`exact` only); a battery always has one"""
    settle_s: section.Duration = 30.0
    """time after start before the first update (`exact` only)"""


class Supervisor(section.Section):
    """`[supervisor]`: what estimates, and the loop, must satisfy (`exact` only but `warm_up_s`)."""

    warm_up_s: section.Duration = 90.0
    """time after start before adaptive may take over"""
    ratio_min: section.Fraction = 0.2
    """smallest accepted estimate over nominal"""
    ratio_max: float = section.key(6.0, gt=1.0, allow_inf_nan=False)
    """largest accepted estimate over nominal"""
    saturated_s: section.Duration = 240.0
    """longest time at a limit without coming closer to where the model rests, before the fixed
    gains return; 0: any"""
    response_s: section.Duration = 120.0
    """trip when the input was at a limit for this time and the output did not move; 0: never"""
    response_distance: section.NonNegativeFloat = 0.02
    """movement that `response_s` requires, as a share of the set-point range"""


class SimulatorSection(section.Section):
    """`[simulation]`: the load of `adaptdrive-sim device`; the daemon does not use it."""

    parameters: dict[str, section.FiniteFloat] = section.key({})
    """physical parameters that `[load.model]` leaves open, such as `friction_Nms`; `dropped_at_rest
    = 1.0`: disks share the momentum of the shaft"""
