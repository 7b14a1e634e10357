"""The page of the constants of the controller, made from the modules that define them.

`python -m tests.control.constants_page docs/constants.md` writes the page; a test keeps it true. A
constant must have a unit here, and a reason below its definition.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

SOURCE = Path(__file__).parents[2] / "src" / "adaptdrive"

_HEAD = """\
# Constants

Every number that was chosen in the code of the controller. What a site may want to change is a key
of the [configuration](configuration.md) instead. `make docs` writes this page from the modules; a
test fails where a constant has no unit or no reason.

Units: *ticks* are half line cycles, *periods* are slow periods T_k, *scale* is the output in the
middle of the voltage range. *1* is a ratio.
"""

_UNITS = {
    "charging.TAPER_GAIN": "1/period",
    "charging._NEAR_LIMIT": "1",
    "charging._END_PERIODS": "periods",
    "controller._FAR_BETTER": "1",
    "controller._IDLE_PERIODS": "periods",
    "estimator._PRIOR_VARIANCE": "σ²",
    "explanation.SETTLED_SAMPLES": "periods",
    "explanation._LOUDER": "1",
    "fast_half._CEILING_RISE": "1/tick",
    "hypotheses._DISTURBANCE_SHARE": "scale of the input",
    "hypotheses._LOAD_SPREAD": "1",
    "hypotheses._GAIN_SHARE": "1",
    "lambda_method._KNOWN": "p0",
    "noise_limit.OBSERVER_POLE": "pole per period",
    "noise_limit.SLOWEST_SHARE": "1",
    "redesign._LOST_PERIODS": "periods",
    "rivals.WINDOW": "periods",
    "rivals.ROOM": "periods",
    "rivals._PRIOR_SAMPLES": "samples",
    "rivals._EARLIEST": "periods",
    "rivals._DECIDED": "log odds",
    "rivals._PROOF": "log odds",
    "rivals._LOAD_RARER": "log odds",
    "rivals._BOTH_RARER": "log odds",
    "rivals._LOAD_REPEATED": "log odds",
    "rivals._LOAD_MEMORY": "periods",
    "rivals._DAMPING": "1",
    "rivals._FLOOR": "scale²",
    "robustness.SURE": "1",
    "robustness.MARGIN_RADIUS": "pole per period",
    "robustness.STABLE_RADIUS": "pole per period",
    "robustness._SMALLEST_SHARE": "1",
    "screen.ALPHA": "1/tick",
    "screen.BETA": "1/tick²",
    "screen.GAMMA": "1/tick",
    "screen.WIDE": "1",
    "slow_half._RETUNE": "1",
    "slow_half._HELD_SHARE": "1",
    "supervisor._STABLE_RADIUS": "pole per period",
    "supervisor._DESIGN_RADIUS": "pole per period",
    "supervisor._RESIDUAL_RATE": "1/period",
    "supervisor._RESIDUAL_FLOOR": "scale²",
    "surprise.DRIFT": "σ²",
    "surprise.LARGEST": "σ²",
    "surprise.THRESHOLD": "σ²",
    "surprise.SETTLE_SAMPLES": "periods",
    "surprise._FLOOR": "scale²",
    "surprise._FAST_RATE": "1/period",
    "surprise._SLOW_RATE": "1/period",
    "voltage_loop.PROPORTIONAL": "1",
    "voltage_loop.INTEGRAL": "1/tick",
    "voltage_loop.LAG_TICKS": "ticks",
    "watch.GROWTH": "1",
    "watch.SWINGS": "peaks",
    "watch.TIME_CONSTANTS": "closed-loop time constants",
    "watch.HELD_SHARE": "1",
    "watch.CLOSER": "1",
    "settings._LOWEST_LINE": "1",
    "settings._SWING_SHARE": "1",
    "settings._ERROR_SHARE": "1",
    "settings._NOISE_SHARE": "1",
    "settings._PAPER_PATIENCE": "periods",
    "settings._PAPER_COVARIANCE": "σ²",
    "settings._OPEN": "σ²",
    "settings._SHORTEST_WAVE_PERIODS": "periods",
    "settings._COLLECT_TICKS": "ticks",
}

_NUMERICAL = {
    "design._HALVINGS",
    "discretise._LARGEST_EXPONENT",
    "discretise._LONGEST_REACH",
    "discretise._LONGEST_STEP",
    "discretise._TAYLOR_TERMS",
    "estimator._TINY",
    "hypotheses._TINY",
    "lambda_filter._SERIES_TERMS",
    "noise_limit._BOTH",
    "noise_limit._FINE",
    "regression._TINY",
    "rls.COVARIANCE_CEILING",
    "rls._SMALLEST",
    "screen._NARROWEST",
    "supervisor._TINY",
    "surprise._MEDIAN",
}
"""Limits of rounding and series, and constants of mathematics: nothing to choose."""

_NAMES = {f"hypotheses.{name}" for name in ("NOTHING", "DISTURBANCE", "LOAD", "BOTH")}
"""Numbers of the explanations."""


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

    @property
    def key(self) -> str:
        """Module and name."""
        return f"{Path(self.module).stem}.{self.name}"


def constants() -> list[Constant]:
    """All chosen numbers, those of rounding left out."""
    paths = [*sorted((SOURCE / "control").rglob("*.py")), SOURCE / "app" / "settings.py"]
    found = [constant for path in paths for constant in _of_module(path)]
    return [one for one in found if one.key not in _NUMERICAL | _NAMES]


def _of_module(path: Path) -> Iterator[Constant]:
    body = ast.parse(path.read_text(encoding="utf-8")).body
    for node, after in zip(body, [*body[1:], ast.Pass()], strict=True):
        match node:
            case ast.Assign(targets=[ast.Name(id=name)], value=value) if name.isupper():
                if _is_number(value):
                    reason = _text_of(after)
                    module = path.relative_to(SOURCE).as_posix()
                    yield Constant(module, name, ast.unparse(value), reason)
            case _:
                pass


def _is_number(value: ast.expr) -> bool:
    """Say whether an expression has numbers in it and nothing but arithmetic around them."""
    kinds = (ast.Constant, ast.BinOp, ast.Name, ast.operator, ast.expr_context)
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


def page() -> str:
    """The whole page."""
    rows = [
        f"| `{one.name}` | {one.value} | {_UNITS[one.key]} | `{one.module}` | {one.reason} |"
        for one in constants()
    ]
    table = ["| constant | value | unit | module | reason |", "|---|---|---|---|---|", *rows]
    return "\n".join([_HEAD, *table, ""])


def units() -> set[str]:
    """Every constant that has a unit, by module and name."""
    return set(_UNITS)


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(page(), encoding="utf-8")
