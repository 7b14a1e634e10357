"""`[interlocks]`, `[mqtt]`, `[recording]`, `[health]`, `[realtime]`: around the controller."""

from collections.abc import Iterator

from adaptdrive.config import section
from adaptdrive.util.errors import Flaw

LONGEST_STALE_S = 2.0
"""A drive that is read each half cycle is then commanded 240 times on held values; one that is
polled once a second may lose one poll."""


class InterlocksSection(section.Section):
    """`[interlocks]`: limits that trip the drive; a trip is latched until `reset`."""

    stale_s: section.PositiveFloat = section.key(0.05, le=LONGEST_STALE_S)
    """greatest age of a measurement; until then ticks use held values, then trip"""
    boost_voltage_max_V: section.PositiveFloat = 430.0
    """over-voltage trip"""
    output_max: section.FiniteFloat
    """trip when the output is above"""
    output_min: section.FiniteFloat | None = None
    """trip when the output is below (a reversed sensor); a quarter of the set-point range below 0
    and `load.reference_min` when left out"""
    stuck_distance: float = section.key(0.05, span=(0.0, 1.0))
    """trip when the output stands at exactly one value although the model moves by this share of
    the set-point range and twenty steps of `load.resolution`; 0: never; not for a battery"""
    stuck_s: section.NonNegativeFloat = section.key(0.0, le=3600.0)
    """trip when the output has exactly one value for this time while running, for sensors with
    noise above their last digit; 0: never"""
    response_factor: float = section.key(4.0, span=(0.0, 100.0))
    """trip when the output is lower than a load with so many times less gain than `load.model`
    gives, or falls faster than a load can; 0: never"""
    precharge_timeout_s: section.PositiveFloat = section.key(5.0, le=600.0)
    """longest precharge in `starting`, and longest wait for the rate of the half cycles before"""
    start_s: section.PositiveFloat | None = section.key(None, le=5.0)
    """trip when the drive has not reported its bridge on within this time after the command; at
    least three readings; 30 half cycles when left out"""
    stop_s: float = section.key(0.5, gt=0.0, le=5.0)
    """trip when the drive has not reported its bridge off within this time after a stop; at least
    four readings"""
    refused_share: float = section.key(0.0, span=(0.0, 1.0))
    """trip when this share of the frames of the drive or of a sensor bus was refused over 5 s; 0:
    never; an event reports a tenth and more"""

    def flaws(self) -> Iterator[Flaw]:
        """Yield a factor that lets a healthy load trip."""
        if 0.0 < self.response_factor < 1.0:
            yield Flaw("response_factor", f"{self.response_factor:g} must be 0, or at least 1")


class Mqtt(section.Section):
    """`[mqtt]`: the broker that carries state, telemetry and commands."""

    host: section.Host = "127.0.0.1"
    """broker"""
    port: int = section.key(1883, span=(1, 65535))
    """port of the broker"""
    tls: bool = False
    """connect to the broker with TLS"""
    ca_file: section.FilePath | None = None
    """certificate authority for TLS"""
    username: str | None = None
    """user name"""
    password_file: section.FilePath | None = None
    """file that holds the password"""
    telemetry_Hz: float = section.key(10.0, span=(0.01, 10.0))
    """rate of `telemetry/drive`; at least 1 where a daemon runs, as a drive that is silent for 3 s
    counts as gone"""
    home_assistant: str | None = section.key(None, pattern="^[A-Za-z0-9_/-]+$")
    """prefix of Home Assistant's discovery, usually `homeassistant`; not announced when left out"""

    def flaws(self) -> Iterator[Flaw]:
        """Yield an authority that nothing asks."""
        if self.ca_file is not None and not self.tls:
            problem = "user name and password would go over the wire in clear"
            remedy = "set tls = true, or leave ca_file out"
            yield Flaw("", f"ca_file = {str(self.ca_file)!r} without tls: {problem}; {remedy}")


class Recording(section.Section):
    """`[recording]`: what is kept of a session."""

    enabled: bool = True
    """record sessions"""
    directory: section.FilePath | None = None
    """folder of the sessions; $STATE_DIRECTORY/sessions or ./sessions when left out"""
    segment_s: float = section.key(3600.0, span=(1.0, 86_400.0))
    """time after which a session continues in new files"""
    keep_days: section.PositiveFloat | None = None
    """remove sessions that began longer ago; none when left out"""
    keep_MB: section.PositiveFloat | None = None
    """remove the oldest while all sessions take more; none when left out"""


class Bound(section.Section):
    """`[health.bounds.NAME]`: the range of one quantity of the load."""

    min: section.FiniteFloat | None = None
    """lowest value"""
    max: section.FiniteFloat | None = None
    """highest value"""

    def flaws(self) -> Iterator[Flaw]:
        """Yield a range without a value in it."""
        if self.min is not None and self.max is not None and self.min >= self.max:
            yield Flaw("max", f"{self.max:g} must be above min = {self.min:g}")


class Health(section.Section):
    """`[health]`: bounds of quantities of `adaptdrive health` by name, such as `friction`.

    An event `health` warns once when a mean of seven days is outside by six standard deviations.
    """

    bounds: dict[str, Bound] = section.key({})
    """ranges by name of the quantity"""


class Realtime(section.Section):
    """`[realtime]`: how hard the fast loop is protected from the rest of the machine."""

    priority: int | None = section.key(None, span=(1, 98))
    """SCHED_FIFO priority, with the daemon's memory kept in RAM; ordinary scheduling without"""
    cpu_latency_us: int | None = section.key(None, span=(0, 10_000))
    """longest time that idle CPUs may take to wake up; shorter needs more power"""
