"""What `adaptdrive check` says of examples with other values; the lines are in `checks-….txt`.

Contradictions, values that cannot all be true and those that are probably not meant are named with
their place and figures. `tests/golden.py` says how the lines are renewed.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from adaptdrive.cli import main
from tests.golden import hold

DEPLOY = Path(__file__).parents[3] / "deploy"
SOURCES = ("examples", "devices")


@pytest.mark.parametrize("lines", ["checks-dbc.txt", "checks-others.txt"])
def test_check_says_what_is_wrong_and_what_is_doubtful(
    lines: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sources = {one.name: one for name in SOURCES for one in (DEPLOY / name).iterdir()}
    for source in sources.values():
        shutil.copy(source, tmp_path)

    def answered(subject: str, asked: list[str]) -> Iterator[str]:
        """Yield what `check` says of a file.

        Args:
            subject: Its name.
            asked: `text -> other text`, or `FILE: text -> other text` for a description.
        """
        changed = [tmp_path / subject]
        for question in asked:
            line = question.encode("latin-1", "backslashreplace").decode("unicode_escape")
            old, new = line.split(" -> ")
            named, _, rest = old.partition(": ")
            if named in sources:
                changed.append(tmp_path / named)
                old = rest
            text = changed[-1].read_text(encoding="utf-8")
            assert old in text, question
            changed[-1].write_text(text.replace(old, new), encoding="utf-8")
        status = main(["check", str(tmp_path / subject)])
        for file in changed:
            shutil.copy(sources[file.name], tmp_path)
        for line in capsys.readouterr().err.splitlines():
            if "not on this machine" not in line:
                yield line.split(f"{subject}: ", 1)[1].replace(f"{tmp_path}/", "")
        yield f"exit {status}"

    hold(Path(__file__).with_name(lines), answered)
