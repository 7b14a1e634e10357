"""The long forms of the tests: `python -m tools.proof PAGE [FORM ...]` runs them, writes a page.

The table of faults of a `reliability.md` beside the page is written too. Without names it runs each
form that has not passed at this commit, so that a run that was broken off is continued. A form that
fails is on the page too, and makes the run fail.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from tools.proof.forms import Form, forms
from tools.proof.page import write
from tools.proof.results import commit, load, run, save


def main() -> int:
    """Run forms; 1 when one of them failed."""
    parser = argparse.ArgumentParser(prog="python -m tools.proof")
    parser.add_argument("page", type=Path)
    known = {form.name: form for form in forms()}
    parser.add_argument("form", nargs="*", metavar="FORM")
    options = parser.parse_args()
    unknown = [name for name in options.form if name not in known]
    if unknown:
        parser.error(f"no form is called {unknown[0]!r}; there are: {', '.join(known)}")
    chosen = [known[name] for name in options.form] or [f for f in forms() if not _has_passed(f)]
    failed = 0
    for form in chosen:
        sys.stderr.write(f"{form.name}: {form.shown_command}\n")
        result = run(form)
        save(result)
        write(options.page, options.page.with_name("reliability.md"))
        failed |= result.status != 0
    return failed


def _has_passed(form: Form) -> bool:
    result = load(form.name)
    same = result is not None and (result.commit, result.command) == (commit(), form.shown_command)
    return same and result is not None and result.status == 0


if __name__ == "__main__":
    raise SystemExit(main())
