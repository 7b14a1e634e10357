"""The folder of one demonstration: configuration, messages, logs and sessions."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from datetime import datetime
from importlib import resources
from pathlib import Path
from typing import Any

from adaptdrive_sim.broker import BrokerAddress
from adaptdrive_sim.demo.bus import BusChoice
from adaptdrive_sim.demo.settings import DemoError, DemoSettings
from adaptdrive_sim.demo.toml_text import toml_text

LEARN_AFTER_s = 10.0
WARM_UP_s = 40.0
STALE_s = 0.2
"""Time for which the daemon waits for the drive: a busy desktop may keep a process waiting
for longer than is right in service."""

TIMEOUT_s = 0.25
"""The drive's own time-out: longer than the daemon waits."""

_HEAD = "# Written by `adaptdrive-sim demo`. The commented original is in deploy/examples.\n\n"


@dataclass(frozen=True, slots=True)
class Workspace:
    """Folder with the files of a demonstration.

    Attributes:
        directory: The folder.
    """

    directory: Path

    @property
    def configuration(self) -> Path:
        """Configuration of daemon and simulated drive."""
        return self.directory / "motor.toml"

    @property
    def database(self) -> Path:
        """The CAN messages."""
        return self.directory / "adaptdrive.dbc"

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
        found = sorted(self.sessions.glob("*/session.json"))
        return found[-1].parent if found else None


def make_workspace(
    settings: DemoSettings, bus: BusChoice, broker: BrokerAddress, now: datetime
) -> Workspace:
    """Make the folder with the configuration in it.

    Args:
        settings: The demonstration.
        bus: Its bus.
        broker: Its broker.
        now: Present time, UTC; names the folder when none is asked for.

    Raises:
        DemoError: The folder cannot be made or written.
    """
    usual = Path("build") / "demo" / f"{now:%Y%m%dT%H%M%SZ}"
    workspace = Workspace((settings.directory or usual).absolute())
    examples = resources.files("adaptdrive_sim") / "examples"
    document = tomllib.loads((examples / "motor.toml").read_text(encoding="utf-8"))
    text = _HEAD + toml_text(_configured(document, workspace, bus, broker))
    try:
        workspace.directory.mkdir(parents=True, exist_ok=True)
        workspace.database.write_bytes((examples / "adaptdrive.dbc").read_bytes())
        workspace.configuration.write_text(text, encoding="utf-8")
    except OSError as problem:
        raise DemoError(f"{workspace.directory}: {problem.strerror or problem}") from problem
    return workspace


def _configured(
    document: dict[str, Any], workspace: Workspace, bus: BusChoice, broker: BrokerAddress
) -> dict[str, Any]:
    """The packaged configuration with this demonstration's bus, broker, folders and patience."""
    changes: dict[str, dict[str, Any]] = {
        "bus": {
            **bus.section,
            "database": workspace.database.name,
            "command_timeout_s": TIMEOUT_s,
        },
        "mqtt": {"host": broker.host, "port": broker.port},
        "recording": {"directory": str(workspace.sessions)},
        # No torque but friction brakes the shaft. A constant that need not be learned leaves the
        # estimator free to follow disks that come every half minute.
        "estimator": {"settle_s": LEARN_AFTER_s, "bias": False},
        "interlocks": {"stale_s": STALE_s},
        "supervisor": {"warm_up_s": WARM_UP_s},
    }
    return document | {
        name: {**document.get(name, {}), **section} for name, section in changes.items()
    }
