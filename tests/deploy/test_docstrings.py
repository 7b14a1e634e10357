"""Docstrings begin with what a thing is or does."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
SOURCES = sorted(path for folder in ("src", "simulators") for path in (ROOT / folder).rglob("*.py"))
QUESTION = re.compile(r"(What|Whether|How|Who|Whose|Where|When|Why|Which|Whatever|Whoever)\b")


def questions(source: str) -> Iterator[str]:
    """First lines of docstrings that begin with a question word, with their line numbers."""
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Expr(value=ast.Constant(value=str(text))) if QUESTION.match(text):
                yield f"{node.lineno}: {text.splitlines()[0]}"


def test_no_docstring_begins_with_a_question_word() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}"
        for path in SOURCES
        for line in questions(path.read_text(encoding="utf-8"))
    ]
    assert found == []
