"""`[load]` and `[simulation]`: the load of a drive, and that of its simulated device."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, Self, get_args

from pydantic import Field, model_validator

from adaptdrive.config.section import (
    FiniteFloat,
    Fraction,
    NonNegativeFloat,
    PositiveFloat,
    Section,
    key,
)

LoadName = Literal["motor", "bath", "battery"]
LOAD_TYPES: tuple[str, ...] = get_args(LoadName)

Period = Annotated[PositiveFloat, Field(le=3600.0)]

NOISE_SHARE = 0.04
"""`load.noise_V` where it is left out, as a share of the range of V_c."""


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


class LoadSection(Section):
    """Keys of `[load]` for every type of load."""

    traits: ClassVar[LoadTraits] = LoadTraits()

    period_s: Period = key(1.0, "slow period T_k, a whole number of half line cycles")
    pole: Fraction = key(0.70, "closed-loop pole of the load loop")
    pole_min: Fraction = key(
        0.50, "fastest pole an operator may ask for; `check` shows the range that is stable"
    )
    pole_max: Fraction = key(0.98, "slowest pole an operator may ask for, as above")
    design: Literal["exact", "paper"] = key(
        "exact",
        "`exact`: held input, delays and filter in the model; "
        "`paper`: the paper's controller and nothing else",
    )
    samples: int = key(
        90,
        "fast samples averaged for one slow one: more against noise, fewer for less "
        "delay; in half line cycles, at most a slow period (`exact` only)",
        ge=1,
    )
    clip: float = key(
        5.0,
        "fast samples are clipped to this many mean deviations about their "
        "prediction; 0: not clipped (`exact` only)",
        ge=0.0,
    )
    resolution: NonNegativeFloat = key(
        0.0,
        "smallest step of the measured output, such as 0.0049 of 10 bits over 5 V; 0: found in the "
        "samples (`exact` and `lm-rls` only). State one above 1 % of the set-point range",
    )
    noise_V: NonNegativeFloat | None = key(
        None,
        "largest standard deviation of V_c in volts that noise may cause; adaptive "
        "poles become slower for it; "
        f"{100.0 * NOISE_SHARE:g} % of the range of V_c when left out; 0: any "
        "(`exact` and `lm-rls` only)",
    )
    latency_ticks: int = key(2, "fast ticks from the slow sample to its effect", ge=1)
    reference_min: FiniteFloat = key(0.0, "lowest set-point")
    reference_max: FiniteFloat = Field(description="highest set-point")
    govern: bool = key(
        False,
        "move a set-point that V_c cannot hold to the nearest that it can; otherwise refuse it",
    )
    probe_share: float = key(
        0.0,
        "distance by which a constant set-point is moved to learn the load in mode "
        "adaptive, as a share of the set-point range (of a charging current: lowered by a share "
        "of itself); 0: never (`exact` and `lm-rls` only)",
        span=(0.0, 0.1),
    )
    probe_s: Annotated[PositiveFloat, Field(le=1e6)] = key(
        300.0,
        "time without movement after which the load counts as unknown, and least "
        "time between probes",
    )
    output_name: str = key("output", "name of the output for people")
    output_unit: str = key("", "unit of the output for people")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.reference_min >= self.reference_max:
            raise ValueError(
                f"reference_min = {self.reference_min} must be below "
                f"reference_max = {self.reference_max}"
            )
        if not self.pole_min <= self.pole <= self.pole_max:
            raise ValueError(
                f"pole = {self.pole} must lie in pole_min…pole_max = "
                f"{self.pole_min}…{self.pole_max}"
            )
        return self


class MotorModel(Section):
    """`[load.model]` of a motor: what the fixed controller is designed for."""

    gain: PositiveFloat = Field(description="g_m, output per volt of v_bst")
    tau_motor_s: PositiveFloat = Field(description="mechanical time constant τ_m")
    tau_filter_s: PositiveFloat = Field(description="time constant τ_f of the tachometer filter")


class MotorSection(LoadSection):
    """`[load]` with `type = "motor"`."""

    traits: ClassVar[LoadTraits] = LoadTraits(
        patience_s=30.0, paper_forgetting=0.97, paper_method="lm-rls"
    )

    type: Literal["motor"] = Field(description="kind of load")
    output_name: str = key("speed", "name of the output for people")
    output_unit: str = key("V", "unit of the output for people")
    boost_course: Literal["held", "impulse"] = key(
        "held",
        "`impulse`: each change of V_c is exaggerated for half a slow period, as "
        "the `paper` design assumes",
    )
    model: MotorModel


class BathModel(Section):
    """`[load.model]` of a bath: what the fixed controller is designed for."""

    resistance_K_per_W: PositiveFloat = Field(description="thermal resistance R to the inflow")
    tau_s: PositiveFloat = Field(description="time constant R C")
    lag_s: NonNegativeFloat = key(0.0, "second time constant, of a sensor that lags; 0 for none")
    delay_s: Annotated[NonNegativeFloat, Field(le=600.0)] = key(
        0.0, "dead time from heater to sensor"
    )
    turns_ratio: PositiveFloat = Field(description="N2, secondary volts per boost volt")
    droop_Ohm: FiniteFloat = Field(ge=0.0, description="R_d of the dc/dc stage")
    heater_Ohm: PositiveFloat = Field(description="R_h of the heater")


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

    type: Literal["bath"] = Field(description="kind of load")
    period_s: Period = key(20.0, "slow period T_k, a whole number of half line cycles")
    pole: Fraction = key(0.80, "closed-loop pole of the load loop")
    samples: int = key(
        600,
        "fast samples averaged for one slow one: more against noise, fewer for less "
        "delay; in half line cycles, at most a slow period (`exact` only)",
        ge=1,
    )
    output_name: str = key("temperature", "name of the output for people")
    output_unit: str = key("K", "unit of the output for people")
    model: BathModel


class BatteryModel(Section):
    """`[load.model]` of a battery: what the fixed controller is designed for."""

    turns_ratio: PositiveFloat = Field(description="N2, secondary volts per boost volt")
    droop_Ohm: FiniteFloat = Field(ge=0.0, description="R_d of the dc/dc stage")
    internal_Ohm: PositiveFloat = Field(description="series resistance R_0 of the battery")
    relaxation_Ohm: PositiveFloat = Field(description="R_1 of the relaxation element")
    relaxation_s: PositiveFloat = Field(description="R_1 C_1")


class Charge(Section):
    """`[load.charge]`: constant current, then constant voltage, then the end."""

    voltage_max_V: PositiveFloat = Field(
        description="terminal voltage that the charge is regulated to; it may be passed for a "
        "while by 2 % at most: the battery must stand that"
    )
    end_current_A: PositiveFloat = Field(description="tapering current at which charging ends")
    longest_h: PositiveFloat | None = key(
        None,
        "time on without a break after which the drive trips: more than an empty "
        "battery needs; without it a charge whose current is measured too high never ends",
    )


class BatterySection(LoadSection):
    """`[load]` with `type = "battery"`; the set-point is the charging current."""

    traits: ClassVar[LoadTraits] = LoadTraits(charges=True)

    type: Literal["battery"] = Field(description="kind of load")
    output_name: str = key("current", "name of the output for people")
    output_unit: str = key("A", "unit of the output for people")
    model: BatteryModel
    charge: Charge


AnyLoad = MotorSection | BathSection | BatterySection


class SimulatorSection(Section):
    """`[simulation]`: the load of `adaptdrive-sim device`; the daemon does not use it."""

    parameters: dict[str, FiniteFloat] = key(
        {},
        "physical parameters that `[load.model]` leaves open, such as "
        "`friction_Nms`; `dropped_at_rest = 1.0`: disks share the momentum of the shaft",
    )
