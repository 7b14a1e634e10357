"""The page of licences is true, and nothing in the package forbids what users do with it."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools.pages.licences import OPTIONAL, PACKED, closure, licence, page

PAGE = Path(__file__).parents[3] / "docs" / "licences.md"


def test_the_page_is_as_the_installed_libraries_say() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "run `make docs`"


@pytest.mark.parametrize("extras", [PACKED, OPTIONAL])
def test_each_library_names_its_licence(extras: frozenset[str]) -> None:
    assert all(licence(name) for name in closure("adaptdrive", extras))


def test_the_package_binds_nobody_to_open_what_they_build() -> None:
    """The lesser one lets a library be used by anything, as long as it can be replaced."""
    strict = [
        name
        for name in closure("adaptdrive", PACKED)
        if "GPL" in licence(name) and "LGPL" not in licence(name)
    ]
    assert strict == []
