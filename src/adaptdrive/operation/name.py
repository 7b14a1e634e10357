"""The name of the daemon at the broker, and what happens when another client uses it too.

A broker lets one client have a name: it closes the first one's connection when a second one comes.
Two daemons of one drive would take turns without end, and a `disable` would reach one of them. So
the one that loses the name gives way: it connects under another name, where operators reach
both, and reports it. It trips as soon as it is certain of the other daemon.
"""

from __future__ import annotations

import uuid
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from adaptdrive.operation.clock import Monotonic
from adaptdrive.operation.steady import SteadyClient

CLOSINGS = 3
CLOSINGS_WITHIN_S = 120.0
"""Two clients that take turns wait up to 30 s each; brokers are seldom restarted that often."""


@dataclass
class ClientName:
    """The client name of one drive's daemon.

    Attributes:
        own: The drive's own name.
        monotonic: Clock for intervals, in seconds.
        alarm: Reports another client of this name.
        trip: Trips the drive, where the other client is beyond doubt.
        present: The name to connect under.
    """

    own: str
    monotonic: Monotonic
    alarm: Callable[[str], None]
    trip: Callable[[str], None]

    def __post_init__(self) -> None:
        self.present = self.own
        self._certain = False
        self._closings_s: deque[float] = deque(maxlen=CLOSINGS)

    @property
    def given_way(self) -> bool:
        """True if another client has the drive's own name."""
        return self.present != self.own

    def connection_ended(self, client: SteadyClient) -> None:
        """Look whether a connection ended because another client took the name."""
        if self.given_way:
            return
        if client.taken_over:
            self._give_way("the broker gave its connection to another client", certain=True)
        elif client.closed_by_broker:
            self._count_closing()

    def heard_rival(self) -> None:
        """Another client publishes as this drive."""
        if not self._certain:
            self._meet(f"another client publishes as {self.own}", certain=True)

    def reclaim(self, client: SteadyClient) -> None:
        """Take the drive's own name again: a daemon that has it loses it, and trips."""
        if self.given_way:
            self.present, self._certain = self.own, False
            client.hang_up("connects under its own client name again")

    def _count_closing(self) -> None:
        # Not every broker gives a reason; then a name that is lost again and again is the sign.
        now_s = self.monotonic()
        self._closings_s.append(now_s)
        lasted_s = now_s - self._closings_s[0]
        if len(self._closings_s) == CLOSINGS and lasted_s < CLOSINGS_WITHIN_S:
            self._closings_s.clear()
            closed = f"the broker closed its connection {CLOSINGS} times in {lasted_s:.0f} s"
            self._give_way(closed, certain=False)

    def _give_way(self, detail: str, *, certain: bool) -> None:
        self.present = f"{self.own}-{uuid.uuid4().hex[:8]}"
        self._meet(f"client name {self.own}: {detail}", certain=certain)

    def _meet(self, detail: str, *, certain: bool) -> None:
        """Report the other client, and trip where it is certain."""
        self._certain = certain
        cause = (
            f"second broker client: {detail}; likeliest a second daemon for this drive on another "
            "machine: end it"
        )
        self.alarm(cause)
        if certain:
            self.trip(cause)
