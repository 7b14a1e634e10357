"""The page of the constants of the controller, made from the modules that define them.

`python -m tools.pages.constants_page docs/proof/constants.md` writes it; a test keeps it true.
A constant must have a unit here, and a reason below its definition.
"""

from __future__ import annotations

import ast
import importlib
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from pathlib import Path

from tools.pages.constants_effects import CHANGES, Effects, cells, head, is_active, read_effects

SOURCE = Path(__file__).parents[2] / "src" / "adaptdrive"

_HEAD = """\
# Constants

For developers of the controller: every number that was chosen in its code, then those that
[follow from these](#what-follows). Limits of rounding and of series, constants of mathematics and
numbers of the paper are in the code only. `make docs` writes this page.

Units: *ticks* are half line cycles, *periods* slow periods T_k, *scale* is the output in the
middle of the voltage range; a number without a unit is a ratio. Modules are below `control` unless
a folder is named.
"""

_UNITS = {
    "FEWEST": "periods",
    "MEMORY": "periods",
    "CLEAR": "log odds",
    "PRIOR_SHARE": "1",
    "RARER": "log odds",
    "_NEAR_LIMIT": "1",
    "_POWER_FACTOR": "1",
    "MODEL_ERROR": "1",
    "_POLE_STEP": "1",
    "_BELOW_RANGE": "1",
    "ABOVE": "1",
    "_STEP": "1",
    "HALF_DELAYS": "1",
    "_WALK": "σ",
    "_EMF_NOISE": "σ",
    "_CEILING_RISE": "1/reading",
    "DISTURBANCE_SHARE": "scale of the input",
    "MODULUS_MARGIN": "1",
    "DELAY_MARGIN": "periods",
    "SPENT": "1",
    "UNREST": "1",
    "SLOWEST_SHARE": "1",
    "_SHOWN": "σ",
    "RARE": "log odds",
    "NOISE_FLOOR": "scale²",
    "_SMALLEST_SHARE": "1",
    "WIDE": "1",
    "LOST_SHARE": "1",
    "DRIFT": "σ²",
    "_FAST_RATE": "1/period",
    "CLOSER": "1",
    "FAR_BETTER": "1",
    "_LOWEST_LINE": "1",
    "_SWING_SHARE": "1",
    "_ERROR_SHARE": "1",
    "_NOISE_SHARE": "1",
    "_CLIP": "mean deviations",
    "_GATE": "1",
    "_DAMPING_MIN": "1",
    "_SPREAD_MAX": "1",
    "_RESIDUAL_MARGIN": "1",
    "_CONFIDENCE": "σ",
    "_DWELL_PERIODS": "periods",
    "_BLEND_PERIODS": "periods",
    "_PROBE_S": "s",
    "_FASTEST": "1",
    "_SLOWEST": "1",
    "KICK_SHARE": "1",
    "TOLERANCE": "steps",
    "_SHORTEST_WAVE_PERIODS": "periods",
}

_FOLLOWING = """
## What follows

These are computed and move with the constants above.
"""

_NUMERICAL = {
    "_PASSES",
    "_HALVINGS",
    "_FREQUENCIES",
    "_STEPS",
    "_NEXT",
    "_LONGEST_REACH",
    "_LONGEST_STEP",
    "_TAYLOR_TERMS",
    "_ROUNDING",
    "_TINY",
    "_SERIES_TERMS",
    "COVARIANCE_CEILING",
    "_SMALLEST",
    "_NARROWEST",
    "_MEDIAN",
    "_LARGEST",
    "_LARGEST_MULTIPLE",
}
"""Limits of rounding and series, guards against numbers that no sensor gives, and constants of
mathematics: nothing to choose."""

_PAPER = {"PAPER_COVARIANCE"}
"""Numbers of the paper."""

_NAMES = {"DISTURBANCE", "LOAD", "ANEW"}
"""Numbers of the kinds of change."""


@dataclass(frozen=True, slots=True)
class Constant:
    """A number that a module defines.

    Attributes:
        module: Path below the package.
        name: Its name.
        value: As it is written.
        reason: The text below it, in one line.
    """

    module: str
    name: str
    value: str
    reason: str


def constants() -> list[Constant]:
    """All chosen numbers."""
    return [one for one in _plain() if one.name not in _NUMERICAL | _PAPER]


def given() -> list[Constant]:
    """All numbers with nothing to choose."""
    return [one for one in _plain() if one.name in _NUMERICAL | _PAPER]


def following() -> list[Constant]:
    """All numbers that are computed where they are defined."""
    return [
        one
        for one, value in _defined()
        if not _is_number(value) and isinstance(value_of(one), int | float | Fraction)
    ]


def value_of(one: Constant) -> object:
    """Return what the module has."""
    return getattr(importlib.import_module(module_name(one)), one.name)


def module_name(one: Constant) -> str:
    """Return the full name of the module of a constant."""
    return "adaptdrive." + one.module.removesuffix(".py").replace("/", ".")


def _plain() -> list[Constant]:
    return [one for one, value in _defined() if _is_number(value) and one.name not in _NAMES]


@cache
def _defined() -> list[tuple[Constant, ast.expr]]:
    app = SOURCE / "app"
    paths = [*sorted((SOURCE / "control").rglob("*.py")), app / "loads.py", app / "settings.py"]
    return [found for path in paths for found in _of_module(path)]


def _of_module(path: Path) -> Iterator[tuple[Constant, ast.expr]]:
    body = ast.parse(path.read_text(encoding="utf-8")).body
    for node, after in zip(body, [*body[1:], ast.Pass()], strict=True):
        match node:
            case ast.Assign(targets=[ast.Name(id=name)], value=value) if name.isupper():
                module = path.relative_to(SOURCE).as_posix()
                yield Constant(module, name, ast.unparse(value), _text_of(after)), value
            case _:
                pass


def _is_number(value: ast.expr) -> bool:
    """Return whether an expression is numbers alone: one with names follows from others."""
    kinds = (ast.Constant, ast.BinOp, ast.UnaryOp, ast.operator, ast.unaryop)
    parts = list(ast.walk(value))
    numbers = [one for one in parts if isinstance(one, ast.Constant)]
    return (
        bool(numbers)
        and all(isinstance(one, kinds) for one in parts)
        and all(isinstance(one.value, int | float) for one in numbers)
    )


def _text_of(node: ast.stmt) -> str:
    match node:
        case ast.Expr(value=ast.Constant(value=str(text))):
            return " ".join(text.split())
        case _:
            return ""


def page(effects: Effects | None = None) -> str:
    """Return the whole page.

    Args:
        effects: What it does to change the constants; what was measured last when left out.
    """
    found = read_effects() if effects is None else effects
    names = ["module.constant", "value", "reason", *(CHANGES if found else ())]
    rows = [_line(names), "|" + "---|" * len(names), *(_row(one, found) for one in constants())]
    shown = constants()
    count = [f"There are {len(shown)} constants.", ""]
    if found:
        active = sum(is_active(found, one.module, one.name, one.value) for one in shown)
        count = [f"Of {len(shown)} constants {active} change a run.", ""]
    chosen = [_HEAD, *([head(found)] if found else []), *count, *rows]
    computed = [_FOLLOWING, *_table(following(), "computed as")]
    return "\n".join([*chosen, *computed, ""])


def _table(numbers: list[Constant], value: str) -> list[str]:
    names = ["module.constant", value, "reason"]
    rows = [[_place(one), f"`{one.value}`", one.reason] for one in numbers]
    return [_line(names), "|" + "---|" * len(names), *map(_line, rows)]


def _row(one: Constant, effects: Effects) -> str:
    unit = _UNITS[one.name]
    known = [_place(one), one.value if unit == "1" else f"{one.value} {unit}", one.reason]
    return _line([*known, *(cells(effects, one.module, one.name, one.value) if effects else ())])


def _place(one: Constant) -> str:
    module = one.module.removeprefix("control/").removesuffix(".py")
    return f"`{module}`.`{one.name}`"


def _line(parts: list[str]) -> str:
    return f"| {' | '.join(parts)} |"


def units() -> set[str]:
    """Every constant that has a unit."""
    return set(_UNITS)


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(page(), encoding="utf-8")
