"""`adaptdrive check` and `adaptdrive probe` of a CiA 402 drive, as processes."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.hardware.canopen.documents import EDS, EXAMPLE
from tests.support import Spawn

PATIENCE_S = 120.0
WITHOUT_CANOPEN = (
    "import sys; sys.modules['canopen'] = None; from adaptdrive.cli import main; sys.exit(main())"
)


def adaptdrive(*words: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "adaptdrive.cli", *words]
    return subprocess.run(command, check=False, capture_output=True, text=True, timeout=240.0)


def changed(folder: Path, *changes: tuple[str, str]) -> Path:
    text = EXAMPLE.read_text().replace('"cia402.eds"', f'"{EDS}"')
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = folder / "drive.toml"
    path.write_text(text)
    return path


def test_the_example_passes_the_check() -> None:
    outcome = adaptdrive("check", EXAMPLE)
    assert (outcome.returncode, outcome.stderr) == (0, "")


def test_the_check_lists_every_flaw_of_objects(tmp_path: Path) -> None:
    path = changed(tmp_path, ('"0x2001.2"', '"0x2001.9"'), ("Load.Power", "Load.Powers"))
    outcome = adaptdrive("check", path)
    assert outcome.returncode == 2
    assert len(outcome.stderr.splitlines()) == 2
    assert "signals.output: the EDS has no object '0x2001.9'" in outcome.stderr
    assert "signals.load_power_W: the EDS has no object 'Load.Powers'" in outcome.stderr
    assert "did you mean 'Load.Power'?" in outcome.stderr


@pytest.mark.parametrize("verb", ["check", "run", "probe"])
def test_without_the_package_there_is_one_clear_line(tmp_path: Path, verb: str) -> None:
    outcome = subprocess.run(
        [sys.executable, "-c", WITHOUT_CANOPEN, verb, changed(tmp_path)],
        check=False,
        capture_output=True,
        text=True,
        timeout=240.0,
        cwd=tmp_path,
    )
    assert outcome.returncode == 2
    assert "bus.type: 'canopen' needs the package canopen" in outcome.stderr
    assert "Traceback" not in outcome.stderr


def test_a_probe_shows_the_drive_and_leaves_it_as_it_is(
    tmp_path: Path, spawn: Spawn, free_udp_port: int
) -> None:
    path = changed(tmp_path, ("43116", str(free_udp_port)))
    spawn(sys.executable, "-m", "adaptdrive_sim", "device", path)
    probe = spawn(sys.executable, "-m", "adaptdrive.cli", "probe", path)
    deadline_s = time.monotonic() + PATIENCE_S
    shown = tmp_path / "process-1.log"
    while "v_bst  169.7" not in shown.read_text():
        assert time.monotonic() < deadline_s, shown.read_text()
        time.sleep(0.05)
    assert "bridge off" in shown.read_text()
    probe.terminate()
    probe.wait(timeout=PATIENCE_S)
    device = (tmp_path / "process-0.log").read_text()
    assert "commanded" not in device
    assert "power state" not in device


def test_a_probe_of_nobody_says_so_once(tmp_path: Path, spawn: Spawn, free_udp_port: int) -> None:
    path = changed(tmp_path, ("43116", str(free_udp_port)))
    probe = spawn(sys.executable, "-m", "adaptdrive.cli", "probe", path)
    deadline_s = time.monotonic() + PATIENCE_S
    shown = tmp_path / "process-0.log"
    while shown.read_text().count("no reading yet") < 4:
        assert time.monotonic() < deadline_s, shown.read_text()
        time.sleep(0.05)
    probe.terminate()
    probe.wait(timeout=PATIENCE_S)
    told = [line for line in shown.read_text().splitlines() if "no reading yet" not in line]
    assert told[1].startswith("bus lost: udp_multicast 239.")
    assert told[1].endswith(" node 5: no answer when asked to read 0x6079")
    assert len([line for line in told if "no answer" in line or "abort" in line]) == 1
