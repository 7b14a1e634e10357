"""The certificates that the shipped script makes, as OpenSSL sees them."""

from __future__ import annotations

import shutil
import stat
import subprocess
from pathlib import Path

import pytest

from tests.system.access.broker import SHIPPED

pytestmark = [
    pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed"),
    pytest.mark.usefixtures("outside"),
]


def make(folder: Path, *names: str) -> None:
    command: list[str | Path] = [SHIPPED / "make-certificates", folder, *names]
    subprocess.run(command, check=True, capture_output=True)


def verified(folder: Path, *words: str) -> bool:
    authority, certificate = str(folder / "ca.crt"), str(folder / "broker.crt")
    command = ["openssl", "verify", "-x509_strict", "-CAfile", authority, *words, certificate]
    answer = subprocess.run(command, check=False, capture_output=True)
    return answer.returncode == 0


def test_the_broker_is_vouched_for_under_each_of_its_names(tmp_path: Path) -> None:
    make(tmp_path, "controller.lab", "192.0.2.10", "fd00::1")
    for name in ("localhost", "controller.lab"):
        assert verified(tmp_path, "-purpose", "sslserver", "-verify_hostname", name)
    for address in ("127.0.0.1", "::1", "192.0.2.10", "fd00::1"):
        assert verified(tmp_path, "-purpose", "sslserver", "-verify_ip", address)
    assert not verified(tmp_path, "-verify_hostname", "elsewhere.lab")
    assert not verified(tmp_path, "-purpose", "sslclient")


def test_keys_are_their_owners_alone(tmp_path: Path) -> None:
    make(tmp_path / "certificates")
    for key in ("ca.key", "broker.key"):
        assert stat.S_IMODE((tmp_path / "certificates" / key).stat().st_mode) == 0o600


def test_a_renewal_keeps_the_authority(tmp_path: Path) -> None:
    make(tmp_path)
    authority, first = (tmp_path / "ca.crt").read_bytes(), (tmp_path / "broker.crt").read_bytes()
    make(tmp_path, "new.lab")
    assert (tmp_path / "ca.crt").read_bytes() == authority
    assert (tmp_path / "broker.crt").read_bytes() != first
    assert verified(tmp_path, "-verify_hostname", "new.lab")
