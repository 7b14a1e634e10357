"""Topics of a drive at the broker."""

from __future__ import annotations

from dataclasses import dataclass

from adaptdrive.operation.commands import STOP

ROOT = "adaptdrive"


@dataclass(frozen=True, slots=True)
class Topics:
    """The topics of one drive.

    Attributes:
        drive: Name of the drive, as in its configuration.
    """

    drive: str

    @property
    def availability(self) -> str:
        """`online` or `offline`, retained; also the last will."""
        return self._below("availability")

    @property
    def state(self) -> str:
        """The state as operators see it, retained."""
        return self._below("state")

    @property
    def load_telemetry(self) -> str:
        """One message per slow period, the last one retained."""
        return self._below("telemetry/load")

    @property
    def drive_telemetry(self) -> str:
        """The fast loop, at most ten messages a second."""
        return self._below("telemetry/drive")

    @property
    def histograms(self) -> str:
        """Counts of all times of ticks since the start, retained."""
        return self._below("telemetry/histograms")

    @property
    def ask_history(self) -> str:
        """Request for the slow steps of the last hour; its payload has no meaning."""
        return self._below("ask/history")

    @property
    def history(self) -> str:
        """Answers to such requests, for every client."""
        return self._below("history")

    @property
    def event(self) -> str:
        """Trips, mode changes, fallbacks, bus loss and return."""
        return self._below("event")

    @property
    def reply(self) -> str:
        """Answers to commands."""
        return self._below("reply")

    @property
    def commands(self) -> str:
        """Filter that catches every command, those with an unknown verb too."""
        return self._below("command/#")

    @property
    def probe(self) -> str:
        """Topic among the commands that the daemon itself publishes on, and hears."""
        return self.command("probe")

    def command(self, verb: str) -> str:
        """The topic on which a verb is asked for."""
        return self._below(f"command/{verb}")

    @property
    def stop(self) -> str:
        """The topic of the command that stops the drive."""
        return self.command(STOP)

    def verb(self, topic: str) -> str:
        """The verb that a command topic names, known or not."""
        return topic.removeprefix(self._below("command")).removeprefix("/")

    def name(self, topic: str) -> str:
        """Return a topic of the drive without the drive."""
        return topic.removeprefix(self._below(""))

    def _below(self, name: str) -> str:
        return f"{ROOT}/{self.drive}/{name}"
