"""`[load]`, how it is learnt, and that of the simulated device.

`[estimator]` and `[supervisor]` state how the load is learnt, and when estimates are used.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from adaptdrive.config import section
from adaptdrive.util.errors import Flaw

LoadName = Literal["motor", "bath", "battery"]

Period = Annotated[section.PositiveFloat, Field(le=3600.0)]

NOISE_SHARE = 0.04
"""`load.noise_V` where it is left out, as a share of the range of V_c."""

FORGETTING = 0.985
"""`estimator.forgetting` of the `exact` design where it is left out."""

ERROR_SHARE = 0.1
"""`supervisor.error_limit` where it is left out, as a share of the range of set-points."""


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


class LoadSection(section.Section):
    """Keys of `[load]` for every type of load."""

    traits: ClassVar[LoadTraits] = LoadTraits()
    rising: ClassVar = ("reference_min", "reference_max")

    period_s: Period = 1.0
    pole: section.Fraction = 0.70
    pole_min: section.Fraction = 0.50
    pole_max: section.Fraction = 0.98
    design: Literal["exact", "paper"] = "exact"
    samples: int = section.key(90, ge=1)
    clip: float = section.key(5.0, ge=0.0)
    resolution: section.NonNegativeFloat = 0.0
    noise_V: section.NonNegativeFloat | None = None
    latency_ticks: int = section.key(2, ge=1)
    reference_min: section.FiniteFloat = 0.0
    reference_max: section.FiniteFloat
    govern: bool = False
    probe_share: float = section.key(0.0, span=(0.0, 0.1))
    probe_s: Annotated[section.PositiveFloat, Field(le=1e6)] = 300.0
    output_name: str = "output"
    output_unit: str = ""

    def flaws(self) -> Iterator[Flaw]:
        """Yield limits in the wrong order, and a pole outside of its limits."""
        yield from super().flaws()
        if not self.pole_min <= self.pole <= self.pole_max:
            span = f"pole_min…pole_max = {self.pole_min}…{self.pole_max}"
            yield Flaw("", f"pole = {self.pole} must lie in {span}")


class MotorModel(section.Section):
    """`[load.model]` of a motor: what the fixed controller is designed for."""

    gain: section.PositiveFloat
    tau_motor_s: section.PositiveFloat
    tau_filter_s: section.PositiveFloat


class MotorSection(LoadSection):
    """`[load]` with `type = "motor"`."""

    traits: ClassVar[LoadTraits] = LoadTraits(
        patience_s=30.0, paper_forgetting=0.97, paper_method="lm-rls"
    )

    type: Literal["motor"]
    output_name: str = "speed"
    output_unit: str = "V"
    boost_course: Literal["held", "impulse"] = "held"
    model: MotorModel

    def flaws(self) -> Iterator[Flaw]:
        """Yield a course that only the paper's design has."""
        yield from super().flaws()
        if self.boost_course == "impulse" and self.design != "paper":
            yield Flaw("boost_course", "'impulse' needs load.design 'paper'")


class BathModel(section.Section):
    """`[load.model]` of a bath: what the fixed controller is designed for."""

    resistance_K_per_W: section.PositiveFloat
    tau_s: section.PositiveFloat
    lag_s: section.NonNegativeFloat = 0.0
    delay_s: Annotated[section.NonNegativeFloat, Field(le=600.0)] = 0.0
    turns_ratio: section.PositiveFloat
    droop_Ohm: section.FiniteFloat = Field(ge=0.0)
    heater_Ohm: section.PositiveFloat


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
    period_s: Period = 20.0
    pole: section.Fraction = 0.80
    samples: int = section.key(600, ge=1)
    output_name: str = "temperature"
    output_unit: str = "K"
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
    droop_Ohm: section.FiniteFloat = Field(ge=0.0)
    internal_Ohm: section.PositiveFloat
    relaxation_Ohm: section.PositiveFloat
    relaxation_s: section.PositiveFloat


class Charge(section.Section):
    """`[load.charge]`: constant current, then constant voltage, then the end."""

    voltage_max_V: section.PositiveFloat
    end_current_A: section.PositiveFloat
    longest_h: section.PositiveFloat | None = None


class BatterySection(LoadSection):
    """`[load]` with `type = "battery"`; the set-point is the charging current."""

    traits: ClassVar[LoadTraits] = LoadTraits(charges=True)

    type: Literal["battery"]
    output_name: str = "current"
    output_unit: str = "A"
    model: BatteryModel
    charge: Charge


AnyLoad = MotorSection | BathSection | BatterySection


class Estimator(section.Section):
    """`[estimator]`: the recursive least squares that learn the load."""

    method: Literal["lm-rls", "rls"] = "lm-rls"
    forgetting: float | None = section.key(None, gt=0.5, le=1.0)
    tau_lambda_s: section.PositiveFloat = 10.0
    dead_band: float = section.key(0.0, ge=0.0)
    initial_covariance: section.PositiveFloat | None = None
    gate: float = section.key(1.2, ge=0.0)
    covariance_max: float = section.key(1.0e6, ge=0.0)
    alert: bool = True
    bias: bool = True
    initial_state: bool = True
    settle_s: section.Duration = 30.0


class Supervisor(section.Section):
    """`[supervisor]`: what estimates, and the loop, must satisfy (`exact` only but `warm_up_s`)."""

    warm_up_s: section.Duration = 90.0
    ratio_min: section.Fraction = 0.2
    ratio_max: float = section.key(6.0, gt=1.0, allow_inf_nan=False)
    damping_min: section.NonNegativeFloat = 0.9
    spread_max: section.NonNegativeFloat = 0.05
    residual_margin: section.NonNegativeFloat = 1.5
    confidence: section.NonNegativeFloat = 2.0
    dwell_periods: int = section.key(7, span=(1, 10_000))
    patience_periods: int = section.key(0, span=(0, 10_000))
    blend_periods: int = section.key(5, span=(1, 10_000))
    saturated_s: section.Duration = 240.0
    gain_slew: float = section.key(1.0, gt=0.0, le=1.0)
    error_limit: section.NonNegativeFloat | None = None
    response_s: section.Duration = 120.0
    response_distance: section.NonNegativeFloat = 0.02


class SimulatorSection(section.Section):
    """`[simulation]`: the load of `adaptdrive-sim device`; the daemon does not use it."""

    parameters: dict[str, section.FiniteFloat] = section.key({})
