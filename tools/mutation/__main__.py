"""Do the tests notice small changes of the code? `python -m tools.mutation [MODULE|PART ...]`.

For each module of `targets.py`, or of a part that is named there, its tests are
collected once. Each mutant then lives in a process of its own, in which the tests run that execute
the changed lines. What survives is listed, with its reason where `survivors.py` has one. MUTANTS
bounds the number for each module; a sample of a fixed seed is taken.
"""

from __future__ import annotations

import contextlib
import importlib.util
import io
import os
import random
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from tools.mutation.live import put
from tools.mutation.mutants import Mutant, mutants
from tools.mutation.survivors import REASONS
from tools.mutation.targets import PARTS, TARGETS
from tools.mutation.trial import Trials

SEED = 20261122
HEAD = "| module | mutants | tried | killed | explained | survived | killed, of all but explained |"


@dataclass
class Score:
    """What became of the mutants of a module."""

    module: str
    total: int = 0
    tried: int = 0
    explained: int = 0
    survivors: list[str] = field(default_factory=list)

    @property
    def line(self) -> str:
        """A line of the table."""
        left = len(self.survivors)
        killed = self.tried - self.explained - left
        share = 100.0 * killed / max(1, killed + left)
        name = self.module.removeprefix("adaptdrive.")
        return (
            f"| `{name}` | {self.total} | {self.tried} | {killed} | {self.explained} | {left} "
            f"| {share:.0f} % |"
        )


def judge(module: str, tests: Sequence[str], longest: int) -> Score:
    """Try the mutants of a module."""
    file = source_of(module)
    every = mutants(module, file.read_text(encoding="utf-8"))
    _refuse_stale_reasons(module, every)
    chosen = every if len(every) <= longest else _sample(every, longest)
    score = Score(module, len(every), len(chosen))

    def work(trials: Trials) -> None:
        for mutant in chosen:
            _try(mutant, trials, str(file), score)

    words = [*tests, "-q", "-p", "no:cacheprovider", "-p", "no:xdist"]
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        status = pytest.main(words, plugins=[Trials([str(file)], work)])
    if status not in (0, 5):
        raise RuntimeError(printed.getvalue()[-2000:])
    return score


def _refuse_stale_reasons(module: str, every: Sequence[Mutant]) -> None:
    """Refuse reasons that belong to none of the mutants: the source has changed since."""
    own = {name for name in REASONS if name.startswith(f"{module.removeprefix('adaptdrive.')}:")}
    if stale := sorted(own - {one.name for one in every}):
        raise RuntimeError(f"survivors.py has reasons of changes that are not tried: {stale}")


def _sample(every: Sequence[Mutant], longest: int) -> list[Mutant]:
    drawn = random.Random(SEED).sample(range(len(every)), longest)
    return [every[number] for number in sorted(drawn)]


def _try(mutant: Mutant, trials: Trials, file: str, score: Score) -> None:
    names = trials.covering(file, mutant.lines) if mutant.function else list(trials.lines)
    if names and not trials.survives(lambda: put(mutant), names):
        return
    if mutant.name in REASONS:
        score.explained += 1
        return
    note = "" if names else " (no test executes it)"
    score.survivors.append(mutant.name + note)
    sys.stderr.write(f"survives: line {mutant.lines[0]} {mutant.name}{note}\n")


def source_of(module: str) -> Path:
    """Return the file of a module."""
    spec = importlib.util.find_spec(module)
    assert spec is not None
    assert spec.origin is not None
    return Path(spec.origin)


def main() -> int:
    """Try modules and print a table; 1 when one has less than nine in ten killed."""
    os.environ["CI"] = "1"  # hypothesis draws the same examples for each mutant
    longest = int(os.environ.get("MUTANTS", "1000000"))
    names = [PARTS.get(name, (f"adaptdrive.{name}",)) for name in sys.argv[1:]] or [TARGETS]
    chosen = [module for part in names for module in part]
    scores = []
    for module in chosen:
        scores.append(judge(module, TARGETS[module], longest))
        sys.stderr.write(f"{scores[-1].line}\n")
    lines = [HEAD, "|---|---|---|---|---|---|---|", *(score.line for score in scores)]
    if any(score.tried < score.total for score in scores):
        lines[:0] = [f"At most {longest} mutants of each module, drawn with seed {SEED}.", ""]
    left = [f"* `{name}`" for score in scores for name in score.survivors]
    sys.stdout.write("\n".join([*lines, "", *(["Survivors:", "", *left] if left else [])]) + "\n")
    return int(any(10 * len(s.survivors) > s.tried - s.explained for s in scores))


if __name__ == "__main__":
    raise SystemExit(main())
