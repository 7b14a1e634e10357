"""The page of the proof, and the table of faults in `docs/proof/reliability.md`, from kept results.

`python -m tools.proof.page docs/proof/proof.md docs/proof/reliability.md` writes both.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from tests.integration.faults.rows import GROUPS
from tools.pages.marked import with_part
from tools.proof.forms import Form, forms
from tools.proof.results import RESULTS, Result, load
from tools.proof.summaries import counted, fault_matrix, life, table, tried, without_still

MARKS = "<!-- faults: written by `make docs` -->\n", "<!-- end of faults -->\n"
INTRODUCTION = """# Proof

Results of the long tests, for readers who check a claim. `make proof` runs the *forms* that have no
result of the present commit; `python -m tools.proof docs/proof/proof.md FORM` repeats one.
`tools/proof/results` holds the whole output of each run. The faults in virtual time are in
[reliability](reliability.md#faults-in-virtual-time).
"""
MUTANTS_TEXT = """## Small changes of the code

`python -m tools.mutation NAME` changes one comparison, constant, operator or statement at a time;
the tests of the module must notice it. An *explained* change has no effect, for a stated reason.
"""
BRANCHES_TEXT = """## Lines and branches

`python -m tools.branches NAME` counts what the tests of each module run and take.
"""
MUTANTS = ("name", "changes", "tried", "noticed", "explained", "survived", "run")
BRANCHES = ("name", "lines", "not run", "branches", "not taken", "run")

BRIEF: dict[str, Callable[[str], str]] = {
    "inputs": tried,
    "soak-virtual": life,
    "soak-real": without_still,
}
"""How the page shortens the output of a form."""

COMMON = re.compile(r"python -m (pytest -q )?| --(timeout|numprocesses|dist) \w+")
"""What the page leaves out of a command: how any module or test is run."""

Run = tuple[Form, Result | None]


def page(folder: Path = RESULTS) -> str:
    """Return the page as Markdown."""
    ran = [(form, load(form.name, folder)) for form in forms()]
    single = [run for run in ran if not run[0].name.startswith(("mutants-", "branches-"))]
    runs = table(("form", "module or tests", "run"), (_row(run) for run in single))
    outputs = [_section(*run) for run in single if run[0].is_shown]
    mutants = table(MUTANTS, _counts(ran, "mutants", 5))
    branches = table(BRANCHES, _counts(ran, "branches", 4))
    tables = [f"{MUTANTS_TEXT}\n{mutants}\n", f"{BRANCHES_TEXT}\n{branches}\n"]
    return "\n".join([INTRODUCTION, f"## Runs\n\n{runs}\n", *outputs, *tables])


def _verdict(result: Result | None) -> str:
    if result is None:
        return "has not run"
    verdict = "passed" if result.status == 0 else f"FAILED with status {result.status}"
    return f"{verdict} {result.day[:10]}, {result.commit}"


def _row(run: Run) -> str:
    form, result = run
    command = form.shown_command if result is None else result.command
    return f"| {form.name} | `{COMMON.sub('', command)}` | {_verdict(result)} |"


def _section(form: Form, result: Result | None) -> str:
    text = "" if result is None else BRIEF.get(form.name, str)(result.text)
    body = text if form.as_table or form.name in BRIEF else f"```\n{text}\n```"
    return f"## {form.title}\n\n{body}\n"


def _counts(ran: Sequence[Run], kind: str, columns: int) -> Iterator[str]:
    """Yield a row of sums for each form of a kind, then a line with those that have not run."""
    missing = []
    for form, result in ran:
        if form.name.startswith(f"{kind}-"):
            name = form.title.rpartition(": ")[2].removeprefix("adaptdrive.")
            if result is None:
                missing.append(name)
            else:
                yield f"{counted(name, result.text, columns)} {_verdict(result)} |"
    if missing:
        yield f"\nNot run: {', '.join(missing)}."


def with_faults(text: str, folder: Path = RESULTS) -> str:
    """Return a page with the measured table of faults between its marks.

    Args:
        text: The page.
        folder: Where results are kept.
    """
    return with_part(text, MARKS, _faults(folder))


def _faults(folder: Path) -> str:
    """The tables of all groups as one."""
    found = [load(group, folder) for group in GROUPS]
    results = [result for result in found if result is not None]
    return f"{fault_matrix(one.text for one in results)}\n" if results else "Not measured yet.\n"


def write(proof: Path, reliability: Path) -> None:
    """Write both pages, the second one where it is there."""
    proof.write_text(page(), encoding="utf-8")
    if reliability.exists():
        text = with_faults(reliability.read_text(encoding="utf-8"))
        reliability.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    write(Path(sys.argv[1]), Path(sys.argv[2]))
