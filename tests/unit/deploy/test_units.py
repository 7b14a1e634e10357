"""The unit and its drop-ins, as systemd itself judges them."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

SHIPPED = Path(__file__).parents[3] / "deploy" / "systemd"
DROP_INS = sorted(path.name for path in (SHIPPED / "drop-ins").iterdir())
WORST_EXPOSURE_TENTHS = 20

pytestmark = [
    pytest.mark.skipif(
        shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed"
    ),
    pytest.mark.usefixtures("outside"),
]

Verify = Callable[[], str]


@pytest.fixture
def units(tmp_path: Path) -> Path:
    """A folder with the unit; its program is one that every machine has."""
    text = (SHIPPED / "adaptdrive@.service").read_text(encoding="utf-8")
    assert "ExecStart=/usr/bin/adaptdrive " in text
    text = text.replace("ExecStart=/usr/bin/adaptdrive ", "ExecStart=/bin/true ")
    (tmp_path / "adaptdrive@.service").write_text(text, encoding="utf-8")
    return tmp_path


def add_drop_in(units: Path, name: str) -> None:
    folder = units / "adaptdrive@.service.d"
    folder.mkdir()
    shutil.copy(SHIPPED / "drop-ins" / name, folder)


def analyze(units: Path, *words: str | Path) -> subprocess.CompletedProcess[str]:
    """Run systemd-analyze where it finds these units before all others."""
    return subprocess.run(
        ["systemd-analyze", "--no-pager", *words],
        env=os.environ | {"SYSTEMD_UNIT_PATH": f"{units}:"},
        capture_output=True,
        text=True,
        check=False,
    )


def complaints(units: Path) -> str:
    """What systemd says about the unit; unknown keys are no failure to systemd 252."""
    return analyze(units, "verify", "--man=no", "adaptdrive@motor.service").stderr


def exposure(units: Path) -> subprocess.CompletedProcess[str]:
    threshold = f"--threshold={WORST_EXPOSURE_TENTHS}"
    return analyze(units, "security", "--offline=true", threshold, units / "adaptdrive@.service")


def test_systemd_has_no_complaint(units: Path) -> None:
    assert complaints(units) == ""


@pytest.mark.parametrize("name", DROP_INS)
def test_systemd_has_no_complaint_about_a_drop_in(units: Path, name: str) -> None:
    add_drop_in(units, name)
    assert complaints(units) == ""


@pytest.mark.parametrize("line", ["WatchdogSecs=3", "ProtectSystem=quite", "Type=notifi"])
def test_a_mistake_would_be_seen(units: Path, line: str) -> None:
    unit = units / "adaptdrive@.service"
    text = unit.read_text(encoding="utf-8")
    unit.write_text(text.replace("[Service]\n", f"[Service]\n{line}\n"), encoding="utf-8")
    assert "adaptdrive@.service:" in complaints(units)


def test_little_is_exposed(units: Path) -> None:
    judged = exposure(units)
    assert judged.returncode == 0, judged.stdout


@pytest.mark.parametrize("name", DROP_INS)
def test_little_is_exposed_with_a_drop_in(units: Path, name: str) -> None:
    add_drop_in(units, name)
    judged = exposure(units)
    assert judged.returncode == 0, judged.stdout


def test_a_hole_in_the_sandbox_would_be_seen(units: Path) -> None:
    unit = units / "adaptdrive@.service"
    text = unit.read_text(encoding="utf-8")
    unit.write_text(text.replace("CapabilityBoundingSet=\n", ""), encoding="utf-8")
    assert exposure(units).returncode != 0
