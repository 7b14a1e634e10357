"""The numbered steps of the deployment page, as a shell carries them out."""

from __future__ import annotations

import re
import subprocess
from dataclasses import dataclass
from pathlib import Path

PAGE = Path(__file__).parents[4] / "docs" / "deployment.md"
_STEP = re.compile(
    r"^### (?P<number>\d+)\. (?P<title>.+?)$(?P<body>.*?)(?=^##)", re.MULTILINE | re.DOTALL
)
_BLOCK = re.compile(r"^```sh\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True, slots=True)
class Step:
    """One step: its number, its heading, and its commands."""

    number: int
    title: str
    commands: str


def read_steps(page: Path = PAGE) -> list[Step]:
    """The steps of the page, in order."""
    text = page.read_text(encoding="utf-8")
    return [
        Step(int(found["number"]), found["title"], "".join(_BLOCK.findall(found["body"])))
        for found in _STEP.finditer(text)
    ]


class Shell:
    """One shell for all steps: what a step sets, the next ones find."""

    def __init__(self, folder: Path) -> None:
        """Begin in a folder, which also takes what is kept between the steps."""
        self._folder = folder
        self._kept = folder / "environment"
        self._kept.touch()

    def run(self, commands: str) -> str:
        """Run commands up to the first that fails; what they printed.

        Raises:
            AssertionError: One failed.
        """
        script = (
            f". {self._kept}\nset -ea\ncd {self._folder}\n{commands}\nexport -p >{self._kept}\n"
        )
        done = subprocess.run(
            ["bash", "-c", script],
            check=False,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        assert done.returncode == 0, f"status {done.returncode}\n{commands}\n{done.stdout}"
        return done.stdout
