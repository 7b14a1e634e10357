"""Every trip that the code can name has a remedy, in the registry and in the manual."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from typing_extensions import TypeIs

from adaptdrive.mqtt.contract import TRIPS as REGISTRY
from adaptdrive.mqtt.contract import remedy
from tools.pages.trips_table import with_table

CHECKOUT = Path(__file__).parents[3]
SOURCE = CHECKOUT / "src" / "adaptdrive"
RETURNING = {"find_cause", "_unhealthy", "_exceeded", "trip_cause"} | {
    "_problem",
    "_watch",
    "_departure",
    "precharge_cause",
    "_low",
    "_fallen",
}
"""Functions that return what trips a drive."""
TAKING = {"latch", "fall"}
"""Methods that are given what trips a drive."""

Text = ast.JoinedStr | ast.Constant


@pytest.fixture(scope="module")
def trips() -> list[str]:
    """Every text that trips a drive, as a pattern: what is filled in may be anything."""
    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in SOURCE.rglob("*.py")]
    found = {_pattern(text) for tree in trees for node in ast.walk(tree) for text in _texts(node)}
    return sorted(trip for trip in found if re.search("[a-z]", trip))


def _texts(node: ast.AST) -> Iterator[Text]:
    match node:
        case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) if name in RETURNING:
            returned = (each.value for each in ast.walk(node) if isinstance(each, ast.Return))
            yield from filter(_is_text, returned)
        case ast.Call(func=ast.Attribute(attr=name), args=[text]) if name in TAKING:
            yield from filter(_is_text, [text])
        case ast.Assign(
            targets=[ast.Name(id="_UNRESPONSIVE" | "_DISCONNECTED" | "_CYCLING")], value=text
        ) if _is_text(text):
            yield text


def _is_text(node: ast.expr | None) -> TypeIs[Text]:
    return isinstance(node, ast.JoinedStr) or (
        isinstance(node, ast.Constant) and isinstance(node.value, str)
    )


def _pattern(text: Text) -> str:
    parts = text.values if isinstance(text, ast.JoinedStr) else [text]
    return "".join(
        re.escape(str(part.value)) if isinstance(part, ast.Constant) else ".*" for part in parts
    )


def test_the_table_of_the_manual_is_current() -> None:
    page = (CHECKOUT / "docs" / "operation.md").read_text(encoding="utf-8")
    assert page == with_table(page), "run `make docs`"


def test_a_trip_is_in_the_registry(trips: list[str]) -> None:
    examples = [re.sub(r"^node 5: ", "", known["example"]) for known in REGISTRY]
    without = [trip for trip in trips if not any(re.fullmatch(trip, one) for one in examples)]
    assert not without, "no remedy"


@pytest.mark.parametrize("known", REGISTRY, ids=lambda known: known["sign"])
def test_the_text_of_a_trip_leads_to_its_own_remedy(known: dict[str, str]) -> None:
    assert remedy(known["example"]) == known["remedy"].replace("`", "")
