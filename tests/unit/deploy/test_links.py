"""The links of the manual lead to files and headings, in the sources and in the package."""

from __future__ import annotations

import re
import subprocess
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.unit.deploy.test_pages import PAGES, ROOT

FENCED = re.compile(r"^(```|~~~).*?^\1", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\((?![a-z]+:)([^)#\s]*)(?:#([^)\s]*))?\)")


def text_of(page: Path) -> str:
    """Return a page without its blocks of code."""
    return FENCED.sub("", page.read_text(encoding="utf-8"))


def anchors(page: Path) -> set[str]:
    """Return the anchors that GitHub gives to the headings of a page.

    A heading in lower case keeps its letters, digits, hyphens and underscores; each space becomes
    a hyphen. A heading that occurs again gets -1, -2 and so on.
    """
    found: set[str] = set()
    times: Counter[str] = Counter()
    for heading in re.findall(r"^#{1,6} +(.+?)[ #]*$", text_of(page), re.MULTILINE):
        shown = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading)
        name = re.sub(r"[^\w\- ]", "", shown.lower()).replace(" ", "-")
        found.add(f"{name}-{times[name]}" if times[name] else name)
        times[name] += 1
    return found


def broken(page: Path) -> Iterator[str]:
    """Yield the links of a page that lead nowhere."""
    for path, anchor in LINK.findall(re.sub(r"`[^`\n]*`", "", text_of(page))):
        target = page.parent / path if path else page
        known = target.exists() and (not anchor or anchor in anchors(target))
        if not known:
            yield f"{path}#{anchor}" if anchor else path


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_to_a_file_and_a_heading(page: Path) -> None:
    assert list(broken(page)) == []


@pytest.mark.usefixtures("outside")
def test_the_pages_of_the_package_link_only_to_what_it_carries(tmp_path: Path) -> None:
    subprocess.run([ROOT / "deploy/debian/pages", tmp_path], check=True)
    found = {str(page.relative_to(tmp_path)): list(broken(page)) for page in tmp_path.rglob("*.md")}
    assert {"proof/control.md", "CHANGELOG.md", "decisions/README.md"} <= set(found)
    assert {page: links for page, links in found.items() if links} == {}
