"""Putting the status messages of a drive together: the newest good value of each quantity."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from adaptdrive.hardware.dbc.mapping import CanMapping, CanSource, StatusFrame
from adaptdrive.hardware.fault_latch import FaultLatch
from adaptdrive.hardware.port import Reading, composed, confirming


class StatusAssembly:
    """The newest values of one drive, and the readings that are made of them.

    Attributes:
        faults: Faults since the last reading that was handed out.
        bridge_slack_s: Additional age of the report of the bridge, None for a drive that never
            reports it.
        bridge_cycle_s: Time from one report of the bridge to the next, 0 for a drive that never
            reports it, infinite where nothing says how often the message comes.
        stop_seen: Whether the drive has reported its bridge off after it had it on, and no reading
            has carried that yet.
    """

    def __init__(self, mapping: CanMapping) -> None:
        self._statuses = mapping.statuses
        self._bridge_on = mapping.bridge_on
        self._sources = [source for status in mapping.statuses for source in status.sources]
        bridge = next((one for one in self._sources if one.quantity == "bridge"), None)
        self.bridge_slack_s = None if bridge is None else bridge.slack_s
        self.bridge_cycle_s = 0.0
        if bridge is not None:
            self.bridge_cycle_s = bridge.cycle_s if bridge.cycle_stated else math.inf
        self._others = mapping.others
        self._faults = tuple(mapping.faults)
        self._values: dict[str, float] = {}
        self._dues: dict[str, tuple[float, float]] = {}
        self._last: Reading | None = None
        self._carried_on = self._come_on = False
        self.stop_seen = False
        self.faults = FaultLatch(mapping.faults)

    @property
    def powered(self) -> bool:
        """True if the drive's last report has its bridge on."""
        return self._values.get("bridge") == self._bridge_on

    def forget(self) -> None:
        """Discard every arrival: the bus was opened again, and counters may have advanced."""
        for status in self._statuses:
            status.codec.resume()
        for source in self._sources:
            self._dues[source.quantity] = -math.inf, 0.0

    def keep(
        self,
        status: StatusFrame,
        found: Mapping[str, float],
        arrival_s: float,
        *,
        alive: bool = True,
    ) -> None:
        """Keep the values of a good message, or the words of one whose measurements are refused.

        Args:
            status: The message.
            found: Values by signal.
            arrival_s: Arrival by the monotonic clock.
            alive: Whether its alive counter has advanced as it must: else no value becomes newer.
        """
        values, dues = self._values, self._dues
        for part in status.sources:
            value = found.get(part.signal)
            if value is not None:
                values[part.quantity] = value * part.scale + part.offset
                if alive:
                    dues[part.quantity] = arrival_s + part.slack_s, part.slack_s
        for fault in self._faults:
            self.faults.see(values.get(fault), fault)
        self._note_bridge(on=values.get("bridge") == self._bridge_on)

    def keep_words(
        self,
        status: StatusFrame,
        words: Mapping[str, float],
        arrival_s: float,
        *,
        alive: bool,
        stopped: bool,
    ) -> None:
        """Keep the words of a message whose other values are refused.

        One whose alive counter leapt or stands may be an old one. It shows that a drive which is
        driven may have stopped, and confirms no stop.

        Args:
            status: The message.
            words: Words by signal.
            arrival_s: Arrival by the monotonic clock.
            alive: Whether its alive counter has advanced as it must.
            stopped: Whether the safe command is in force.
        """
        if stopped and not alive:
            off = {one.signal for one in status.sources if one.quantity == "bridge"}
            words = {
                name: value
                for name, value in words.items()
                if name not in off or value == self._bridge_on
            }
        self.keep(status, words, arrival_s, alive=alive)

    def _note_bridge(self, *, on: bool) -> None:
        """Note a report of the bridge, of which there may be several between two readings.

        Before a reading has had it on, it may bounce: the newest report decides.
        """
        self._come_on = self._come_on or on
        if self._carried_on:
            self.stop_seen = self.stop_seen or not on
        else:
            self.stop_seen = self._come_on and not on

    def carry(self, reading: Reading) -> None:
        """Note a reading that is handed out; a stop seen after it was composed stays.

        Args:
            reading: The reading.
        """
        self.faults.clear(reading.fault)
        self.stop_seen = self.stop_seen and reading.bridge
        self._carried_on = reading.bridge and "bridge" in self._values
        self._come_on = self.powered

    def reading(self, arrival_s: float, *, bridge_sent: bool, stopped: bool) -> Reading | None:
        """Return the newest values and each fault since the last reading; None before all came.

        A drive that came on by command and stopped between two readings has one with its bridge on
        first.

        A drive at rest may confirm its stop although values are missing since the bus was opened
        again: it has the reading before with the bridge of now.

        Args:
            arrival_s: Arrival of the clocking message.
            bridge_sent: Bridge of the last command: a drive that does not report its bridge is
                assumed to follow.
            stopped: Whether the safe command is in force.
        """
        due_s, slack_s = min(self._dues.values())
        if due_s == -math.inf:
            return self._stop(arrival_s) if stopped else None
        self._last = self._whole(arrival_s, due_s - slack_s, slack_s, bridge_sent=bridge_sent)
        if self.stop_seen and not stopped:  # a drive that is driven has stopped meanwhile
            self._last = replace(self._last, bridge=bridge_sent and not self._carried_on)
        return self._last

    def _whole(
        self, arrival_s: float, oldest_s: float, slack_s: float, *, bridge_sent: bool
    ) -> Reading:
        bridge = self._values.get("bridge")
        return composed(
            self._values,
            self._others,
            self.faults,
            arrival_s=arrival_s,
            oldest_s=oldest_s,
            bridge=bridge_sent if bridge is None else bridge == self._bridge_on,
            slack_s=slack_s,
            bridge_s=self._heard_s("bridge"),
        )

    def _stop(self, arrival_s: float) -> Reading | None:
        """Return the last reading with the bridge and the fault of now."""
        last, bridge_s = self._last, self._heard_s("bridge")
        if last is None or bridge_s is None or bridge_s == -math.inf:
            return None
        counted = (self._heard_s("counter") or -math.inf) > -math.inf
        return confirming(
            last,
            self.faults,
            arrival_s=arrival_s,
            bridge=self.powered,
            bridge_s=bridge_s,
            counter=int(self._values["counter"]) if counted else None,
        )

    def oldest(self) -> tuple[StatusFrame, CanSource, float, float]:
        """Return the value that is out of date first: its message, its source, and its arrival.

        The last item is the arrival of the newest value; an arrival is -inf before the first.
        """
        arrivals = [
            (due_s - slack_s, status, source)
            for status in self._statuses
            for source in status.sources
            for due_s, slack_s in [self._dues.get(source.quantity, (-math.inf, 0.0))]
        ]
        oldest_s, status, source = min(arrivals, key=lambda one: one[0] + one[2].slack_s)
        return status, source, oldest_s, max(arrival_s for arrival_s, _, _ in arrivals)

    def _heard_s(self, quantity: str) -> float | None:
        """Arrival of a quantity's newest value, None where the drive does not give it."""
        due = self._dues.get(quantity)
        return None if due is None else due[0] - due[1]
