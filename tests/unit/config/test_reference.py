"""The reference page says what the models check."""

from __future__ import annotations

from pathlib import Path

from adaptdrive.config.load import FORGETTING, Estimator, LoadSection, MotorSection
from adaptdrive.config.section import meanings_of
from tools.pages.reference_page import reference_page

PAGE = Path(__file__).parents[3] / "docs" / "configuration.md"


def test_the_committed_page_is_current() -> None:
    assert PAGE.read_text(encoding="utf-8") == reference_page(), "run `make docs`"


def test_every_key_has_a_meaning() -> None:
    keys = [line for line in reference_page().splitlines() if line.startswith("| `")]
    assert len(keys) > 40
    assert [key for key in keys if key.endswith("|  |")] == []


def test_a_meaning_holds_for_the_classes_below_until_one_states_another() -> None:
    motor = meanings_of(MotorSection)
    assert motor["latency_ticks"] == meanings_of(LoadSection)["latency_ticks"]
    assert motor["output_name"] == "name of the output for people"


def test_the_meaning_of_a_key_that_is_left_out_has_the_number_that_is_taken() -> None:
    assert f"; {FORGETTING} when left out" in meanings_of(Estimator)["forgetting"]
