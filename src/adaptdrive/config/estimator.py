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

    method: Literal["lm-rls", "rls"] = "lm-rls"
    forgetting: float | None = key(None, gt=0.5, le=1.0)
    tau_lambda_s: PositiveFloat = 10.0
    dead_band: float = key(0.0, ge=0.0)
    initial_covariance: PositiveFloat | None = None
    gate: float = key(1.2, ge=0.0)
    covariance_max: float = key(1.0e6, ge=0.0)
    alert: bool = True
    bias: bool = True
    initial_state: bool = True
    settle_s: Duration = 30.0


class Supervisor(Section):
    """`[supervisor]`: what estimates, and the loop, must satisfy (`exact` only but `warm_up_s`)."""

    warm_up_s: Duration = 90.0
    ratio_min: Fraction = 0.2
    ratio_max: float = key(6.0, gt=1.0, allow_inf_nan=False)
    damping_min: NonNegativeFloat = 0.9
    spread_max: NonNegativeFloat = 0.05
    residual_margin: NonNegativeFloat = 1.5
    confidence: NonNegativeFloat = 2.0
    dwell_periods: int = key(7, span=(1, 10_000))
    patience_periods: int = key(0, span=(0, 10_000))
    blend_periods: int = key(5, span=(1, 10_000))
    saturated_s: Duration = 240.0
    gain_slew: float = key(1.0, gt=0.0, le=1.0)
    error_limit: NonNegativeFloat | None = None
    response_s: Duration = 120.0
    response_distance: NonNegativeFloat = 0.02
