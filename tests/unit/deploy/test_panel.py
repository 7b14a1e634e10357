"""The panel's files: vendored libraries as published, and nothing loaded from elsewhere."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

import pytest

PANEL = Path(__file__).parents[3] / "src" / "adaptdrive" / "panel"
OWN = sorted(path for path in PANEL.iterdir() if path.suffix in {".html", ".js", ".css"})
ROW = re.compile(r"^\| `(?P<file>[^`]+)` \|.*`(?P<digest>[0-9a-f]{64})` \|$", re.MULTILINE)


def test_vendored_files_have_the_published_digests() -> None:
    table = (PANEL / "vendor" / "README.md").read_text(encoding="utf-8")
    stated = {match["file"]: match["digest"] for match in ROW.finditer(table)}
    vendored = {path for path in (PANEL / "vendor").iterdir() if path.suffix in {".js", ".css"}}
    assert stated.keys() == {path.name for path in vendored}
    for path in vendored:
        assert hashlib.sha256(path.read_bytes()).hexdigest() == stated[path.name]


def test_every_file_of_the_page_exists() -> None:
    page = (PANEL / "index.html").read_text(encoding="utf-8")
    named = re.findall(r'(?:src|href)="([^"]+)"', page)
    assert {PANEL / name for name in named} >= {path for path in OWN if path.suffix == ".js"}
    for name in named:
        assert (PANEL / name).is_file(), name


@pytest.mark.parametrize("path", OWN, ids=lambda path: path.name)
def test_nothing_is_loaded_from_elsewhere(path: Path) -> None:
    """No address of another host, and no markup made from text, which a payload could fill."""
    text = path.read_text(encoding="utf-8")
    addresses = set(re.findall(r"https?://[\w.-]+", text)) - {"http://www.w3.org"}
    assert addresses == set()
    for unsafe in ("innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "eval("):
        assert unsafe not in text


def test_the_policy_forbids_scripts_from_elsewhere() -> None:
    page = (PANEL / "index.html").read_text(encoding="utf-8")
    policy = re.search(r'Content-Security-Policy" content="([^"]+)"', page)
    assert policy is not None
    directives = dict(part.strip().split(" ", 1) for part in policy[1].split(";"))
    assert directives["default-src"] == "'none'"
    assert directives["script-src"] == "'self'"
    assert "<script>" not in page
