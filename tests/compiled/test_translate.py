"""Compiled copies must do what the interpreter does with the same source."""

from __future__ import annotations

import inspect
import math
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adaptdrive.control import in_force, pole_placement, vectors
from adaptdrive.control.charging import Charging
from adaptdrive.control.loads.motor import motor_load
from adaptdrive.control.supervisor import Verdict
from adaptdrive_sim.compiled.layout import layout_of
from adaptdrive_sim.compiled.objects import Memory
from adaptdrive_sim.compiled.sources import compiled_modules
from adaptdrive_sim.compiled.translate import _translated, translate
from adaptdrive_sim.compiled.vectors import compiled


@pytest.fixture(scope="module", autouse=True)
def every_copy() -> None:
    """Make the copies known, whichever of these tests comes first."""
    compiled_modules()


def copy_of(module: Any, name: str) -> Any:
    return getattr(compiled_modules()[module.__name__], name)


@pytest.mark.parametrize("pole", [0.0, 0.7, 0.95])
def test_lists_become_arrays_with_the_same_numbers(pole: float) -> None:
    function = copy_of(pole_placement, "desired_polynomial")
    found = function(pole, 4)
    assert isinstance(found, np.ndarray)
    assert found.tolist() == pole_placement.desired_polynomial(pole, 4)


def test_what_is_overwritten_is_overwritten_in_place() -> None:
    history = np.array([3.0, 2.0, 1.0])
    copy_of(vectors, "shift_in")(history, 4.0)
    assert history.tolist() == [4.0, 3.0, 2.0]


def test_a_singular_system_gives_nan_compiled_too() -> None:
    solve = copy_of(vectors, "solve_linear")
    assert np.isnan(solve(np.zeros(4), np.ones(2))).all()


def test_a_slice_is_a_copy_and_a_sum_of_lists_is_their_concatenation() -> None:
    a, b = np.array([1.0, -1.8, 0.81]), np.array([0.0, 0.1, 0.2])
    desired = np.array([1.0, -1.2, 0.36])
    r, s = copy_of(pole_placement, "place_poles")(a, b, desired)
    expected = pole_placement.place_poles(a.tolist(), b.tolist(), desired.tolist())
    assert (r.tolist(), s.tolist()) == expected


@dataclass(slots=True)
class Inner:
    level: float = 1.5


@dataclass(slots=True)
class Outer:
    inner: Inner = field(default_factory=Inner)
    count: int = 3
    good: bool = True
    values: list[float] = field(default_factory=lambda: [1.0, 2.0])
    verdict: int = Verdict.UNSTABLE_LOAD
    name: str = "not for compiled code"
    charging: Charging | None = None


@compiled
def touch(outer: Any) -> Any:
    outer.count += 1
    outer.good = not outer.good
    outer.inner.level = 2.5
    outer.values[1] = 7.0
    return outer.charging is None, outer.verdict, math.sqrt(outer.values[0])


def test_compiled_code_reads_and_writes_an_object_of_objects() -> None:
    outer = Outer()
    memory = Memory(outer)
    assert touch(memory) == (True, int(Verdict.UNSTABLE_LOAD), 1.0)
    floats = memory.words.view(np.float64)
    places = {one.name: one for one in memory.layout.fields}
    assert "name" not in places
    assert floats[places["inner"].offset] == 2.5
    assert floats[places["values"].offset + 1] == 7.0
    assert memory.words[places["count"].offset] == 4
    assert memory.words[places["good"].offset] == 0


def test_another_description_is_the_same_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    text = '"""{0}"""\n\ndef half(value: float) -> float:\n    """{0}"""\n    return value / 2.0\n'
    for name in ("first", "second"):
        (tmp_path / f"{name}_described.py").write_text(text.format(name))
    first, second = (import_module(f"{name}_described") for name in ("first", "second"))
    assert _translated(first, {}) == _translated(second, {})


def test_a_layout_tells_lengths_apart() -> None:
    assert layout_of(Outer()) == layout_of(Outer(count=9))
    assert layout_of(Outer()) != layout_of(Outer(values=[1.0]))


def test_properties_functions_and_tuples_of_a_load_are_there() -> None:
    load = motor_load(0.011, 11.7, 10.0)

    @compiled
    def ask(load: Any, numerator: Any, denominator: Any) -> Any:
        return load.order, load.physical(numerator, denominator)

    order, values = ask(Memory(load), np.array(load.numerator), np.array(load.denominator))
    assert order == 2
    assert values.tolist() == load.physical(list(load.numerator), list(load.denominator))


def test_a_long_name_leads_to_the_copy_of_a_module() -> None:
    assert copy_of(in_force, "residual_noise").__module__ != in_force.__name__


@dataclass(slots=True)
class Bank:
    before: float = -1.0
    entries: list[Inner] = field(default_factory=lambda: [Inner(), Inner(2.0), Inner(4.0)])
    after: int = 7


def settle(bank: Bank) -> tuple[float, int, bool, bool, bool]:
    best = bank.entries[0]
    for i, entry in enumerate(bank.entries):
        entry.level *= 2.0 + i
        if entry.level > best.level:
            best = entry
    best.level = -3.0
    bank.entries[-2].level += 0.5
    worst = min(entry.level for entry in bank.entries)
    low = any(entry.level < 0.0 for entry in bank.entries)
    sound = all(entry.level < 9.0 for entry in bank.entries)
    return worst, len(bank.entries), low, sound, bank.after in {6, 7}


def test_a_list_of_objects_of_one_class_is_what_it_is_in_the_interpreter(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = "from __future__ import annotations\n\n" + inspect.getsource(settle)
    (tmp_path / "of_branches").mkdir()
    (tmp_path / "of_branches" / "bank.py").write_text(source)
    monkeypatch.syspath_prepend(tmp_path)
    name = "of_branches.bank"
    bank, memory = Bank(), Memory(Bank())
    assert translate([name])[name].settle(memory) == settle(bank)
    expected = [bank.before, *(entry.level for entry in bank.entries)]
    assert memory.words.view(np.float64)[:-1].tolist() == expected
    assert memory.words[-1] == bank.after


def test_a_place_beyond_the_end_of_a_list_of_objects_is_an_error() -> None:
    @compiled
    def level_of(bank: Any, place: int) -> Any:
        return bank.entries[place].level

    memory = Memory(Bank())
    assert level_of(memory, -3) == 1.5
    for place in (3, -4):
        with pytest.raises(IndexError, match="out of range"):
            level_of(memory, place)


def test_objects_of_two_layouts_make_no_list_of_compiled_code() -> None:
    bank = Bank(entries=[Inner(), Outer()])  # type: ignore[list-item]
    assert [one.name for one in layout_of(bank).fields] == ["before", "after"]
