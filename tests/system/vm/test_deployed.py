"""A Debian machine from bare to running as the deployment page says, and what may happen to it."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from tests.system.vm.guest_tests import ROOT, plain_pytest_script, show
from tools.vm import machine

pytestmark = pytest.mark.proof  # it needs two processors for ten minutes

HERE = Path(__file__).parent / "deployed"


def newest(*folders: Path) -> float:
    """When anything in some folders was changed last."""
    files = (file for folder in folders for file in folder.rglob("*") if file.suffix != ".pyc")
    return max(file.stat().st_mtime for file in files if file.is_file())


@pytest.fixture(scope="module")
def disk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The machine's disk, which outlives a power cut."""
    for program in ("mosquitto", "mosquitto_pub", "openssl", "candump"):
        if shutil.which(program, path=f"{os.environ['PATH']}:/usr/sbin") is None:
            pytest.skip(f"{program} is not installed")
    package = ROOT / "build" / "adaptdrive.deb"
    if not package.exists() or package.stat().st_mtime < newest(ROOT / "src", ROOT / "deploy"):
        pytest.skip("build/adaptdrive.deb is not of this state of the source; run `make deb`")
    path = tmp_path_factory.mktemp("machine") / "disk"
    machine.make_disk(path)
    return path


@pytest.mark.timeout(2 * machine.PATIENCE_S + 100)
def test_a_deployed_machine(disk: Path, tmp_path: Path, subtests: pytest.Subtests) -> None:
    for boot in ("first_boot", "next_boot"):
        folder = tmp_path / boot
        folder.mkdir()
        script = plain_pytest_script(HERE / f"{boot}.py")
        outcome = machine.run(script, folder, systemd=True, disk=disk)
        show(folder, outcome, subtests)
