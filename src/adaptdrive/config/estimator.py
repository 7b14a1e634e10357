"""`[estimator]` and `[supervisor]`: how the load is learnt, and when estimates are used."""

from __future__ import annotations

from typing import Literal

from adaptdrive.config.section import (
    Duration,
    Fraction,
    NonNegativeFloat,
    PositiveFloat,
    Section,
    key,
)

FORGETTING = 0.985
"""`estimator.forgetting` of the `exact` design where it is left out."""

ERROR_SHARE = 0.1
"""`supervisor.error_limit` where it is left out, as a share of the range of set-points."""


class Estimator(Section):
    """`[estimator]`: the recursive least squares that learn the load."""

    method: Literal["lm-rls", "rls"] = key("lm-rls", "λ-filtered or direct recursive least squares")
    forgetting: float | None = key(
        None,
        "forgetting factor ρ: the memory is 1/(1 - ρ) slow periods; lower for a load "
        f"that changes fast, nearer 1 against noise; {FORGETTING} when left out, in the `paper` "
        "design 0.97, for a bath 0.99",
        gt=0.5,
        le=1.0,
    )
    tau_lambda_s: PositiveFloat = key(
        10.0,
        "time constant of the λ filters: half the sum of the load's time constants; "
        "longer against noise",
    )
    dead_band: float = key(
        0.0,
        "movement of the output between two slow samples, in its unit, below which "
        "the estimate is not updated",
        ge=0.0,
    )
    initial_covariance: PositiveFloat | None = key(
        None,
        "P[0] = this times I, over the variance of the noise; when left out 1e8 for "
        "the `exact` design with `lm-rls`, else the paper's 1e4",
    )
    gate: float = key(
        1.2, "learn only from samples with rᵀPr above this multiple of 1 - ρ (`exact` only)", ge=0.0
    )
    covariance_max: float = key(
        1.0e6,
        "bound of P by exponential resetting; 0: plain forgetting (`exact` only; "
        "unused by `lm-rls` with `alert`)",
        ge=0.0,
    )
    alert: bool = key(
        True,
        "relearn quickly after an abrupt change of the load: the covariance is raised "
        "(`exact` only)",
    )
    bias: bool = key(
        True,
        "estimate a constant too, such as a load torque (`exact` only); a battery always has one",
    )
    initial_state: bool = key(
        True,
        "estimate the initial state too, such as the speed of a motor that still "
        "turns (`exact` and `lm-rls` only)",
    )
    settle_s: Duration = key(30.0, "time after start before the first update (`exact` only)")


class Supervisor(Section):
    """`[supervisor]`: what estimates, and the loop, must satisfy (`exact` only but `warm_up_s`)."""

    warm_up_s: Duration = key(90.0, "time after start before adaptive may take over")
    ratio_min: Fraction = key(0.2, "smallest accepted estimate over nominal")
    ratio_max: float = key(
        6.0, "largest accepted estimate over nominal", gt=1.0, allow_inf_nan=False
    )
    damping_min: NonNegativeFloat = key(
        0.9, "smallest damping of an estimated load; real time constants have 1; 0: any"
    )
    spread_max: NonNegativeFloat = key(
        0.05,
        "largest error of the response to a step within `confidence` standard "
        "deviations, as a share of the step; 0: any",
    )
    residual_margin: NonNegativeFloat = key(
        1.5, "largest prediction error over the nominal model's; 0: any"
    )
    confidence: NonNegativeFloat = key(
        2.0,
        "standard deviations of an estimate within which its gains must keep the "
        "loop stable; 0: not checked, nor with the last trusted estimate",
    )
    dwell_periods: int = key(
        7, "good estimates in a row before the first goes live", span=(1, 10_000)
    )
    patience_periods: int = key(
        0, "refused estimates in a row that the last trusted gains survive", span=(0, 10_000)
    )
    blend_periods: int = key(
        5, "slow periods over which one law hands over to the other", span=(1, 10_000)
    )
    saturated_s: Duration = key(
        240.0,
        "longest time at a limit without coming closer to where the model rests, "
        "before the fixed gains return; 0: any",
    )
    gain_slew: float = key(
        1.0,
        "largest share of the way from the gains in force to new ones in a slow period",
        gt=0.0,
        le=1.0,
    )
    error_limit: NonNegativeFloat | None = key(
        None,
        "distance from the response asked for, in the unit of the output, that must "
        "not last for ten closed-loop time constants with a free input; "
        f"{100.0 * ERROR_SHARE:g} % of the set-point range when left out; 0: any",
    )
    response_s: Duration = key(
        120.0,
        "trip when the input was at a limit for this time and the output did not move; 0: never",
    )
    response_distance: NonNegativeFloat = key(
        0.02, "movement that `response_s` requires, as a share of the set-point range"
    )
