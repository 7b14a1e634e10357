"""What was learnt survives a restart of the daemon, and the record says so."""

from __future__ import annotations

import pytest

from tests.system.conftest import MakeSite
from tests.system.daemon.site import QUICK_MOTOR, Site, until

pytestmark = pytest.mark.proof

WARM_UP = 12
QUICK = {
    **QUICK_MOTOR,
    "supervisor.warm_up_s": str(WARM_UP * 0.25),
    "estimator.settle_s": "0.0",
}
WAVE = {"shape": "square", "low": 2.9, "high": 3.2, "period_s": 3.0}


def restart(site: Site) -> None:
    site.start_daemon()
    site.await_measurement()


def periods_to_adaptive(site: Site) -> int:
    """Slow periods of a new run until the adaptive controller is in force."""
    before = len(site.ear.on("telemetry/load"))
    site.run_drive()
    site.demand("waveform", WAVE)
    site.demand("mode", "adaptive")

    def controllers() -> list[str]:
        loads = site.ear.on("telemetry/load")[before:]
        return [heard.content["controller"] for heard in loads]

    until(lambda: "adaptive" in controllers(), "adaptive is in force")
    return controllers().index("adaptive")


def test_a_restarted_daemon_acts_on_what_it_has_learnt_at_once(make_site: MakeSite) -> None:
    site = make_site(QUICK)
    site.start("--initial-voltage", "280", "--noise", "0.0004")
    first = periods_to_adaptive(site)
    assert site.stop_daemon() == 0
    assert site.session().info.prior is None

    restart(site)
    site.await_state(state="standby", controller="fixed")
    again = periods_to_adaptive(site)
    assert again < WARM_UP - 1 <= first
    assert site.stop_daemon() == 0
    assert "start from trusted estimates" in site.daemon_log
    prior = site.session().info.prior
    assert prior is not None
    assert prior == pytest.approx([0.011, 5.425, 7.3125], rel=0.5)
    replayed = site.replay()
    assert replayed.returncode == 0, replayed.stdout + replayed.stderr

    for file in (site.folder / "motor.log").glob("*.log"):
        file.write_bytes(file.read_bytes()[:50])
    restart(site)
    assert site.stop_daemon() == 0
    assert "of the log of an earlier run" in site.daemon_log
    assert site.session().info.prior is None
