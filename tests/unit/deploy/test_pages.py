"""The pages of the manual keep their form."""

import re
from pathlib import Path

import pytest
from cyclopts import CycloptsError, MissingArgumentError

from adaptdrive.cli.options import build_app
from adaptdrive_sim.cli import app as simulator

ROOT = Path(__file__).parents[3]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("tests/*.md")])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_row_of_a_table_belongs_to_a_header(page: Path) -> None:
    """A blank line within a table would show the rest of it as plain text."""
    lines = page.read_text().splitlines()
    for number, (before, row, after) in enumerate(
        zip(lines, lines[1:], lines[2:], strict=False), start=2
    ):
        if row.startswith("|") and not before.startswith("|"):
            assert re.fullmatch(r"\|[\s:|-]+", after), f"{page.name}:{number}: {row}"


SHELL = re.compile(r"```(?:sh|console)\n(.*?)```", re.DOTALL)
INLINE = re.compile(r"`(adaptdrive(?:-sim)? [^`]+)`")
STARTED = re.compile(r"(?:^|[\s/])(adaptdrive(?:-sim)? [^-].*)")
BEGINS = ("adaptdrive", "$ adaptdrive", "sudo ", "runuser ", ".venv/bin/adaptdrive")
STAND_IN = {
    "DESIGN": "paper",
    "KEY=VALUE": "load.pole=0.8",
    "KIND": "1",
    "LOAD": "motor",
    "RATE,0.1": "1,0.1",
}
"""What a reader may write for a word in capitals that stands for no number and no name."""


def commands(page: Path) -> set[str]:
    """The commands of both programs in the text of a page and in its blocks of a shell."""
    text = page.read_text(encoding="utf-8")
    found = set(INLINE.findall(SHELL.sub("", text).replace("\n", " ")))
    for line in "".join(SHELL.findall(text)).replace("\\\n", " ").splitlines():
        for part in re.split(r"&&|\|\||;|\s#", line):
            started = STARTED.search(part) if part.strip().startswith(BEGINS) else None
            found |= {started[1]} if started else set()
    return found


def words_of(command: str) -> list[str]:
    """The command as a reader types it: choices taken, options given, capitals replaced."""
    plain = re.sub(r"[\[\]…]|\s#.*", " ", command.replace("\\|", "|"))
    given = [STAND_IN.get(word, word.split("|")[0]) for word in plain.split()]
    return ["1" if re.fullmatch(r"[A-Z]+0?", word) else word for word in given]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_command_of_a_page_is_understood(page: Path) -> None:
    """One that is named without any argument need not be complete."""
    apps = {"adaptdrive": build_app(), "adaptdrive-sim": simulator}
    for command in sorted(commands(page)):
        program, *words = words_of(command)
        named = not any(word.startswith("--") for word in words)
        try:
            apps[program].parse_args(words, exit_on_error=False, print_error=False)
        except CycloptsError as problem:
            if not (named and isinstance(problem, MissingArgumentError)):
                pytest.fail(f"{command}: {problem}")
