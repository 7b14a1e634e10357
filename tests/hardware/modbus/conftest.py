"""The wires of this folder's tests."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.hardware.modbus.bench import Wire


@pytest.fixture(params=["tcp", "rtu"])
def wire(request: pytest.FixtureRequest, tmp_path: Path, free_tcp_port: int) -> Wire:
    """Each kind of wire in turn."""
    return Wire(request.param, tmp_path, free_tcp_port)


@pytest.fixture
def tcp(tmp_path: Path, free_tcp_port: int) -> Wire:
    return Wire("tcp", tmp_path, free_tcp_port)


@pytest.fixture
def rtu(tmp_path: Path, free_tcp_port: int) -> Wire:
    return Wire("rtu", tmp_path, free_tcp_port)
