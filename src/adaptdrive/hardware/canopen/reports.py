"""The drive's status PDOs as readings: the set after one SYNC, and the newest of several sets.

The values of a set were measured at the same moment. A PDO that comes again before the others have
ends the set, and one without a SYNC since the last reading begins none: repeated PDOs make no
readings of their own.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from adaptdrive.hardware.binding import other_names
from adaptdrive.hardware.canopen.dictionary import label
from adaptdrive.hardware.canopen.mapping import CanOpenMapping, StatusPdo
from adaptdrive.hardware.canopen.profile import POWERED, STATUSWORD, DriveControl, UnseenStop
from adaptdrive.hardware.fault_latch import FaultLatch
from adaptdrive.hardware.link.integrity import FrameVerdict
from adaptdrive.hardware.port import Reading, composed, confirming

_STATUSWORD = label(STATUSWORD)


class Reports:
    """Collects status PDOs, and keeps the newest reading until it is handed out.

    Attributes:
        faults: Faults that no reading has carried yet.
    """

    def __init__(
        self,
        mapping: CanOpenMapping,
        control: DriveControl,
        unseen: UnseenStop,
        counts: Counter[str],
    ) -> None:
        """Expect PDOs; none has come yet.

        Args:
            mapping: PDOs of a reading, and fault words of the drive.
            control: Follows the statusword.
            unseen: Watches the time between two statuswords.
            counts: Counts of the port, to which refused PDOs are added.
        """
        self.faults = FaultLatch(mapping.faults)
        self._words = mapping.faults
        self._statuses = {status.codec.name: status for status in mapping.statuses}
        self._others = other_names(mapping.sources)
        self._control = control
        self._unseen = unseen
        self._counts = counts
        self._heard: dict[str, Mapping[str, float]] = {}
        self._sampled_s: float | None = None
        self._repeated = ""
        self._refused = 0
        self._newest: Reading | None = None
        self._handed_out: Reading | None = None
        self._stated_s: float | None = None

    @property
    def missing(self) -> list[str]:
        """Names of the PDOs that have not come since the last SYNC, or were refused."""
        return [name for name in self._statuses if not self._heard.get(name)]

    def begin(self, sampled_s: float) -> None:
        """Begin a set: a SYNC has passed, and the drive measures now."""
        self._heard.clear()
        self._sampled_s = sampled_s

    def take(self, status: StatusPdo, data: bytes, arrival_s: float, *, at_rest: bool) -> bool:
        """Take one PDO.

        A drive at rest may confirm its stop although its measurements are refused: it has a reading
        of those before.

        Args:
            status: Its codec and its sources.
            data: What it carries.
            arrival_s: Its arrival.
            at_rest: Whether the safe command is in force.

        Returns:
            Whether it was the last of its set.
        """
        decoded, name = status.codec.decode(data), status.codec.name
        self._hear_words(status, decoded.values or decoded.words, arrival_s)
        if decoded.verdict is not FrameVerdict.GOOD:
            self._counts[decoded.verdict] += 1
            self._refused += 1
            if decoded.verdict is not FrameVerdict.OUT_OF_RANGE:
                return False
        elif self._sampled_s is None:
            self._counts["counter_stuck"] += 1
        if name in self._heard:
            self._end_set()
            self._repeated = name
        if self._sampled_s is None:
            return False
        self._heard[name] = decoded.values
        if len(self._heard) < len(self._statuses):
            return False
        self._newest = self._compose(arrival_s, self._sampled_s, at_rest=at_rest) or self._newest
        return True

    def hand_out(self) -> Reading | None:
        """Return the newest reading once, None where none has come since the one before."""
        reading, self._newest = self._newest, None
        if reading is not None:
            self.faults.clear(reading.fault)
            self._handed_out = reading
        return reading

    def explain(self) -> str:
        """Return the PDO that is missing for a reading, and the likeliest cause."""
        missing = ", ".join(self.missing)
        return f"no complete set of PDOs: {missing} has not come since the last SYNC: {self._why}"

    @property
    def _why(self) -> str:
        """The likeliest cause, by what has come since the last complete set."""
        if self._refused:
            refused = f"{self._refused} PDOs were refused for their length or range"
            return f"{refused}: is the EDS the drive's own?"
        if self._repeated:
            twice = f"{self._repeated} came twice before the others"
            return f"{twice}: look for a gateway that repeats it, and for another node with this id"
        return "is SYNC on the bus, and the node operational?"

    def forget(self) -> None:
        """Forget all values; those of the last reading stay, for a drive at rest that has none."""
        self._end_set()
        self._newest = None

    def _end_set(self) -> None:
        self._heard.clear()
        self._sampled_s = None

    def _hear_words(self, status: StatusPdo, values: Mapping[str, float], arrival_s: float) -> None:
        """Follow the statusword and the fault word of a PDO."""
        statusword = values.get(_STATUSWORD)
        if statusword is not None:
            self._control.hear(int(statusword))
            self._unseen.hear(arrival_s)
            self._stated_s = self._sampled_s
        for source in status.sources:
            if source.quantity in self._words:
                self.faults.see(values.get(source.item.label), source.quantity)

    def _compose(self, arrival_s: float, sampled_s: float, *, at_rest: bool) -> Reading | None:
        """Return the reading of the PDOs after a SYNC, None for refused ones of a driven drive."""
        bridge = self._control.state in POWERED
        if self.missing:
            if self._handed_out is None or not at_rest:
                return None
            return confirming(
                self._handed_out,
                self.faults,
                arrival_s=arrival_s,
                bridge=bridge,
                bridge_s=self._stated_s,
            )
        found = {
            source.quantity: self._heard[name][source.item.label] * source.scale + source.offset
            for name, status in self._statuses.items()
            for source in status.sources
        }
        self._refused, self._repeated = 0, ""
        self._end_set()
        return composed(
            found,
            self._others,
            self.faults,
            arrival_s=arrival_s,
            oldest_s=sampled_s,
            bridge=bridge,
        )
