"""Settings of the paper's controller: `load.design = "paper"`.

Nothing is added to it: no bounds, no patience, no scaling, no gate, no blending. An estimate that
is not finite or not stable, or whose loop would not be, leaves the gains in force as they are.
"""

from __future__ import annotations

import math
import sys

from adaptdrive.config import Configuration
from adaptdrive.control.methods import METHODS
from adaptdrive.control.settings import Jacket, Learning

PAPER_COVARIANCE = 1.0e4
"""P[0] of the paper."""


def paper_learning(configuration: Configuration) -> Learning:
    """Return the plain estimator (3), which starts at θ = 0; a battery's EMF is a bias of it."""
    estimator, load = configuration.estimator, configuration.load
    return Learning(
        method=METHODS[estimator.method],
        forgetting=estimator.forgetting or load.traits.paper_forgetting,
        tau_lambda_s=estimator.tau_lambda_s,
        dead_band=estimator.dead_band,
        initial_covariance=estimator.initial_covariance or PAPER_COVARIANCE,
        settle_periods=0,
        gate=0.0,
        output_scale=1.0,
        input_scale=1.0,
        start_at_nominal=False,
        bias=load.traits.charges,
    )


def paper_jacket(configuration: Configuration) -> Jacket:
    """Return no checks but those for finite numbers and stable polynomials."""
    warm_up_s, period_s = configuration.supervisor.warm_up_s, configuration.load.period_s
    return Jacket(
        warm_up_periods=math.ceil(warm_up_s / period_s),
        ratio_min=-math.inf,
        ratio_max=math.inf,
        patience_periods=sys.maxsize,
    )
