"""Topics of a drive at the broker."""

from __future__ import annotations

from adaptdrive.operation.commands import STOP

ROOT = "adaptdrive"


class Topics:
    """The topics of one drive.

    Attributes:
        availability: `online` or `offline`, retained; also the last will.
        state: The state as operators see it, retained.
        load_telemetry: One message per slow period, the last one retained.
        drive_telemetry: The fast loop, at most ten messages a second.
        histograms: Counts of all times of ticks since the start, retained.
        ask_history: Request for the slow steps of the last hour; its payload has no meaning.
        history: Answers to such requests, for every client.
        event: Trips, mode changes, fallbacks, bus loss and return.
        reply: Answers to commands.
        commands: Filter that catches every command, those with an unknown verb too.
        probe: Topic among the commands that the daemon itself publishes on, and hears.
        stop: The topic of the command that stops the drive.
    """

    def __init__(self, drive: str) -> None:
        """Name the topics of a drive by its name, as in its configuration."""
        self._root = f"{ROOT}/{drive}/"
        self.availability = f"{self._root}availability"
        self.state = f"{self._root}state"
        self.load_telemetry = f"{self._root}telemetry/load"
        self.drive_telemetry = f"{self._root}telemetry/drive"
        self.histograms = f"{self._root}telemetry/histograms"
        self.ask_history = f"{self._root}ask/history"
        self.history = f"{self._root}history"
        self.event = f"{self._root}event"
        self.reply = f"{self._root}reply"
        self.commands = self.command("#")
        self.probe = self.command("probe")
        self.stop = self.command(STOP)

    def command(self, verb: str) -> str:
        """The topic on which a verb is asked for."""
        return f"{self._root}command/{verb}"

    def verb(self, topic: str) -> str:
        """The verb that a command topic names, known or not."""
        return topic.removeprefix(self.command("")[:-1]).removeprefix("/")

    def name(self, topic: str) -> str:
        """Return a topic of the drive without the drive."""
        return topic.removeprefix(self._root)
