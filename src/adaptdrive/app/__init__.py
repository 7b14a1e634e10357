"""Where everything is put together: one drive, from its configuration to its running tasks."""

from adaptdrive.app.probe import probe
from adaptdrive.app.replay import replay
from adaptdrive.app.run import run

__all__ = ["probe", "replay", "run"]
