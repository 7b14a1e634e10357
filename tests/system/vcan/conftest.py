"""CAN interfaces of the kernel for tests, and what can-utils do on them."""

from __future__ import annotations

import itertools
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from adaptdrive.config.bus import CanBus
from adaptdrive.devices.can.bus import open_bus
from tests.support import Spawn, has_can
from tests.system.vcan.peers import CanUtils, Link
from tests.unit.devices.bench import Drive, Ear, motor_bus

_names = itertools.count()


@pytest.fixture
def channel() -> Iterator[str]:
    """An interface of its own for each test, as far as this machine and user can have one."""
    if not has_can():
        pytest.skip("this kernel has no AF_CAN")
    if os.geteuid() == 0:
        name = f"adtest{next(_names)}"
        if _ip("link", "add", name, "type", "vcan") or _ip("link", "set", name, "up"):
            pytest.skip("this kernel has no vcan")
        yield name
        _ip("link", "delete", name)
    elif Path("/sys/class/net/vcan0").exists():
        yield "vcan0"
    else:
        pytest.skip("there is no vcan0, and only root may add it")


@pytest.fixture
def link(channel: str) -> Link:
    """Changes the interface of the test."""
    if os.geteuid() != 0:
        pytest.skip("only root may change an interface")

    def change(verb: str, *words: str) -> None:
        assert _ip("link", verb, channel, *words) == 0

    return change


@pytest.fixture
def config(channel: str) -> CanBus:
    """`[bus]` of the example on that interface."""
    return motor_bus(interface="socketcan", channel=channel)


@pytest.fixture
def drive(config: CanBus) -> Iterator[Drive]:
    """A drive made by strangers, on that interface."""
    drive = Drive(open_bus(config))
    yield drive
    drive.bus.shutdown()


@pytest.fixture
def ear() -> Ear:
    """What the port tells."""
    return Ear()


@pytest.fixture
def can_utils(channel: str, spawn: Spawn) -> CanUtils:
    """The programs of can-utils, on that interface."""
    if shutil.which("candump") is None:
        pytest.skip("can-utils are not installed")
    return CanUtils(channel, spawn)


def _ip(*words: str) -> int:
    return subprocess.run(["ip", *words], check=False, stderr=subprocess.DEVNULL).returncode
