"""The page of the proof, and the table of faults in `docs/proof/reliability.md`, from kept results.

`python -m tests.proof.page docs/proof/proof.md docs/proof/reliability.md` writes both.
"""

from __future__ import annotations

import sys
from pathlib import Path

from tests.faults.rows import GROUPS
from tests.proof.forms import Form, forms
from tests.proof.results import RESULTS, Result, load

BEGIN, END = "<!-- faults: written by `make docs` -->\n", "<!-- end of faults -->\n"
INTRODUCTION = """# Proof

Results of the long tests, for anyone who wants to check a claim. A *form* is one such test with its
length. `make proof` runs the forms that have no result of the present commit;
`python -m tests.proof docs/proof/proof.md FORM` runs one again. The results are in
`tests/proof/results`, and this page is made from them. SEEDS, STORIES, INPUTS, KILLS, DAYS and
MINUTES set the length of a form, MUTANTS the largest number of changes tried in a module. Each
section begins with the command that ran.
[Promises](promises.md) names the tests of each promise,
[tests/README.md](../../tests/README.md#faults-and-proof) describes the forms.
"""


def page(folder: Path = RESULTS) -> str:
    """Return the page as Markdown."""
    return "\n".join([INTRODUCTION, *(_section(form, load(form.name, folder)) for form in forms())])


def _section(form: Form, result: Result | None) -> str:
    head = f"## {form.title}\n\n"
    if result is None:
        return f"{head}`{form.name}` has not run.\n"
    verdict = "passed" if result.status == 0 else f"FAILED with status {result.status}"
    took = "" if result.processor_min is None else f"{result.processor_min} min of processor time, "
    facts = (
        f"`{result.command}`: {verdict}; {result.day} UTC, commit {result.commit}, "
        f"{took}{result.machine}."
    )
    body = result.text if form.as_table else f"```\n{result.text}\n```"
    return f"{head}{facts}\n\n{body}\n"


def with_faults(text: str, folder: Path = RESULTS) -> str:
    """Return a page with the measured table of faults between its marks.

    Args:
        text: The page.
        folder: Where results are kept.
    """
    before, rest = text.split(BEGIN)
    _, after = rest.split(END)
    return before + BEGIN + _faults(folder) + END + after


def _faults(folder: Path) -> str:
    """The tables of all groups as one, after what was run."""
    found = [load(group, folder) for group in GROUPS]
    results = [result for result in found if result is not None]
    facts = "; ".join(f"`{one.command}`, {one.day[:10]}, commit {one.commit}" for one in results)
    if not results:
        return "Not measured yet.\n"
    tables = [one.text.splitlines() for one in results]
    body = [line for table in tables for line in table[2:]]
    return "\n".join([f"Measured with {facts}.", "", *tables[0][:2], *body, ""])


def write(proof: Path, reliability: Path) -> None:
    """Write both pages, the second one where it is there."""
    proof.write_text(page(), encoding="utf-8")
    if reliability.exists():
        text = with_faults(reliability.read_text(encoding="utf-8"))
        reliability.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    write(Path(sys.argv[1]), Path(sys.argv[2]))
