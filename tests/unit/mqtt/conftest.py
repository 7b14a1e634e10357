"""A broker, a disk and a service, all in this process and in virtual time."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import pytest

from tests.unit.mqtt.memory_broker import MemoryBroker
from tests.unit.mqtt.peers import Bench, serving
from tests.unit.recording.disk import Disk


@pytest.fixture
def broker() -> Iterator[MemoryBroker]:
    broker = MemoryBroker()
    with broker.joined():
        yield broker


@pytest.fixture(autouse=True)
def log_disk(monkeypatch: pytest.MonkeyPatch) -> Disk:
    """Where every log of these tests is written, at once."""
    return Disk(monkeypatch)


@pytest.fixture
async def bench(broker: MemoryBroker, log_disk: Disk, tmp_path: Path) -> AsyncIterator[Bench]:
    async with serving(broker, "motor", tmp_path) as running:
        yield running
