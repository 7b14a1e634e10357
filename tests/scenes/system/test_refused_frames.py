"""A drive half of whose status frames carry another data id, which ages no value."""

from __future__ import annotations

import time

import pytest

from adaptdrive.runtime.refused_share import WINDOW_S
from tests.scenes.system.bus_ear import BusEar
from tests.scenes.system.conftest import MakeSite
from tests.scenes.system.site import Heard, Site, motor_configuration, until

_PATIENCE_S = 4.0 * WINDOW_S
_STATUS = "bus.integrity.DriveStatus"
_ID_OF_BOTH_BYTES = {
    f"{_STATUS}.algorithm": '"autosar-p01"',
    f"{_STATUS}.data_id": "0x0102",
    f"{_STATUS}.data_id_mode": '"low"',
    "interlocks.stale_s": "1.0",  # a busy machine must not trip the drive
}
_ALTERNATING_ID = {**_ID_OF_BOTH_BYTES, f"{_STATUS}.data_id_mode": '"alternating"'}


def start(site: Site) -> None:
    """Start everything; the drive's own description has the other mode of the data id."""
    site.start_broker()
    believed = site.config.read_text()
    site.config.write_text(motor_configuration(site.broker_port, site.bus_port, _ALTERNATING_ID))
    site.start_device("--initial-voltage", "280")
    site.config.write_text(believed)
    site.start_daemon()
    site.await_measurement()


def refusals(site: Site) -> list[Heard]:
    return [heard for heard in site.ear.on("event") if heard.content["kind"] == "refused"]


def test_half_of_a_message_refused_is_reported_once(make_site: MakeSite) -> None:
    site = make_site(_ID_OF_BOTH_BYTES)
    start(site)
    site.run_drive()
    (event,) = until(lambda: refusals(site), "an event", _PATIENCE_S)
    assert "wrong_checksum" in event.content["detail"]
    assert "data_id" in event.content["detail"]
    time.sleep(1.5 * WINDOW_S)
    assert len(refusals(site)) == 1
    assert site.state["trip"] is None, site.state["trip"]
    assert site.state["state"] == "running"


@pytest.mark.slow
def test_a_configured_share_of_refused_frames_trips(make_site: MakeSite) -> None:
    site = make_site(_ID_OF_BOTH_BYTES | {"interlocks.refused_share": "0.2"})
    start(site)
    with BusEar(site.config) as ear:
        site.run_drive()
        state = site.await_state(_PATIENCE_S, state="tripped")
        assert "refused frames: drive: 25%" in state["trip"]
        assert "limit 20%" in state["trip"]
        until(lambda: ear.commands()[-1].safe, "a safe command")
    until(lambda: "refused frames" in site.ask("reset")["reason"], "the bridge is off")
