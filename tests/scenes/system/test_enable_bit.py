"""A drive on the bus whose boost stage works only with its one enable bit on."""

from __future__ import annotations

import time

import pytest

from tests.scenes.system.bus_ear import BusEar
from tests.scenes.system.conftest import MakeSite
from tests.scenes.system.site import until

pytestmark = pytest.mark.slow

BOTH = {"drive.enable_bit": '"bridge-and-boost"', "interlocks.precharge_timeout_s": "2.0"}


@pytest.mark.parametrize("where", ["daemon", "drive"])
def test_a_boost_stage_behind_the_enable_bit_starts(make_site: MakeSite, where: str) -> None:
    site = make_site({**BOTH, "voltage_loop.where": f'"{where}"'})
    site.start("--boost-needs-bridge")
    with BusEar(site.config) as bus:
        until(bus.commands, "commands in standby")
        before = bus.commands()
        site.run_drive()
        site.demand("setpoint", 3.0)
        site.await_state(state="running", coasting=False)
        site.demand("disable")
        site.await_state(state="standby")
    assert before
    assert not any(command.bridge for command in before)
    assert any(command.bridge for command in bus.commands())
    assert bus.commands()[-1].safe


def test_a_boost_voltage_that_does_not_rise_trips(make_site: MakeSite) -> None:
    site = make_site({**BOTH, "drive.limits.current_scale_max_S": "3e-4"})  # 4.3 W
    site.start("--boost-needs-bridge")
    with BusEar(site.config) as bus:
        site.demand("enable")
        site.demand("setpoint", 3.0)
        tripped = site.await_state(state="tripped")
        tripped_s = time.monotonic()
        until(lambda: bus.commands()[-1].time_s > tripped_s + 0.1, "commands after the trip")
    assert tripped["trip"].startswith("precharge: v_bst = ")
    assert "with its enable bit on" in tripped["trip"]
    assert bus.commands()[-1].safe


def test_without_the_key_it_never_starts_and_says_why(make_site: MakeSite) -> None:
    site = make_site({"interlocks.precharge_timeout_s": "1.0"})
    site.start("--boost-needs-bridge")
    site.demand("enable")
    site.demand("setpoint", 3.0)
    tripped = site.await_state(state="tripped")
    assert tripped["trip"].startswith("precharge: v_bst = ")
    assert "drive.enable_bit = 'bridge-and-boost'" in tripped["trip"]
