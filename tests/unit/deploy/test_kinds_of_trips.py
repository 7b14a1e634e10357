"""Each kind of trip has a source, an advice, and a place in the manual that says more."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from adaptdrive.safety.trips import ADVICES, TripKind, kind_of, remedy
from tests.unit.deploy.test_links import anchors
from tools.pages.trips_table import with_table

CHECKOUT = Path(__file__).parents[3]
SOURCE = CHECKOUT / "src" / "adaptdrive"


@pytest.fixture(scope="module")
def named() -> set[str]:
    """Kinds that the source names beside their list; control, which imports none, in words."""
    files = [path for path in SOURCE.rglob("*.py") if path.name != "trips.py"]
    texts = [path.read_text(encoding="utf-8") for path in files]
    found = {name for text in texts for name in re.findall(r"\bTripKind\.([A-Z_]+)", text)}
    control = [path.read_text(encoding="utf-8") for path in (SOURCE / "control").rglob("*.py")]
    words = {word for text in control for word in re.findall(r'"([a-z]+(?:-[a-z]+)+)"', text)}
    return {TripKind[name].value for name in found} | words


@pytest.mark.parametrize("kind", TripKind)
def test_a_kind_of_trip_is_produced(kind: TripKind, named: set[str]) -> None:
    assert kind.value in named


@pytest.mark.parametrize("kind", TripKind)
def test_a_kind_of_trip_has_an_advice(kind: TripKind) -> None:
    advice = ADVICES[kind]
    assert all((advice.example, advice.cause, advice.remedy))
    assert "`" not in remedy(kind)
    assert kind_of(kind.value) is kind


@pytest.mark.parametrize("kind", TripKind)
def test_the_page_of_a_kind_of_trip_is_in_the_manual(kind: TripKind) -> None:
    path, _, anchor = ADVICES[kind].page.partition("#")
    assert (CHECKOUT / path).is_file()
    assert not anchor or anchor in anchors(CHECKOUT / path)


def test_the_kinds_of_trips_in_the_manual_are_current() -> None:
    page = (CHECKOUT / "docs" / "operation.md").read_text(encoding="utf-8")
    assert page == with_table(page), "run `make docs`"


def test_a_kind_of_another_version_is_unknown() -> None:
    assert kind_of("moon-phase") is None
    assert kind_of(None) is None
    assert remedy(None) == ""
