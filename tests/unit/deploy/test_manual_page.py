"""The manual page names every command, and the formatter of Debian finds no fault with it."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from adaptdrive.cli.options import _COMMANDS
from adaptdrive.runtime.requests import REQUESTS

PAGE = Path(__file__).parents[3] / "deploy" / "debian" / "adaptdrive.1"


def test_it_names_every_command() -> None:
    text = PAGE.read_text(encoding="utf-8").partition(".SH COMMANDS")[2].partition(".SH EXIT")[0]
    lines = [line for line in text.splitlines() if line.startswith((".B ", ".BR "))]
    named = {word for line in lines for word in re.findall(r"[a-z]+", line)}
    assert named == {*_COMMANDS, *REQUESTS, "list", "sessions"}


@pytest.mark.usefixtures("outside")
def test_its_formatter_finds_no_fault() -> None:
    if shutil.which("groff") is None:
        pytest.skip("groff is not installed")
    command = ["groff", "-man", "-Tascii", "-ww", "-z", str(PAGE)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    assert done.stderr == ""
