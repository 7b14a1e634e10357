"""Test of residuals for whiteness."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

Array = NDArray[np.float64]

LAGS = 20
"""Lags tested (Ljung and Box, doi:10.1093/biomet/65.2.297)."""


def ljung_box(parts: Sequence[Array], fitted: int) -> float:
    """Return the probability that white noise has autocorrelations as large as these.

    Args:
        parts: Residuals of each uninterrupted part.
        fitted: Parameters of the noise model that was fitted to them.
    """
    count = sum(map(len, parts))
    lags = max(fitted + 1, min(LAGS, count // 5))
    power = sum(float(part @ part) for part in parts)
    if power == 0.0:
        return 1.0
    statistic = 0.0
    for lag in range(1, lags + 1):
        product = sum(float(part[lag:] @ part[:-lag]) for part in parts if len(part) > lag)
        statistic += (product / power) ** 2 / max(1, count - lag)
    return float(chi2.sf(count * (count + 2) * statistic, lags - fitted))
