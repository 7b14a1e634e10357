"""One daemon for a drive: what is locked, and who is refused."""

from __future__ import annotations

import pytest

from adaptdrive.app.process import NAMESPACE, lock_names, locked
from adaptdrive.util.errors import AdaptdriveError
from tests.unit.config.documents import parse
from tests.unit.config.modbus_documents import parse as parse_modbus

SERIAL: dict[str, str | None] = {
    "bus__type": '"modbus-rtu"',
    "bus__host": None,
    "bus__device": '"/dev/ttyUSB7"',
    "bus__device_id": "1",
}


def test_a_drive_has_one_daemon() -> None:
    names = list(lock_names(parse()))
    assert "drive 'bench'" in names
    with locked(names, {NAMESPACE: "here"}):
        with pytest.raises(AdaptdriveError, match="drive 'bench' is controlled by process"):
            locked(names, {NAMESPACE: "here"}).__enter__()
        with locked(names, {NAMESPACE: "another machine"}):
            pass
    with locked(names, {NAMESPACE: "here"}):
        pass


def test_a_serial_line_has_one_master() -> None:
    assert "serial line /dev/ttyUSB7" in set(lock_names(parse_modbus(**SERIAL)))
