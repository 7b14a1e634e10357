"""A command of `adaptdrive` for a CiA 402 drive without the package that speaks CANopen."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.unit.devices.canopen.documents import EXAMPLE

pytestmark = pytest.mark.usefixtures("outside")

WITHOUT_CANOPEN = (
    "import sys; sys.modules['canopen'] = None; from adaptdrive.cli import main; sys.exit(main())"
)


def test_without_the_package_there_is_one_clear_line() -> None:
    outcome = subprocess.run(
        [sys.executable, "-c", WITHOUT_CANOPEN, "check", EXAMPLE],
        check=False,
        capture_output=True,
        text=True,
    )
    assert outcome.returncode == 2
    assert "bus.type: 'canopen' needs the package canopen" in outcome.stderr
    assert "Traceback" not in outcome.stderr
