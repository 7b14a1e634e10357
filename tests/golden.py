"""Texts that are kept in one file of each subject: what is asked, and each line of the answer.

A line `> …` asks, several in a row ask at once, and the indented lines below are the answer.
`== …` names what the questions below it are asked of; lines with `#` are comments. A test compares
the whole file with the answers of today. After a change on purpose `RENEW=1 pytest TEST` writes the
file anew; its diff is then part of the review.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

Answer = Callable[[str, list[str]], Iterable[str]]
"""From a subject and the questions that are asked of it at once to the lines of the answer."""


def hold(path: Path, answer: Answer) -> None:
    """Hold a file to the answers of today."""
    kept = path.read_text(encoding="utf-8")
    today = "".join(f"{line}\n" for line in _answered(kept.splitlines(), answer))
    if os.environ.get("RENEW"):
        path.write_text(today, encoding="utf-8")
    else:
        assert today.splitlines() == kept.splitlines(), "RENEW=1 writes the file anew"


def _answered(lines: Iterable[str], answer: Answer) -> Iterator[str]:
    subject, asked = "", list[str]()
    for line in [*lines, ""]:
        if asked and not line.startswith("> "):
            yield from (f"  {one}" for one in answer(subject, asked))
            asked = []
        if line.startswith("> "):
            asked.append(line[2:])
        if line.startswith("== "):
            subject = line[3:]
        if line and not line.startswith("  "):
            yield line
