"""The tests that need CAN in the kernel, on a kernel that has it."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support import has_can
from tests.system.vm.guest_tests import ROOT, pytest_script, show
from tools.vm import machine

pytestmark = pytest.mark.proof  # it needs two processors

_MARK = "mark.vcan"


def files_with_the_mark() -> list[str]:
    """Where to look: the guest would take minutes to collect all tests."""
    files = (ROOT / "tests").rglob("test_*.py")
    return [str(file) for file in files if _MARK in file.read_text(encoding="utf-8")]


@pytest.mark.timeout(machine.PATIENCE_S + 100)
@pytest.mark.skipif(has_can(), reason="this kernel has AF_CAN: its own interfaces were tested")
def test_can_on_a_kernel_that_has_it(tmp_path: Path, subtests: pytest.Subtests) -> None:
    script = pytest_script(["-m", "vcan", *files_with_the_mark()])
    show(tmp_path, machine.run(script, tmp_path), subtests)
