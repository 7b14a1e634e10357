"""The virtual machine, for tests that have this machine's own kernel do what it can."""

from __future__ import annotations

import pytest

from tools.vm import machine


@pytest.fixture(scope="session", autouse=True)
def _virtual_machine() -> None:
    if reason := machine.why_not():
        pytest.skip(reason)
