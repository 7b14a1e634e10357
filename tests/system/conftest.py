"""Sites for system tests: each has ports and a folder of its own, and ends what it started."""

from __future__ import annotations

import contextlib
import shutil
import socket
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Protocol

import pytest

from tests.support import MosquittoLauncher, free_port
from tests.system.daemon.site import PATIENT, NotifySocket, Site


class MakeSite(Protocol):
    """Makes a site from an example configuration, changed by `section.key` and TOML value."""

    def __call__(self, changes: Mapping[str, str] | None = None, example: str = "motor") -> Site:
        """Make a site; its limits are patient where the changes do not say otherwise."""


@pytest.fixture
def make_site(tmp_path: Path, mosquitto_launcher: MosquittoLauncher) -> Iterator[MakeSite]:
    for program in ("mosquitto_pub", "mosquitto_sub"):
        if shutil.which(program) is None:
            pytest.skip(f"{program} is not installed")
    with contextlib.ExitStack() as stack:

        def make(changes: Mapping[str, str] | None = None, example: str = "motor") -> Site:
            ports = free_port(socket.SOCK_STREAM), free_port(socket.SOCK_DGRAM)
            site = Site(
                tmp_path, mosquitto_launcher, *ports, {**PATIENT, **(changes or {})}, example
            )
            stack.callback(site.close)
            return site

        yield make


@pytest.fixture
def manager(tmp_path: Path, outside: None) -> Iterator[NotifySocket]:
    notify = NotifySocket(tmp_path / "notify")
    yield notify
    notify.close()
