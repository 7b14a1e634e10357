"""The drive's status PDOs as readings: the set after one SYNC, and the newest of several sets.

The values of a set were measured at the same moment; in place of one that must not be used stands
the last good one. A PDO that comes again before the others have ends the set, and one without a
SYNC since the last reading begins none: repeated PDOs make no readings of their own.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from adaptdrive.devices.binding import BRIDGE, other_names
from adaptdrive.devices.can.integrity import FrameVerdict
from adaptdrive.devices.canopen.dictionary import label
from adaptdrive.devices.canopen.mapping import CanOpenMapping, StatusPdo
from adaptdrive.devices.canopen.profile import POWERED, STATUSWORD, DriveControl, UnseenStop
from adaptdrive.devices.newest import NewestValues
from adaptdrive.devices.port import Reading

_STATUSWORD = label(STATUSWORD)


def newest_values(mapping: CanOpenMapping) -> NewestValues:
    """Return the values of a drive, none of which is known yet."""
    slacks = dict.fromkeys([BRIDGE, *(one.quantity for one in mapping.sources)], 0.0)
    return NewestValues(slacks, other_names(mapping.sources), mapping.faults)


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
        self._values = newest_values(mapping)
        self.faults = self._values.faults
        self._statuses = {status.codec.name: status for status in mapping.statuses}
        self._control = control
        self._unseen = unseen
        self._counts = counts
        self._heard: set[str] = set()
        self._sampled_s: float | None = None
        self._repeated = ""
        self._refused = 0
        self._newest: Reading | None = None

    @property
    def missing(self) -> list[str]:
        """Names of the PDOs that have not come since the last SYNC."""
        return [name for name in self._statuses if name not in self._heard]

    def begin(self, sampled_s: float | None) -> None:
        """Begin a set: a SYNC has passed, and the drive measures now; None to end one."""
        self._heard.clear()
        self._sampled_s = sampled_s

    def take(self, status: StatusPdo, data: bytes, arrival_s: float) -> bool:
        """Take one PDO.

        Args:
            status: Its codec and its sources.
            data: What it carries.
            arrival_s: Its arrival.

        Returns:
            Whether it was the last of its set.
        """
        decoded, name = status.codec.decode(data), status.codec.name
        if decoded.verdict is not FrameVerdict.GOOD:
            self._counts[decoded.verdict] += 1
            self._refused += 1
            if decoded.verdict is not FrameVerdict.OUT_OF_RANGE:
                return False
        elif self._sampled_s is None:
            self._counts["counter_stuck"] += 1
        values = self._hear(status, decoded.values, arrival_s)
        if name in self._heard:
            self.begin(None)
            self._repeated = name
        if self._sampled_s is None:
            return False
        self._heard.add(name)
        carried = (source.quantity for source in status.sources)
        refused = [quantity for quantity in carried if quantity not in values]
        self._values.keep(values, self._sampled_s, refused)
        if self.missing:
            return False
        self._newest = self._values.reading(arrival_s, set_s=self._sampled_s) or self._newest
        self.begin(None)
        if not self._values.refused:
            self._refused, self._repeated = 0, ""
        return True

    def hand_out(self) -> Reading | None:
        """Return the newest reading once, None where none has come since the one before."""
        reading, self._newest = self._newest, None
        if reading is not None:
            self.faults.clear(reading.fault)
        return reading

    def explain(self) -> str:
        """Return the PDO that is missing for a reading, or the value, and the likeliest cause."""
        refused, missing = ", ".join(sorted(self._values.refused)), ", ".join(self.missing)
        if refused:
            return f"no value of {refused} that may be used: {self._why}"
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
        """Await a report of the bridge: the node was lost, or is set up again."""
        self.begin(None)
        self._newest = None
        self._values.forget(BRIDGE)

    def _hear(
        self, status: StatusPdo, found: Mapping[str, float], arrival_s: float
    ) -> dict[str, float]:
        """Follow statusword and faults of a PDO; return its values by quantity."""
        values = {
            one.quantity: found[one.item.label] * one.scale + one.offset
            for one in status.sources
            if one.item.label in found
        }
        self.faults.see(values)
        statusword = found.get(_STATUSWORD)
        if statusword is not None:
            self._control.hear(int(statusword))
            self._unseen.hear(arrival_s)
            values[BRIDGE] = float(self._control.state in POWERED)
        return values
