"""What a port has seen of a drive."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace


@dataclass(slots=True)
class Reading:
    """One complete set of drive quantities.

    Nobody changes one. It is not frozen: making a frozen one takes 1 µs longer, in every half
    cycle.

    Attributes:
        arrival_s: Arrival of the clocking frame, monotonic clock.
        oldest_s: Arrival of the oldest frame that a value of this reading was taken from.
        counter: The drive's half-cycle counter as sent (it wraps), None for a drive without one,
            and where the newest one must not be used.
        boost_voltage_V: Boost capacitor voltage.
        line_voltage_V: Line voltage, rms.
        load_power_W: Power into the load.
        output: Regulated quantity in its own unit.
        fault: Fault word of the drive, 0 when healthy.
        bridge: Whether the drive reports its bridge on.
        other: More values of the drive, and those of separate sensors, by name. A quantity
            that the drive does not give is NaN until a sensor or `[derived]` has given it.
        slack_s: How much older than `interlocks.stale_s` the frame of `oldest_s` may be, as the
            drive sends it less often. Of several frames, `oldest_s` and `slack_s` are those of the
            one that is out of date first.
        fault_name: What the drive's description calls the fault, an empty string for nothing.
        bridge_s: Arrival of the frame with the report of the bridge, None where that is `oldest_s`.
        whole: False while the drive sends a value that must not be used, so that an older one of
            its quantity is held.
        warning: The drive's warnings by signal, bit and name, an empty string for none.
        voltage_s: Time of the boost voltage, None where that is `oldest_s`.
    """

    arrival_s: float
    oldest_s: float
    counter: int | None
    boost_voltage_V: float
    line_voltage_V: float
    load_power_W: float
    output: float
    fault: int
    bridge: bool
    other: Mapping[str, float] = field(default_factory=dict)
    slack_s: float = 0.0
    fault_name: str = ""
    bridge_s: float | None = None
    whole: bool = True
    warning: str = ""
    voltage_s: float | None = None

    @property
    def bridge_reported_s(self) -> float:
        """Arrival of the report of the bridge, monotonic clock."""
        return self.oldest_s if self.bridge_s is None else self.bridge_s


def assuming(reading: Reading, voltage_V: float) -> Reading:
    """Return the reading of a drive that does not report what it was commanded to hold.

    Args:
        reading: Its values.
        voltage_V: V_c in force, which stands for v_bst.
    """
    return replace(reading, boost_voltage_V=voltage_V)
