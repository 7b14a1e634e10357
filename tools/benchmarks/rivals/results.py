"""The figures of docs/proof/compared.md: `make rivals` computes them, and draws the picture.

`python -m tools.benchmarks.rivals.results --only "fixed;adaptive"` computes a part anew and keeps
the rest.
"""

from __future__ import annotations

import argparse
import datetime as dt
import json
import multiprocessing
import re
import sys
from dataclasses import fields
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

from tools.benchmarks.paper_tables import table
from tools.benchmarks.rivals.cases import BATHS, BATTERIES, CASES, MOTORS, Case
from tools.benchmarks.rivals.picture import draw
from tools.benchmarks.rivals.runs import CONTROLLERS, PAPER, Figures, figures, takes_part

ROOT = Path(__file__).parents[3]
RESULT = ROOT / "docs" / "proof" / "compared.json"
PAGE = ROOT / "docs" / "proof" / "compared.md"
PICTURE = ROOT / "docs" / "images" / "compared.png"

FIRST_SEED, SEEDS = 91_500_000, 20
HELD = ("in_force",)
"""Figures of which the least is the worst."""

NAMES = {
    "adaptive": "**adaptdrive, adaptive**",
    "fixed": "adaptdrive, fixed",
    PAPER: "the paper's design, adaptive",
    "SIMC PI": "PI, SIMC",
    "relay PID": "PID, tuned by a relay",
    "RLS": "RLS and pole placement",
    "MPC": "MPC, load known",
    "MPC, preview": "MPC, load and waveform known",
}

Result = dict[str, Any]


def one(case: str, controller: str, seed: int) -> Figures:
    """Run a controller once in the case of that name."""
    return figures(CASES[case], seed, controller)


def found(case: str, controller: str, runs: list[Figures]) -> dict[str, list[float]]:
    """Return median and worst of each figure."""
    shown = {}
    for field in (field.name for field in fields(Figures)):
        values = [float(getattr(run, field)) for run in runs]
        worst = min(values) if field in HELD else max(values)
        shown[field] = [round(median(values), 4), round(worst, 4)]
    sys.stdout.write(f"{case}, {controller}: rms {shown['rms']} %\n")
    sys.stdout.flush()
    return shown


def compute(result: Result, cases: list[str], controllers: list[str], processes: int) -> None:
    """Run cases and controllers, and overwrite their part of the result."""
    seeds = range(result["first_seed"], result["first_seed"] + result["seeds"])
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        for case in cases:
            part = result["cases"].setdefault(case, {})
            for controller in controllers:
                if takes_part(controller, case):
                    runs = pool.map(partial(one, case, controller), seeds, chunksize=5)
                    part[controller] = found(case, controller, runs)


def number(value: float) -> str:
    """Two significant digits at least, down to a hundredth."""
    return f"{value:.0f}" if value >= 10.0 else f"{value:.1f}" if value >= 1.0 else f"{value:.2f}"


def spread(pair: list[float]) -> str:
    """Median and worst."""
    middle, worst = map(number, pair)
    return middle if middle == worst else f"{middle} ({worst})"


def rms_table(result: Result, cases: tuple[Case, ...]) -> str:
    """Deviation from the response asked for: a row for each controller."""
    rows = []
    for key, name in NAMES.items():
        found = [_cell(result, case, key, "rms") for case in cases]
        rows += [[name, *found]] if set(found) != {"-"} else []
    return table(["rms, % of the step", *(case.name for case in cases)], rows)


def _cell(result: Result, case: Case, controller: str, field: str) -> str:
    part = result["cases"][case.name].get(controller)
    return "-" if part is None else spread(part[field])


def other_table(result: Result, cases: tuple[Case, ...]) -> str:
    """Overshoot or largest deviation, IAE and total variation, medians."""
    rows = []
    for key, name in NAMES.items():
        medians = [_medians(result, case.name, key) for case in cases]
        rows += [[name, *medians]] if set(medians) != {"-"} else []
    return table(["overshoot %/IAE s/TV V", *(case.name for case in cases)], rows)


def _medians(result: Result, case: str, controller: str) -> str:
    part = result["cases"][case].get(controller)
    first = "peak" if case in DISTURBED else "overshoot"
    names = first, "iae_s", "variation"
    return "-" if part is None else "/".join(number(part[name][0]) for name in names)


DISTURBED = ("G", "H", "J", "K", "bath G", "battery N")
"""Cases whose largest deviation is shown in place of the overshoot."""

KINDS = {"motors": MOTORS, "baths": BATHS, "batteries": BATTERIES}


def texts(result: Result) -> dict[str, str]:
    """Every table by the name of its mark."""
    last = result["first_seed"] + result["seeds"] - 1
    note = f"\n\nSeeds {result['first_seed']} to {last}, {result['date']}."
    shown = {}
    for kind, cases in KINDS.items():
        other = f"\n\n{other_table(result, cases)}" if kind == "motors" else ""
        shown[f"compared-{kind}"] = f"{rms_table(result, cases)}{other}{note}"
    return shown


def rendered(page: str, result: Result) -> str:
    """Return a page with every table between its marks."""
    for name, text in texts(result).items():
        pattern = rf"(<!-- {name} -->\n).*?(\n<!-- /{name} -->)"
        page = re.sub(pattern, rf"\g<1>{text}\g<2>", page, flags=re.DOTALL)
    return page


def read() -> Result:
    """Return the result file."""
    found: Result = json.loads(RESULT.read_text(encoding="utf-8"))
    return found


def main() -> None:
    """Compute, keep the figures, write the tables and draw the picture."""
    parser = argparse.ArgumentParser(prog="make rivals", description=__doc__)
    parser.add_argument("--cases", default=",".join(CASES))
    parser.add_argument("--only", default=";".join(CONTROLLERS), help="with ; between them")
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    result = read() if RESULT.exists() else {"cases": {}}
    result |= {"first_seed": FIRST_SEED, "seeds": SEEDS}
    result["date"] = dt.datetime.now(tz=dt.UTC).date().isoformat()
    cases, controllers = options.cases.split(","), options.only.split(";")
    compute(result, [c for c in cases if c], [c for c in controllers if c], options.processes)
    RESULT.write_text(json.dumps(result, sort_keys=True) + "\n", encoding="utf-8")
    PAGE.write_text(rendered(PAGE.read_text("utf-8"), result), encoding="utf-8")
    PICTURE.write_bytes(draw(result))


if __name__ == "__main__":
    main()
