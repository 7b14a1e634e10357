"""The drive's status PDOs as readings: the set after one SYNC, and the newest of several sets."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from adaptdrive.hardware.canopen.assembly import Assembly
from adaptdrive.hardware.canopen.dictionary import label
from adaptdrive.hardware.canopen.mapping import StatusPdo
from adaptdrive.hardware.canopen.profile import POWERED, STATUSWORD, DriveControl
from adaptdrive.hardware.canopen.unseen import UnseenStop
from adaptdrive.hardware.fault_latch import FaultLatch, FaultWord
from adaptdrive.hardware.link.integrity import FrameVerdict
from adaptdrive.hardware.port import Reading, confirming

_STATUSWORD = label(STATUSWORD)


class Reports:
    """Collects status PDOs, and keeps the newest reading until it is handed out.

    Attributes:
        assembly: PDOs that have come since the last SYNC.
        faults: Faults that no reading has carried yet.
    """

    def __init__(
        self,
        statuses: tuple[StatusPdo, ...],
        faults: Mapping[str, FaultWord],
        control: DriveControl,
        unseen: UnseenStop,
        counts: Counter[str],
    ) -> None:
        """Expect PDOs; none has come yet.

        Args:
            statuses: PDOs of a reading.
            faults: Fault words of the drive.
            control: Follows the statusword.
            unseen: Watches the time between two statuswords.
            counts: Counts of the port, to which refused PDOs are added.
        """
        self.assembly = Assembly(statuses)
        self.faults = FaultLatch(faults)
        self._words = faults
        self._control = control
        self._unseen = unseen
        self._counts = counts
        self._refused = 0
        self._newest: Reading | None = None
        self._handed_out: Reading | None = None
        self._stated_s: float | None = None

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
        decoded = status.codec.decode(data)
        self._hear_words(status, decoded.values or decoded.words, arrival_s)
        if decoded.verdict is not FrameVerdict.GOOD:
            self._counts[decoded.verdict] += 1
            self._refused += 1
            if decoded.verdict is not FrameVerdict.OUT_OF_RANGE:
                return False
        elif not self.assembly.waits:
            self._counts["counter_stuck"] += 1
        if not self.assembly.take(status.codec.name, decoded.values):
            return False
        self._newest = self._compose(arrival_s, at_rest=at_rest) or self._newest
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
        missing = ", ".join(self.assembly.missing)
        return f"no complete set of PDOs: {missing} has not come since the last SYNC: {self._why}"

    @property
    def _why(self) -> str:
        """The likeliest cause, by what has come since the last complete set."""
        if self._refused:
            refused = f"{self._refused} PDOs were refused for their length or range"
            return f"{refused}: is the EDS the drive's own?"
        if self.assembly.repeated:
            twice = f"{self.assembly.repeated} came twice before the others"
            return f"{twice}: look for a gateway that repeats it, and for another node with this id"
        return "is SYNC on the bus, and the node operational?"

    def forget(self) -> None:
        """Forget all values; those of the last reading stay, for a drive at rest that has none."""
        self.assembly.forget()
        self._newest = None

    def _hear_words(self, status: StatusPdo, values: Mapping[str, float], arrival_s: float) -> None:
        """Follow the statusword and the fault word of a PDO."""
        statusword = values.get(_STATUSWORD)
        if statusword is not None:
            self._control.hear(int(statusword))
            self._unseen.hear(arrival_s)
            self._stated_s = self.assembly.sampled_s
        for source in status.sources:
            if source.quantity in self._words:
                self.faults.see(values.get(source.item.label), source.quantity)

    def _compose(self, arrival_s: float, *, at_rest: bool) -> Reading | None:
        """Return the reading of the PDOs after a SYNC, None for refused ones of a driven drive."""
        bridge = self._control.state in POWERED
        if not self.assembly.missing:
            self._refused = 0
            return self.assembly.reading(arrival_s, self.faults, bridge=bridge)
        if self._handed_out is None or not at_rest:
            return None
        return confirming(
            self._handed_out,
            self.faults,
            arrival_s=arrival_s,
            bridge=bridge,
            bridge_s=self._stated_s,
        )
