"""`load.design = "paper"` over a bus: the daemon's gains are the paper's, and nothing is added."""

from __future__ import annotations

import cmath
from itertools import pairwise
from typing import Any

import pytest

from tests.scenes.system.conftest import MakeSite
from tests.scenes.system.site import PATIENT_DRIVE, Site, until

POLE, PERIOD_S = 0.70, 1.0
NOMINAL = {"gain": 0.011, "tau_sum_s": 21.7, "tau_product_s2": 117.0}
PAPER = {
    "load.design": '"paper"',
    "load.boost_course": '"impulse"',
    "recording.flush_s": "0.5",
    "supervisor.warm_up_s": "4.0",
    # None of these has a say in the paper's design: no estimate would pass.
    "supervisor.ratio_min": "0.99",
    "supervisor.ratio_max": "1.01",
    "supervisor.spread_max": "1e-9",
    "supervisor.dwell_periods": "1000",
    "estimator.settle_s": "1000.0",
    "estimator.gate": "1e6",
}
WAVE = {"shape": "square", "low": 2.9, "high": 3.2, "period_s": 8.0}


@pytest.mark.slow
def test_every_estimate_reaches_the_gains_by_the_published_formulas(make_site: MakeSite) -> None:
    site = make_site(PAPER)
    site.start("--initial-voltage", "280", *PATIENT_DRIVE)
    site.demand("mode", "adaptive")
    site.run_drive()
    site.demand("waveform", WAVE)
    until(lambda: len(_in_force(site)) >= 20, "twenty slow periods of the adaptive law", 90.0)
    assert site.state["trip"] is None
    loads = _loads(site)
    first = next(i for i, one in enumerate(loads) if one["controller"] == "adaptive")
    assert all(one["controller"] == "adaptive" for one in loads[first:])
    accepted = [one for one in _in_force(site) if one["accepted"]]
    assert len(accepted) >= 10
    for one in accepted:
        r1, r2, h1, h2, h3, _ = one["gains"]
        assert [r1, r2] == pytest.approx(_published(one)[:2], rel=0.01, abs=0.005)
        assert [h1, h2, h3] == pytest.approx(_published(one)[2:], rel=0.05)
    assert max(_distance(one) for one in accepted) > 0.01
    _see_kicks(site)


def _see_kicks(site: Site) -> None:
    """The commanded voltage changes more than once in a slow period, within the limits."""
    assert site.stop_daemon() == 0
    commanded = site.session().ticks["command_boost_reference_V"].to_pylist()[600:]
    voltages = [value for value in commanded if value > 0.0]  # 0 from the stop on
    changes = [after - before for before, after in pairwise(voltages) if after != before]
    assert len(changes) > 1.2 * len(voltages) / 120
    assert 200.0 <= min(voltages) < max(voltages) <= 400.0


def _published(load: dict[str, Any]) -> list[float]:
    """(30), (25) and (28) with the published corrections, as coefficients of past values."""
    gain, total, product = (load["estimates"][name]["value"] for name in NOMINAL)
    gap = cmath.sqrt(0.25 * total * total - product)
    slow, fast = 0.5 * total + gap, 0.5 * total - gap
    left, right = cmath.exp(-PERIOD_S / slow), cmath.exp(-PERIOD_S / fast)
    a1, a2 = -(left + right).real, (left * right).real
    b1 = (PERIOD_S * gain * (left - right) / (slow - fast)).real
    x1, x2, x3, x4 = -4 * POLE, 6 * POLE**2, -4 * POLE**3, POLE**4
    d1 = x4 / a2
    h1 = (x1 + d1 - a1 + 1.0) / b1
    h2 = (x2 + d1 * (a1 - 1.0) + a1 - a2) / b1
    h3 = (x3 + d1 * (a2 - a1) + a2) / b1
    return [-(1.0 + d1), d1, h1, h2, h3]


def _distance(load: dict[str, Any]) -> float:
    """Largest relative distance of an estimate from the nominal model."""
    found = {name: float(load["estimates"][name]["value"]) for name in NOMINAL}
    return max(abs(found[name] / NOMINAL[name] - 1.0) for name in NOMINAL)


def _loads(site: Site) -> list[dict[str, Any]]:
    return [heard.content for heard in site.ear.on("telemetry/load")]


def _in_force(site: Site) -> list[dict[str, Any]]:
    return [one for one in _loads(site) if one["controller"] == "adaptive"]
