"""The reference page says what the models check."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from importlib import resources
from pathlib import Path

from adaptdrive.config.load import (
    ERROR_SHARE,
    FORGETTING,
    NOISE_SHARE,
    Estimator,
    LoadSection,
    Supervisor,
)
from adaptdrive.config.root import Configuration
from adaptdrive.config.section import Section
from tools.pages.reference_page import reference_page

PAGE = Path(__file__).parents[2] / "docs" / "configuration.md"


def test_the_committed_page_is_current() -> None:
    assert PAGE.read_text(encoding="utf-8") == reference_page(), "run `make docs`"


def test_every_key_has_a_meaning() -> None:
    keys = [line for line in reference_page().splitlines() if line.startswith("| `")]
    assert len(keys) > 40
    assert [key for key in keys if key.endswith("|  |")] == []


def below(section: type[Section]) -> Iterator[type[Section]]:
    yield section
    for one in section.__subclasses__():
        yield from below(one)


def test_every_meaning_is_that_of_a_key() -> None:
    Configuration.model_json_schema()
    sections = {one.__name__: {*one.model_fields} for one in below(Section)}
    for one in below(Section):
        for base in one.__mro__:
            sections.get(base.__name__, set()).update(one.model_fields)
    text = (resources.files("adaptdrive.config") / "keys.toml").read_text(encoding="utf-8")
    for name, meanings in tomllib.loads(text).items():
        assert meanings.keys() <= sections[name], name


def test_the_meaning_of_a_key_that_is_left_out_has_the_number_that_is_taken() -> None:
    said: dict[str, type[Section]] = {
        f"{100.0 * NOISE_SHARE:g} % of the range of V_c when left out": LoadSection,
        f"; {FORGETTING} when left out": Estimator,
        f"{100.0 * ERROR_SHARE:g} % of the set-point range when left out": Supervisor,
    }
    for words, section in said.items():
        keys = section.model_fields.values()
        assert any(words in (one.description or "") for one in keys), words
