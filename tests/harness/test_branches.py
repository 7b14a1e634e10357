"""`tools.branches` names what tests leave out, in a module whose lines are counted by hand."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools.branches.__main__ import measure

SOURCE = """def sign(x):
    if x < 0:
        return -1
    if x:
        x = 1
    return x
"""


def measured(folder: Path, body: str) -> tuple[tuple[int, ...], tuple[tuple[int, int], ...]]:
    """Return the lines and branches that a test of `sign` leaves out."""
    (folder / "signs.py").write_text(SOURCE)
    (folder / "test_signs.py").write_text(
        f"from signs import sign\n\n\ndef test_sign():\n    {body}\n"
    )
    (one,) = measure([str(folder / "test_signs.py")], {"signs": str(folder / "signs.py")})
    assert (one.lines, one.branches) == (6, 4)
    return one.missed_lines, one.missed_branches


def test_what_a_test_leaves_out_is_named(tmp_path: Path) -> None:
    assert measured(tmp_path, "assert sign(2) == 1") == ((3,), ((2, 3), (4, 6)))


def test_nothing_is_named_where_every_way_is_taken(tmp_path: Path) -> None:
    every = "assert [sign(x) for x in (-2, 0, 2)] == [-1, 0, 1]"
    assert measured(tmp_path, every) == ((), ())


def test_tests_that_fail_measure_nothing(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="assert 1 == 2"):
        measured(tmp_path, "assert sign(2) == 2")
