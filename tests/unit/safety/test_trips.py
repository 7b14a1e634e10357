"""Kinds of trips: what a word names, and the kinds that the controller gives."""

from __future__ import annotations

import pytest

from adaptdrive.control import controller
from adaptdrive.safety.trips import Trip, TripKind, kind_of, remedy


@pytest.mark.parametrize("word", [None, "", "OVER_VOLTAGE", "a kind of another version"])
def test_a_word_of_another_version_names_no_kind(word: str | None) -> None:
    assert kind_of(word) is None


@pytest.mark.parametrize("kind", TripKind)
def test_a_kind_is_read_back_from_its_word(kind: TripKind) -> None:
    assert kind_of(str(kind)) is kind
    assert "`" not in remedy(kind)


def test_the_text_of_a_trip_is_what_is_printed() -> None:
    trip = Trip(TripKind.STALE, "stale: measurement is 54 ms old")
    assert f"{trip}" == "stale: measurement is 54 ms old"
    assert remedy(None) == ""


@pytest.mark.parametrize(
    "fault", [controller._UNRESPONSIVE, controller._DISCONNECTED, controller._CYCLING]
)
def test_what_the_controller_finds_in_a_load_is_a_kind_of_trip(fault: tuple[str, str]) -> None:
    kind, text = fault
    assert kind_of(kind) is not None
    assert text
