"""Which files does one sample pass? `python -m tools.walk [--files]`.

The daemon of the motor example runs in front of a simulated drive, in virtual time. Two walks are
traced through the running program: one tick from the frames of the drive to the command, and one
ordinary slow period. For each one the calls, the functions and the files of the product are
counted, and how often the walk returns to a file that it had left.
"""

from __future__ import annotations

import asyncio
import contextlib
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from adaptdrive.control.controller import Controller
from adaptdrive.control.signals import Mode
from adaptdrive.devices.can.connection import FrameReader
from adaptdrive.runtime.requests import SetMode, SetSetpoint
from tests.closed_loop.test_same_on_every_bus import COURSES, configured
from tests.closed_loop.wire import wired
from tests.virtual_time import virtual_time

SOURCE = str(Path(__file__).parents[2] / "src" / "adaptdrive") + "/"
SETTLED_S = 60.0


@dataclass
class Walk:
    """What one walk passed, in the order of the calls."""

    functions: list[tuple[str, str]] = field(default_factory=list)

    def note(self, frame: FrameType, event: str, _: object) -> None:
        """Take a call of a function of the product."""
        name = frame.f_code.co_filename
        if event == "call" and name.startswith(SOURCE) and not frame.f_code.co_name.startswith("<"):
            self.functions.append((name.removeprefix(SOURCE), frame.f_code.co_qualname))

    @property
    def files(self) -> list[str]:
        """The files in the order in which they are met first."""
        return list(dict.fromkeys(file for file, _ in self.functions))

    @property
    def returns(self) -> int:
        """How often a file is met again that had been left."""
        way = [file for file, _ in self.functions]
        entered = [file for before, file in zip(["", *way], way, strict=False) if file != before]
        return len(entered) - len(self.files)

    def line(self, name: str) -> str:
        """Return the row of the table."""
        counts = (len(self.functions), len(set(self.functions)), len(self.files), self.returns)
        return f"{name:12}" + "".join(f"{count:>11}" for count in counts)


@contextlib.contextmanager
def traced(owner: type, name: str, walks: list[Walk]) -> Iterator[None]:
    """Trace each call of a method into a walk of its own."""
    call: Callable[..., Any] = getattr(owner, name)

    def followed(*words: Any, **named: Any) -> Any:
        walk = Walk()
        walks.append(walk)
        sys.setprofile(walk.note)
        try:
            return call(*words, **named)
        finally:
            sys.setprofile(None)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(owner, name, followed)
        yield


async def follow(folder: Path) -> dict[str, Walk]:
    """Run the daemon until its adaptive controller holds a set-point, and return its walks."""
    configuration, path = configured("motor", folder)
    ticks: list[Walk] = []
    periods: list[Walk] = []
    with traced(FrameReader, "drain", ticks), traced(Controller, "decide", periods):
        async with wired(configuration, COURSES["motor"].settings, path) as wire:
            await wire.until_running()
            await wire.daemon.execute(SetSetpoint(3.0))
            await wire.daemon.execute(SetMode(Mode.ADAPTIVE))
            await asyncio.sleep(SETTLED_S)
    sent = [walk for walk in ticks[-100:] if "runtime/interlocks.py" in walk.files]
    return {"tick": _median(sent), "slow period": _median(periods[-20:])}


def _median(walks: list[Walk]) -> Walk:
    return sorted(walks, key=lambda walk: len(walk.functions))[len(walks) // 2]


def main() -> None:
    """Print the walks as a table, and their files where these are asked for."""
    with tempfile.TemporaryDirectory(prefix="walk-") as folder, virtual_time() as runner:
        walks = runner.run(follow(Path(folder)))
    heads = ("calls", "functions", "files", "returns")
    lines = [f"{'':12}" + "".join(f"{head:>11}" for head in heads)]
    lines += [walk.line(name) for name, walk in walks.items()]
    if "--files" in sys.argv:
        lines += ["\n  ".join([f"\n{name}:", *walk.files]) for name, walk in walks.items()]
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
