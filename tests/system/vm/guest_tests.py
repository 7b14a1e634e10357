"""Tests that run in the virtual machine, shown here one by one."""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

import pytest

from tools.vm import machine, processors

ROOT = Path(__file__).parents[3]


def pytest_script(words: Sequence[str]) -> str:
    """A script that runs pytest in the guest and leaves its report where `show` finds it."""
    options = "-q -p no:cacheprovider -o addopts='--import-mode=importlib -p pytester'"
    report = "--junitxml=/run/vm/report.xml"
    return f"cd {ROOT}\n{sys.executable} -m pytest {options} {report} {' '.join(words)}\n"


def plain_pytest_script(file: Path) -> str:
    """The same for a file that needs nothing of ours: no configuration, fixtures or plugins."""
    options = f"-vx -c /dev/null --rootdir={ROOT} --confcutdir={file.parent} --durations=0"
    report = "--import-mode=importlib -p no:cacheprovider --junitxml=/run/vm/report.xml"
    words = f"{sys.executable} -m pytest {options} -o pythonpath={ROOT} {report} {file}"
    # apt would read its lists of all packages, for minutes
    return f"cd /\nrm -rf /var/lib/apt/lists/*\nPYTEST_DISABLE_PLUGIN_AUTOLOAD=1 {words}\n"


def show(folder: Path, outcome: machine.Outcome, subtests: pytest.Subtests) -> None:
    """Show each test of the guest as a subtest of this one.

    Args:
        folder: What was shared with the guest.
        outcome: How its script ended. Its failures are not judged where the machine was busy.
        subtests: The fixture.
    """
    report = folder / "report.xml"
    if not report.exists():
        ending = "\n".join([outcome.output[-4000:], outcome.console[-2000:]])
        _fail(f"the virtual machine ended without a report\n{ending}", outcome)
    cases = list(ET.parse(report).iter("testcase"))
    for case in cases:
        with subtests.test(f"{case.get('classname')}::{case.get('name')}"):
            _show_case(case, outcome)
    if outcome.status != 0:
        _fail("\n".join(outcome.output.splitlines()[-5:]), outcome)


def _fail(text: str, outcome: machine.Outcome) -> NoReturn:
    if outcome.share < processors.LEAST_SHARE:
        pytest.skip(
            "not judged: the virtual machine got "
            f"{outcome.share:.0%} of the processor time that it asked for\n{text}"
        )
    pytest.fail(text, pytrace=False)


def _show_case(case: ET.Element, outcome: machine.Outcome) -> None:
    for kind in ("failure", "error"):
        for problem in case.findall(kind):
            _fail(problem.text or kind, outcome)
    for skipped in case.findall("skipped"):
        pytest.skip(skipped.get("message", ""))
