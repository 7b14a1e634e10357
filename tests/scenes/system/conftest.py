"""Sites for tests: each has ports and a folder of its own, and ends what it started."""

from __future__ import annotations

import contextlib
import shutil
import socket
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Protocol

import pytest

from tests.scenes.system.site import Site
from tests.support import MosquittoLauncher, free_port

PATIENT_STALE_S = "0.2"
"""A machine that is busy with other tests must not trip the drives of these."""


class MakeSite(Protocol):
    """Makes a site from the example configuration, changed by `section.key` and TOML value."""

    def __call__(self, changes: Mapping[str, str] | None = None) -> Site: ...


@contextlib.contextmanager
def sites(folder: Path, launcher: MosquittoLauncher) -> Iterator[MakeSite]:
    for program in ("mosquitto_pub", "mosquitto_sub"):
        if shutil.which(program) is None:
            pytest.skip(f"{program} is not installed")
    with contextlib.ExitStack() as stack:

        def make(changes: Mapping[str, str] | None = None) -> Site:
            ports = free_port(socket.SOCK_STREAM), free_port(socket.SOCK_DGRAM)
            settings = {"interlocks.stale_s": PATIENT_STALE_S, **(changes or {})}
            site = Site(folder, launcher, *ports, settings)
            stack.callback(site.close)
            return site

        yield make


@pytest.fixture
def make_site(tmp_path: Path, mosquitto_launcher: MosquittoLauncher) -> Iterator[MakeSite]:
    with sites(tmp_path, mosquitto_launcher) as make:
        yield make


@pytest.fixture(scope="module")
def make_shared_site(
    tmp_path_factory: pytest.TempPathFactory, mosquitto_launcher: MosquittoLauncher
) -> Iterator[MakeSite]:
    with sites(tmp_path_factory.mktemp("site"), mosquitto_launcher) as make:
        yield make
