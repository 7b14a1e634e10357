"""`[derived.NAME]`: values that are computed from measured ones, by a rule that is data."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from graphlib import CycleError, TopologicalSorter
from typing import Literal

from pydantic import Field

from adaptdrive.config.units import Converted
from adaptdrive.errors import Flaw

Rule = Literal["sum", "mean", "difference", "product", "ratio", "smallest", "largest"]

_PAIRS = ("difference", "ratio")


class Derived(Converted):
    """`[derived.NAME]`: a quantity of `[signals]`, or any other name, from measured values."""

    rule: Rule
    of: list[str] = Field(min_length=1)
    follows: list[str] | None = None

    @property
    def moved(self) -> list[str]:
        """Names of those values that the load moves."""
        if self.follows is not None:
            return self.follows
        return self.of[:1] if self.rule in _PAIRS else self.of


def moved_inputs(name: str, derived: Mapping[str, Derived]) -> tuple[str, ...]:
    """Return the measured values that the load moves a derived one by; none for a measured one.

    Args:
        name: The value.
        derived: `[derived]`, without cycles.
    """
    if name not in derived:
        return ()
    found: dict[str, None] = {}
    for part in derived[name].moved:
        found.update(dict.fromkeys(moved_inputs(part, derived) or (part,)))
    return tuple(found)


def rule_flaws(name: str, derived: Derived) -> Iterator[Flaw]:
    """A rule that does not fit the number of its values."""
    if derived.rule in _PAIRS and len(derived.of) != 2:
        problem = f"{derived.rule!r} takes two values, not {len(derived.of)}"
        yield Flaw(f"derived.{name}.of", problem)
    for part in derived.follows or ():
        if part not in derived.of:
            yield Flaw(f"derived.{name}.follows", f"{part!r} is not one of derived.{name}.of")


def in_order(derived: Mapping[str, Derived]) -> list[str]:
    """Names, each after those that it is made of.

    Raises:
        CycleError: A value is made of itself.
    """
    order = TopologicalSorter({name: one.of for name, one in derived.items()}).static_order()
    return [name for name in order if name in derived]


def cycle_flaws(derived: Mapping[str, Derived]) -> Iterator[Flaw]:
    """A value that is made of itself, by whatever detour."""
    try:
        in_order(derived)
    except CycleError as problem:
        names = problem.args[1]
        yield Flaw(f"derived.{names[-1]}.of", f"is made of itself: {' from '.join(names[::-1])}")
