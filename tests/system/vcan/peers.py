"""can-utils and `ip`, as tests call them."""

from __future__ import annotations

import contextlib
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from tests.support import Process, Spawn
from tests.system.daemon.site import until

_PATIENCE_S = 120.0
_LISTENERS = Path("/proc/net/can/rcvlist_all")


class Link(Protocol):
    """Does to the interface of a test what `ip link VERB INTERFACE WORDS` does."""

    def __call__(self, verb: str, *words: str) -> None: ...


@dataclass(frozen=True, slots=True)
class CanUtils:
    """The programs of can-utils on one interface.

    Frames are written as they do: `101#DEADBEEF`.
    """

    channel: str
    spawn: Spawn

    @property
    def carried(self) -> int:
        """Frames that the interface has carried."""
        return int(Path("/sys/class/net", self.channel, "statistics/rx_packets").read_text())

    def send(self, frame: str) -> None:
        """Have cansend send one frame."""
        subprocess.run(["cansend", self.channel, frame], check=True, timeout=_PATIENCE_S)

    def generate(self, *options: str) -> Process:
        """Have cangen send frames as fast as it can."""
        return self.spawn("cangen", self.channel, "-g", "0", "-i", *options)

    @contextlib.contextmanager
    def dump(self, count: int) -> Iterator[list[str]]:
        """The frames that candump hears; they are there when the block has ended."""
        command = ["candump", "-L", "-n", str(count), self.channel]
        heard: list[str] = []
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as candump:
            try:
                until(lambda: self.channel in _LISTENERS.read_text().split(), "candump listens")
                yield heard
                output, _ = candump.communicate(timeout=_PATIENCE_S)
            finally:
                candump.kill()
        heard.extend(line.split()[2] for line in output.splitlines())
