"""`[estimator]` and `[supervisor]`: how the load is learnt, and when estimates are used."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from adaptdrive.config.section import Duration, Fraction, NonNegativeFloat, PositiveFloat, Section

FORGETTING = 0.985
"""`estimator.forgetting` of the `exact` design where it is left out."""

ERROR_SHARE = 0.1
"""`supervisor.error_limit` where it is left out, as a share of the range of set-points."""


class Estimator(Section):
    """`[estimator]`: the recursive least squares that learn the load."""

    method: Literal["lm-rls", "rls"] = Field(
        default="lm-rls", description="λ-filtered or direct recursive least squares"
    )
    forgetting: float | None = Field(
        default=None,
        gt=0.5,
        le=1.0,
        description="forgetting factor ρ: the memory is 1/(1 - ρ) slow periods; lower for a load "
        f"that changes fast, nearer 1 against noise; {FORGETTING} when left out, in the `paper` "
        "design 0.97, for a bath 0.99",
    )
    tau_lambda_s: PositiveFloat = Field(
        default=10.0,
        description="time constant of the λ filters: half the sum of the load's time constants; "
        "longer against noise",
    )
    dead_band: float = Field(
        default=0.0,
        ge=0.0,
        description="movement of the output between two slow samples, in its unit, below which "
        "the estimate is not updated",
    )
    initial_covariance: PositiveFloat | None = Field(
        default=None,
        description="P[0] = this times I, over the variance of the noise; when left out 1e8 for "
        "the `exact` design with `lm-rls`, else the paper's 1e4",
    )
    gate: float = Field(
        ge=0.0,
        default=1.2,
        description="learn only from samples with rᵀPr above this multiple of 1 - ρ (`exact` only)",
    )
    covariance_max: float = Field(
        ge=0.0,
        default=1.0e6,
        description="bound of P by exponential resetting; 0: plain forgetting (`exact` only; "
        "unused by `lm-rls` with `alert`)",
    )
    alert: bool = Field(
        default=True,
        description="relearn quickly after an abrupt change of the load: the covariance is raised "
        "(`exact` only)",
    )
    bias: bool = Field(
        default=True,
        description="estimate a constant too, such as a load torque (`exact` only); a battery "
        "always has one",
    )
    initial_state: bool = Field(
        default=True,
        description="estimate the initial state too, such as the speed of a motor that still "
        "turns (`exact` and `lm-rls` only)",
    )
    settle_s: Duration = Field(
        default=30.0, description="time after start before the first update (`exact` only)"
    )


class Supervisor(Section):
    """`[supervisor]`: what estimates, and the loop, must satisfy (`exact` only but `warm_up_s`)."""

    warm_up_s: Duration = Field(
        default=90.0, description="time after start before adaptive may take over"
    )
    ratio_min: Fraction = Field(default=0.2, description="smallest accepted estimate over nominal")
    ratio_max: float = Field(
        default=6.0,
        gt=1.0,
        allow_inf_nan=False,
        description="largest accepted estimate over nominal",
    )
    damping_min: NonNegativeFloat = Field(
        default=0.9,
        description="smallest damping of an estimated load; real time constants have 1; 0: any",
    )
    spread_max: NonNegativeFloat = Field(
        default=0.05,
        description="largest error of the response to a step within `confidence` standard "
        "deviations, as a share of the step; 0: any",
    )
    residual_margin: NonNegativeFloat = Field(
        default=1.5, description="largest prediction error over the nominal model's; 0: any"
    )
    confidence: NonNegativeFloat = Field(
        default=2.0,
        description="standard deviations of an estimate within which its gains must keep the "
        "loop stable; 0: not checked, nor with the last trusted estimate",
    )
    dwell_periods: int = Field(
        default=7, ge=1, le=10_000, description="good estimates in a row before the first goes live"
    )
    patience_periods: int = Field(
        default=0,
        ge=0,
        le=10_000,
        description="refused estimates in a row that the last trusted gains survive",
    )
    blend_periods: int = Field(
        default=5,
        ge=1,
        le=10_000,
        description="slow periods over which one law hands over to the other",
    )
    saturated_s: Duration = Field(
        default=240.0,
        description="longest time at a limit without coming closer to where the model rests, "
        "before the fixed gains return; 0: any",
    )
    gain_slew: float = Field(
        default=1.0,
        gt=0.0,
        le=1.0,
        description="largest share of the way from the gains in force to new ones in a slow period",
    )
    error_limit: NonNegativeFloat | None = Field(
        default=None,
        description="distance from the response asked for, in the unit of the output, that must "
        "not last for ten closed-loop time constants with a free input; "
        f"{100.0 * ERROR_SHARE:g} % of the set-point range when left out; 0: any",
    )
    response_s: Duration = Field(
        default=120.0,
        description="trip when the input was at a limit for this time and the output did not "
        "move; 0: never",
    )
    response_distance: NonNegativeFloat = Field(
        default=0.02,
        description="movement that `response_s` requires, as a share of the set-point range",
    )
