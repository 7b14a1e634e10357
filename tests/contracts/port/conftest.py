"""The rig of each bus."""

from __future__ import annotations

import functools
from collections.abc import AsyncIterator, Callable
from pathlib import Path

import pytest

from tests.contracts.port.can_rigs import CanOpenRig, DbcRig
from tests.contracts.port.polled_rigs import ModbusRig, ScpiRig
from tests.contracts.port.rig import Build, Rig

RIGS: dict[str, Callable[[Path, float], Rig]] = {
    "can": DbcRig,
    "canopen": CanOpenRig,
    "modbus": ModbusRig,
    "scpi": ScpiRig,
}


@pytest.fixture(params=RIGS)
def build(request: pytest.FixtureRequest, tmp_path: Path, memory: None) -> Build:
    """Makes the rig of each bus in turn."""
    return functools.partial(RIGS[request.param], tmp_path)


@pytest.fixture
async def rig(build: Build) -> AsyncIterator[Rig]:
    """A rig whose readings come, and which commands nothing yet."""
    async with build(0.5) as rig:
        yield rig
