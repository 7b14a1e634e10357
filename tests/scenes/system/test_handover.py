"""From the fixed controller to the adaptive one and back: the voltage must not jump."""

from __future__ import annotations

from typing import Any

import pytest

from tests.scenes.system.conftest import MakeSite
from tests.scenes.system.site import PATIENT_DRIVE, QUICK_MOTOR, Site, until

CALM_PERIODS = 20
LEARNT_S = 90.0
QUICK = {**QUICK_MOTOR, "supervisor.warm_up_s": "4.0", "estimator.settle_s": "0.5"}
WAVE = {"shape": "square", "low": 2.9, "high": 3.2, "period_s": 3.0}


@pytest.mark.slow
def test_switching_controllers_makes_no_bump(make_site: MakeSite) -> None:
    site = make_site(QUICK)
    site.start("--initial-voltage", "280", *PATIENT_DRIVE)
    site.run_drive()
    site.demand("waveform", WAVE)
    until(lambda: [load for load in _loads(site) if load["accepted"]][2:], "gains", LEARNT_S)
    site.demand("setpoint", 3.1)
    site.let_periods_pass(CALM_PERIODS)
    for mode in ("adaptive", "fixed"):
        before, after = _switch(site, mode)
        assert before["gains"] != after["gains"]
        assert abs(after["handover_step_V"]) < 1.0
        assert abs(after["boost_reference_V"] - before["boost_reference_V"]) < 1.0
    assert site.state["trip"] is None


def _switch(site: Site, mode: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Switch; the last slow period before it, and the first one after."""
    site.demand("mode", mode)
    until(lambda: _loads(site)[-1]["controller"] == mode, f"{mode} is in force")
    loads = _loads(site)
    last = max(index for index, load in enumerate(loads) if load["controller"] != mode)
    return loads[last], loads[last + 1]


def _loads(site: Site) -> list[dict[str, Any]]:
    return [heard.content for heard in site.ear.on("telemetry/load")]
