"""After the power failed while the drive ran: the machine boots again, and nobody touches it."""

from __future__ import annotations

from tests.system.vm.deployed.first_boot import CONFIG
from tests.system.vm.deployed.site import SHARED, UNIT, Bus, Operator, call, unit_says, until


def test_the_service_is_up_in_standby_and_energises_nothing() -> None:
    bus, operator = Bus(SHARED / "commands-2", SHARED / "device-2"), Operator()
    bus.listen()
    until(lambda: unit_says("ActiveState") == "active", "the daemon")
    assert call("systemctl", "is-active", "mosquitto.service", "systemd-networkd.service")
    operator.listen(SHARED / "heard-2")
    operator.await_state(state="standby", enabled=False, trip=None, mode="fixed")
    bus.start_drive(CONFIG)
    until(lambda: "simulated drive" in bus.device.read_text(), "the simulated drive")
    known = len(bus.commands())
    until(lambda: len(bus.commands()) > known + 100, "commands")
    assert not any(bus.commands())
    operator.run_drive()
    operator.await_accepted("disable")
    operator.await_state(state="standby")
    call("systemctl", "stop", UNIT)
