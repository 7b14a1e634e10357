"""`adaptdrive-sim demo`: a story of a simulated drive and its controller, and a view of it."""

import math
from dataclasses import dataclass
from typing import Annotated

from cyclopts import Parameter

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
        speed: Times real time; the story's own when left out.
    """

    duration_s: Annotated[float | None, Parameter(name="--duration")] = None
    headless: Annotated[bool, Parameter(negative=())] = False
    speed: float | None = None

    def check(self) -> None:
        """Refuse what cannot be done.

        Raises:
            RefusedError: Which option, and why.
        """
        if self.duration_s is not None and not 1.0 <= self.duration_s < math.inf:
            raise RefusedError(f"--duration {self.duration_s:g} must be at least 1 second")
        if self.speed is not None and not 0.0 < self.speed <= SPEED_MAX:
            raise RefusedError(f"--speed {self.speed:g} must lie above 0, and up to 1e6")
