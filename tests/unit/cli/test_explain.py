"""`adaptdrive explain`: what a kind of trip means."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from adaptdrive.safety.trips import ADVICES, TripKind, remedy
from tests.unit.cli.here import run_here


def test_a_kind_is_explained_with_its_cause_its_remedy_and_its_page() -> None:
    answer = run_here("explain", "over-voltage")
    assert (answer.returncode, answer.stderr) == (0, "")
    assert answer.stdout.splitlines() == [
        "kind     over-voltage",
        "cause    boost voltage above boost_voltage_max_V",
        "example  over-voltage: v_bst = 431.2 V, limit 430 V",
        f"remedy   {remedy(TripKind.OVER_VOLTAGE)}",
        "page     docs/operation.md#trips-and-what-to-do",
    ]


@pytest.mark.parametrize("kind", TripKind)
def test_each_kind_is_explained_to_programs(kind: TripKind) -> None:
    printed = json.loads(run_here("explain", kind.value, "--json").stdout)
    assert printed["kind"] == kind.value
    assert printed["page"] == ADVICES[kind].page
    assert all(printed.values())


def test_all_kinds_are_listed_in_a_line_each() -> None:
    lines = run_here("explain").stdout.splitlines()
    assert [line.split()[0] for line in lines] == [kind.value for kind in ADVICES]
    cause = ADVICES[TripKind.SLOW_LOOP].cause
    assert next(line for line in lines if line.startswith("slow-loop ")).endswith(f"  {cause}")
    listed = json.loads(run_here("explain", "--json").stdout)
    assert {one["kind"] for one in listed} == {kind.value for kind in TripKind}


@pytest.mark.parametrize(
    ("word", "hint"),
    [
        ("over-voltag", "no trip is of this kind (did you mean 'over-voltage'?)"),
        ("qqq", "no trip is of this kind; `adaptdrive explain` lists all"),
    ],
)
def test_an_unknown_kind_is_one_clear_error(word: str, hint: str) -> None:
    answer = run_here("explain", word)
    assert (answer.returncode, answer.stdout) == (2, "")
    assert answer.stderr == f"adaptdrive: explain: {word}: {hint}\n"


@pytest.mark.usefixtures("outside")
def test_it_needs_no_large_library() -> None:
    program = (
        "import sys; from adaptdrive.cli import main; status = main(['explain', 'stale']);"
        "loaded = {'pydantic', 'pyarrow', 'aiomqtt', 'numpy'} & sys.modules.keys();"
        "sys.exit(status or ' '.join(sorted(loaded)) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
