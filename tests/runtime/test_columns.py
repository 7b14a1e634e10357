from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec
import pytest

from adaptdrive.control.columns import Column, Quantity, columns_of, rebuild
from adaptdrive.control.signals import Command, Measurement, Mode, Order, Stage
from adaptdrive.runtime.reports import SLOW_COLUMNS, TICK_COLUMNS, TickReport
from tools.pages.columns_page import page

PAGE = Path(__file__).parents[2] / "docs" / "columns.md"


def test_the_page_of_the_columns_is_current() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "run `make docs`"


@pytest.mark.parametrize("columns", [SLOW_COLUMNS, TICK_COLUMNS])
def test_names_of_columns_are_unique(columns: tuple[Column, ...]) -> None:
    names = [column.name for column in columns]
    assert len(names) == len(set(names))


@dataclass(frozen=True)
class Inner:
    level: Annotated[float, Quantity("m", "level")]
    hidden: int


@dataclass(frozen=True)
class Outer:
    k: Annotated[int, Quantity("", "index")]
    inner: Inner


def test_only_annotated_fields_become_columns() -> None:
    found = [(c.name, c.kind, c.unit, c.read(Outer(3, Inner(2.5, 1)))) for c in columns_of(Outer)]
    assert found == [("k", int, "", 3), ("level", float, "m", 2.5)]


def test_a_tick_is_rebuilt_from_its_columns() -> None:
    order = Order(Stage.RUN, 3.2, Mode.ADAPTIVE, 0.7)
    measurement = Measurement(7, 1 / 120, 280.0, 120.0, 400.0, 3.1, fresh=False)
    tick = TickReport(4, measurement, order, 2, Command(0.03, 281.5, True), 1.0, 2.0, 3.0, 4.0)
    row = {column.name: column.read(tick) for column in TICK_COLUMNS}
    assert rebuild(TickReport, msgspec.json.decode(msgspec.json.encode(row))) == tick
