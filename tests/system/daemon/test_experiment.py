"""The ten lines that docs/python.md begins with, on a simulated motor and its daemon."""

from __future__ import annotations

import re
from functools import partial
from typing import Any

import pytest

from adaptdrive import lab
from adaptdrive.mqtt.connection import Broker
from tests.system.conftest import MakeSite
from tests.system.daemon.site import QUICK_MOTOR
from tests.unit.analysis.test_python_page import examples

pytestmark = pytest.mark.proof


def test_ten_lines_do_an_experiment(
    make_site: MakeSite,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    site = make_site(QUICK_MOTOR)
    site.start("--initial-voltage", "280")
    monkeypatch.setattr(lab, "Broker", partial(Broker, port=site.broker_port))
    names: dict[str, Any] = {}
    exec(examples()[0], names)
    rows = re.findall(r"^(\S+) V (\S+) V (.+) V/V$", capsys.readouterr().out, re.MULTILINE)
    assert [float(row[0]) for row in rows] == pytest.approx([2.4, 2.6], abs=0.05)
    site.await_state(state="standby", enabled=False)
    with lab.connect("motor", Broker(port=site.broker_port)) as drive:
        drive.enable()
        drive.wait_until(lambda d: d.estimates and d.gains)
        live, asked = lab.model(drive, config=site.config), lab.model(site.config)
        drive.disable()
    assert live.is_stable
    assert live.parameters.keys() == asked.parameters.keys()
    assert len(live.polynomials("loop")[1]) == len(asked.polynomials("loop")[1])
