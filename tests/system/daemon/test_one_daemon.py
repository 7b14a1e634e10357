"""One daemon for a drive: real processes, and two of them where no lock can know of the other."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from tests.system.conftest import MakeSite
from tests.system.daemon.site import (
    PATIENCE_S,
    Site,
)


@pytest.fixture
def site(make_site: MakeSite) -> Site:
    site = make_site()
    site.start("--initial-voltage", "280")
    site.run_drive()
    return site


def test_a_second_daemon_is_refused_naming_the_first(site: Site) -> None:
    assert site.daemon is not None
    for _ in range(2):
        refused = subprocess.run(
            [sys.executable, "-m", "adaptdrive.cli", "run", site.config],
            cwd=site.folder,
            env=os.environ | {"STATE_DIRECTORY": str(site.folder / "elsewhere")},
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            check=False,
        )
        assert refused.returncode == 1
        assert f"process {site.daemon.pid} of user {os.getuid()}" in refused.stderr
        assert refused.stderr.count("\n") == 1
    assert site.state["state"] == "running"
