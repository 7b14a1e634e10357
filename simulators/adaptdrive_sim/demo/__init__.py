"""`adaptdrive-sim demo`: broker, simulated drive and daemon as processes, and a view of them."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from adaptdrive.cli.options import Integer
from adaptdrive.util.errors import AdaptdriveError, RefusedError

SPEED_MAX = 1e6
"""Times real time: more than any machine reaches."""


class DemoError(AdaptdriveError):
    """The demonstration cannot continue; the message gives the reason."""


@Parameter(name="*")
@dataclass(frozen=True, slots=True)
class DemoSettings:
    """The options of `adaptdrive-sim demo`.

    Attributes:
        duration_s: Seconds of the story; the whole story when left out. The last scene of a story
            lasts until then.
        headless: Show nothing; print one line of JSON at the end.
        noise: Standard deviation of each sample of the output, in its unit; the story's own when
            left out.
        seed: Seed of the noise.
        directory: Folder for configuration, logs and sessions; a new one in build/demo when left
            out.
        speed: Times real time, for a story in virtual time.
    """

    duration_s: Annotated[float | None, Parameter(name="--duration")] = None
    headless: Annotated[bool, Parameter(negative=())] = False
    noise: float | None = None
    seed: Integer = 0
    directory: Path | None = None
    speed: float | None = None

    def check(self, *, virtual: bool) -> None:
        """Refuse what cannot be done.

        Args:
            virtual: Whether the story passes in virtual time.

        Raises:
            RefusedError: Which option, and why.
        """
        if self.duration_s is not None and not 1.0 <= self.duration_s < math.inf:
            raise RefusedError(f"--duration {self.duration_s:g} must be at least 1 second")
        if self.speed is not None and not 0.0 < self.speed <= SPEED_MAX:
            raise RefusedError(f"--speed {self.speed:g} must lie above 0, and up to 1e6")
        if self.noise is not None and not 0.0 <= self.noise <= 1.0:
            raise RefusedError(f"--noise {self.noise:g} must lie in 0…1")
        unused = "directory" if virtual else "speed"
        if getattr(self, unused) is not None:
            time = "virtual time, without processes" if virtual else "real time"
            raise RefusedError(f"--{unused}: this story passes in {time}")
