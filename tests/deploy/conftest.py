"""Fixtures for what is deployed around the daemon."""

from __future__ import annotations

import shutil
import socket
from collections.abc import Iterator

import pytest

from tests.deploy.broker import GuardedBroker, make_broker
from tests.support import MosquittoLauncher, free_port, stop_process


@pytest.fixture(scope="module")
def guarded(
    mosquitto_launcher: MosquittoLauncher, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[GuardedBroker]:
    """The broker as it is shipped; what one file of tests leaves on it, no other file hears."""
    for program in ("openssl", "mosquitto_passwd", "mosquitto_pub", "mosquitto_sub"):
        if shutil.which(program) is None:
            pytest.skip(f"{program} is not installed")
    folder = tmp_path_factory.mktemp("guarded")
    broker, process = make_broker(folder, mosquitto_launcher.program, free_port(socket.SOCK_STREAM))
    yield broker
    stop_process(process)
