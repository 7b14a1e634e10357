"""What goes over the bus, as python-can hears it and cantools reads it."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import can
import cantools
from cantools.database.can.database import Database

from adaptdrive.config import load_configuration
from adaptdrive.config.bus import CanBus
from adaptdrive.hardware.link.bus import open_bus
from tests.scenes.system.site import EXAMPLES


@dataclass(frozen=True)
class Commanded:
    """One command frame."""

    time_s: float
    current_scale_S: float
    bridge: bool

    @property
    def safe(self) -> bool:
        return self.current_scale_S == 0.0 and not self.bridge


class BusEar:
    """Listens to the bus of a site while it is open."""

    def __init__(self, config: Path) -> None:
        bus = load_configuration(config).bus
        assert isinstance(bus, CanBus)
        self._bus = open_bus(bus)
        self._frames: list[tuple[float, can.Message]] = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._listen)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        problem: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._ended.set()
        self._thread.join()
        self._bus.shutdown()

    def _listen(self) -> None:
        while not self._ended.is_set():
            frame = self._bus.recv(0.05)
            if frame is not None:
                self._frames.append((time.monotonic(), frame))

    def commands(self) -> list[Commanded]:
        """All commands so far."""
        database = cantools.database.load_file(EXAMPLES / "adaptdrive.dbc")
        assert isinstance(database, Database)
        message = database.get_message_by_name("DriveCommand")
        found = []
        for time_s, frame in list(self._frames):
            if frame.arbitration_id == message.frame_id:
                values = message.decode(bytes(frame.data), decode_choices=False)
                assert isinstance(values, dict)
                scale = float(values["CurrentScale"])  # type: ignore[arg-type]
                found.append(Commanded(time_s, scale, values["BridgeEnable"] == 1))
        return found
