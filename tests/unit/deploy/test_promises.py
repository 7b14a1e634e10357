"""Each promise of the manual names a test that exists, and each row of the faults has one."""

from __future__ import annotations

import ast
import functools
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.integration.wire.matrix import ROWS
from tools.proof.page import page, with_faults

CHECKOUT = Path(__file__).parents[3]
PAGES = ["README.md", "SECURITY.md", *(str(one.relative_to(CHECKOUT))
         for one in sorted((CHECKOUT / "docs").rglob("*.md")))]  # fmt: skip
PROMISES = CHECKOUT / "docs" / "proof" / "promises.md"
RELIABILITY = CHECKOUT / "docs" / "proof" / "reliability.md"

TEST = re.compile(r"\b(test_\w*[a-z0-9])\b(?!\.py|…|_)")
FILE = re.compile(r"\b(?:tests|tools)/[\w/]+\.py\b")
CASE = re.compile(r"`\[([a-z-]+?)-…\]`")

FAULTS = r"\| fault( of the machine)? \| (sent to the drive|the drive|on CAN|effect) "
"""Heads of tables with a test in each row; other tables are the figures of one command."""


@functools.cache
def defined() -> frozenset[str]:
    """Names of all test functions and test files."""
    names = set()
    for path in (CHECKOUT / "tests").rglob("*.py"):
        names.add(path.stem)
        tree = ast.parse(path.read_text(encoding="utf-8"))
        kinds = ast.FunctionDef, ast.AsyncFunctionDef
        names.update(node.name for node in ast.walk(tree) if isinstance(node, kinds))
    return frozenset(names)


def rows(page_text: str, head: str) -> Iterator[str]:
    """Yield the rows of the tables whose head matches a pattern."""
    within = False
    for line in page_text.splitlines():
        if not line.startswith("|"):
            within = False
        elif re.match(head, line):
            within = True
        elif within and not line.startswith("|---"):
            yield line


def holders(text: str) -> list[str]:
    """Tests, files and cases of the matrix that a text names."""
    return [*TEST.findall(text), *FILE.findall(text), *CASE.findall(text)]


@pytest.mark.parametrize("name", PAGES)
def test_every_test_that_a_page_names_exists(name: str) -> None:
    text = (CHECKOUT / name).read_text(encoding="utf-8")
    assert [one for one in TEST.findall(text) if one not in defined()] == []
    assert [one for one in FILE.findall(text) if not (CHECKOUT / one).is_file()] == []


def test_every_case_of_the_matrix_that_is_named_exists() -> None:
    known = {row.name for row in ROWS}
    named = set(CASE.findall(RELIABILITY.read_text(encoding="utf-8")))
    assert named
    assert named <= known


def test_every_row_of_the_faults_names_a_test() -> None:
    text = RELIABILITY.read_text(encoding="utf-8")
    found = list(rows(text, FAULTS))
    assert len(found) > 70
    assert [row[:60] for row in found if not holders(row)] == []


def test_every_promise_names_a_test() -> None:
    found = list(rows(PROMISES.read_text(encoding="utf-8"), r"\| promise \|"))
    assert len(found) > 25
    assert [row[:60] for row in found if not holders(row)] == []


def test_the_pages_of_measured_results_are_current() -> None:
    written = (CHECKOUT / "docs" / "proof" / "proof.md").read_text(encoding="utf-8")
    assert written == page(), "run `make docs`"
    text = RELIABILITY.read_text(encoding="utf-8")
    assert text == with_faults(text), "run `make docs`"
