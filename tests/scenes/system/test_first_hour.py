"""The way of docs/own-drive.md from `init` to adaptive control, with the commands of the page."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.scenes.system.first_hour import PAGE, page_with, walk


def labels(page: str) -> list[list[str]]:
    """First word of each line of a recorded text that does not depend on what is measured."""
    blocks = re.findall(r"```console\n\$ adaptdrive (.*?)```", page, re.DOTALL)
    steady = [one for one in blocks if one.startswith(("init", "check", "status"))]
    return [[line.split()[0] for line in one.splitlines() if line.strip()] for one in steady]


@pytest.mark.slow
@pytest.mark.timeout(1500)
def test_the_commands_of_the_page_lead_to_adaptive_control(tmp_path: Path) -> None:
    page = PAGE.read_text(encoding="utf-8")
    recorded = walk(tmp_path.resolve(), "--patience", "1")
    anew = page_with(recorded, page)
    assert re.search(r"pump holds [\d.]+ rad/s in mode adaptive, in force after [\d.]+ s", anew)
    assert "controller  adaptive (asked for adaptive)" in anew
    assert labels(anew) == labels(page)
    assert (tmp_path / "commission.png").read_bytes().startswith(b"\x89PNG")
