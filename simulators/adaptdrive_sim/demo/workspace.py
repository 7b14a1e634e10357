"""The folder of one demonstration: configuration, messages, logs and sessions."""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import tomlkit

from adaptdrive_sim.demo.settings import DemoError
from adaptdrive_sim.experiments.examples import FOLDER

_HEAD = "# Written by `adaptdrive-sim demo`. The commented original is in deploy/examples.\n\n"


@dataclass(frozen=True, slots=True)
class Workspace:
    """Folder with the files of a demonstration.

    Attributes:
        directory: The folder.
        name: Name of the configuration.
    """

    directory: Path
    name: str

    @property
    def configuration(self) -> Path:
        """Configuration of daemon and simulated drive."""
        return self.directory / self.name

    @property
    def sessions(self) -> Path:
        """Folder of the daemon's sessions."""
        return self.directory / "sessions"

    @property
    def state(self) -> Path:
        """Folder of the daemon's state."""
        return self.directory / "state"

    def log(self, name: str) -> Path:
        """Log of a process."""
        return self.directory / f"{name}.log"

    def session(self) -> Path | None:
        """The recorded session; None when there is none."""
        found = (path.parent for path in self.sessions.glob("2*/session.json"))
        return max(found, default=None)

    def write(self, document: dict[str, Any]) -> None:
        """Write the configuration and the messages that it names.

        Raises:
            DemoError: The folder cannot be written.
        """
        database = document["bus"]["database"]
        try:
            (self.directory / database).write_bytes((FOLDER / database).read_bytes())
            self.configuration.write_text(_HEAD + tomlkit.dumps(document), encoding="utf-8")
        except OSError as problem:
            raise DemoError(f"{self.directory}: {problem.strerror or problem}") from problem


def make_workspace(directory: Path | None, name: str) -> Workspace:
    """Make the folder of a demonstration.

    Args:
        directory: The folder; one that no other demonstration has, when None.
        name: Name of the configuration.

    Raises:
        DemoError: It cannot be made.
    """
    try:
        if directory is None:
            parent = Path("build", "demo").absolute()
            parent.mkdir(parents=True, exist_ok=True)
            now = datetime.now(UTC)
            directory = Path(tempfile.mkdtemp(prefix=f"{now:%Y%m%dT%H%M%SZ}-", dir=parent))
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise DemoError(f"{problem.filename}: {problem.strerror}") from problem
    return Workspace(directory.absolute(), name)


def program(name: str = "adaptdrive") -> str:
    """Return the command for a program: its name, or its path if the name is not found."""
    if shutil.which(name):
        return name
    path = Path(sys.executable).with_name(name)
    return os.path.relpath(path) if path.is_relative_to(Path.cwd()) else str(path)
