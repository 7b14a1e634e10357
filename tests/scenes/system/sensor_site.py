"""A site of the bath with thermocouples beside its drive, and mbpoll on the thermocouples' line."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Sequence

import pytest

from tests.scenes.system.conftest import PATIENT_STALE_S, MakeSite
from tests.scenes.system.site import EXAMPLES, PATIENCE_S, Site, _with_setting

_LINE = re.compile(r"^\[(\d+)\]:\s+(-?\d+)", re.MULTILINE)


def bath_site(make_site: MakeSite) -> Site:
    """A site whose drive, still called motor, heats a bath; its line is in the site's folder."""
    site = make_site()
    lines = (EXAMPLES / "bath-thermocouples.toml").read_text(encoding="utf-8").splitlines()
    for section, key, value in (
        ("drive", "name", '"motor"'),
        ("bus", "udp_port", str(site.bus_port)),
        ("bus", "database", f'"{EXAMPLES / "bath.dbc"}"'),
        ("mqtt", "port", str(site.broker_port)),
        ("interlocks", "stale_s", PATIENT_STALE_S),
    ):
        lines = _with_setting(lines, f"[{section}]", key, value)
    site.config.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return site


def mbpoll(site: Site, table: str, address: int, values: Sequence[int] = ()) -> dict[int, int]:
    """Run mbpoll once on the thermocouples; two registers, by zero-based address."""
    program = shutil.which("mbpoll")
    if program is None:
        pytest.skip("mbpoll is not installed")
    link = ["-m", "rtu", "-b", "19200", "-P", "none", "-s", "2", "-a", "5", "-0", "-1"]
    count = [] if values else ["-c", "2"]
    where = ["-t", table, "-r", str(address), *count, str(site.folder / "thermocouples.tty")]
    done = subprocess.run(
        [program, *link, *where, *map(str, values)],
        check=False,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    assert done.returncode == 0, done.stderr
    assert "failed" not in done.stderr, done.stderr
    return {int(register): int(word) for register, word in _LINE.findall(done.stdout)}
