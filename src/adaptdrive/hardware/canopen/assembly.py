"""Putting the PDOs of one SYNC together: values that were measured at the same moment."""

from __future__ import annotations

from collections.abc import Mapping

from adaptdrive.hardware.binding import other_names
from adaptdrive.hardware.canopen.mapping import StatusPdo
from adaptdrive.hardware.fault_latch import FaultLatch
from adaptdrive.hardware.port import Reading, composed


class Assembly:
    """Collects PDOs until one of each kind has come since the last SYNC.

    A PDO that comes again before the others have ends the collection, and one without a SYNC since
    the last reading begins none: repeated PDOs make no readings of their own.

    Attributes:
        repeated: PDO that has last ended a collection since the last reading, empty for none.
    """

    def __init__(self, statuses: tuple[StatusPdo, ...]) -> None:
        self._count = len(statuses)
        self._heard: dict[str, Mapping[str, float]] = {}
        self._sampled_s: float | None = None
        self.repeated = ""
        self._statuses = {status.codec.name: status for status in statuses}
        self._others = other_names(one for status in statuses for one in status.sources)

    @property
    def waits(self) -> bool:
        """True between a SYNC and the reading that follows it."""
        return self._sampled_s is not None

    @property
    def sampled_s(self) -> float | None:
        """Time of the last SYNC, None after the reading that followed it."""
        return self._sampled_s

    @property
    def missing(self) -> list[str]:
        """Names of the PDOs that have not come since the last SYNC, or were refused."""
        return [name for name in self._statuses if not self._heard.get(name)]

    def begin(self, sampled_s: float) -> None:
        """Begin a reading: a SYNC has passed, and the drive measures now."""
        self._heard.clear()
        self._sampled_s = sampled_s

    def forget(self) -> None:
        """Forget all values that were received."""
        self._heard.clear()
        self._sampled_s = None

    def take(self, name: str, values: Mapping[str, float]) -> bool:
        """Take one PDO.

        Args:
            name: Its name.
            values: Raw values by label, none where the PDO is refused.

        Returns:
            Whether all have come; with one of them refused there is no reading of them.
        """
        if name in self._heard:
            self.forget()
            self.repeated = name
        if self._sampled_s is None:
            return False
        self._heard[name] = values
        return len(self._heard) == self._count

    def reading(self, arrival_s: float, faults: FaultLatch, *, bridge: bool) -> Reading:
        """The reading of a complete collection, which ends with it.

        Args:
            arrival_s: Arrival of the PDO that completed it.
            faults: Faults seen since the last reading that was handed out.
            bridge: Whether the drive's power stage may be on.
        """
        found = {
            source.quantity: self._heard[name][source.item.label] * source.scale + source.offset
            for name, status in self._statuses.items()
            for source in status.sources
        }
        sampled_s = arrival_s if self._sampled_s is None else self._sampled_s
        self.forget()
        self.repeated = ""
        return composed(
            found, self._others, faults, arrival_s=arrival_s, oldest_s=sampled_s, bridge=bridge
        )
