"""`[interlocks]`, `[mqtt]`, `[recording]`, `[realtime]`: what surrounds the controller."""

import contextlib
import ipaddress
import re
from collections.abc import Iterator
from typing import Annotated

from pydantic import AfterValidator, Field

from adaptdrive.config import section
from adaptdrive.util.errors import Flaw

LONGEST_STALE_S = 2.0
"""A drive that is read each half cycle is then commanded 240 times on held values; one that is
polled once a second may lose one poll."""

_NAME = re.compile(r"(?=.{1,254}$)((?!-)[A-Za-z0-9_-]{1,63}(?<!-)(\.|$))+")
"""Labels with dots between them, and at the end or not; RFC 1035 allows 253 characters."""


def check_host(host: str) -> str:
    """Return a host that can be looked up.

    Args:
        host: Name or address.

    Raises:
        ValueError: It is neither an IP address nor a host name.
    """
    with contextlib.suppress(ValueError):
        ipaddress.ip_address(host)
        return host
    name = ""
    with contextlib.suppress(UnicodeError):
        name = host.encode("idna").decode("ascii")
    if not _NAME.fullmatch(name):
        raise ValueError(
            f"{host!r} is neither an IP address nor a host name: labels of 1 to 63 letters, digits "
            "and '-', separated by dots"
        )
    return host


class InterlocksSection(section.Section):
    """`[interlocks]`: limits that trip the drive; a trip is latched until `reset`."""

    stale_s: section.PositiveFloat = section.key(0.05, le=LONGEST_STALE_S)
    boost_voltage_max_V: section.PositiveFloat = 430.0
    output_max: section.FiniteFloat
    output_min: section.FiniteFloat | None = None
    stuck_distance: float = section.key(0.05, span=(0.0, 1.0))
    stuck_s: section.NonNegativeFloat = section.key(0.0, le=3600.0)
    response_factor: float = section.key(4.0, span=(0.0, 100.0))
    precharge_timeout_s: section.PositiveFloat = section.key(5.0, le=600.0)
    start_s: section.PositiveFloat | None = section.key(None, le=5.0)
    stop_s: float = section.key(0.5, gt=0.0, le=5.0)
    refused_share: float = section.key(0.0, span=(0.0, 1.0))

    def flaws(self) -> Iterator[Flaw]:
        """Yield a factor that lets a healthy load trip."""
        if 0.0 < self.response_factor < 1.0:
            yield Flaw("response_factor", f"{self.response_factor:g} must be 0, or at least 1")


class Mqtt(section.Section):
    """`[mqtt]`: the broker that carries state, telemetry and commands."""

    host: Annotated[str, AfterValidator(check_host)] = "127.0.0.1"
    port: int = section.key(1883, span=(1, 65535))
    tls: bool = False
    ca_file: section.FilePath | None = None
    username: str | None = None
    password_file: section.FilePath | None = None
    telemetry_Hz: float = section.key(10.0, span=(0.01, 10.0))
    home_assistant: str | None = section.key(None, pattern="^[A-Za-z0-9_/-]+$")

    def flaws(self) -> Iterator[Flaw]:
        """Yield an authority that nothing asks."""
        if self.ca_file is not None and not self.tls:
            problem = "user name and password would go over the wire in clear"
            remedy = "set tls = true, or leave ca_file out"
            yield Flaw("", f"ca_file = {str(self.ca_file)!r} without tls: {problem}; {remedy}")


class Recording(section.Section):
    """`[recording]`: what is kept of a session."""

    enabled: bool = True
    directory: section.FilePath | None = None
    flush_s: float = section.key(0.2, span=(0.1, 60.0))
    segment_s: float = section.key(3600.0, span=(1.0, 86_400.0))
    keep_days: section.PositiveFloat | None = None
    keep_MB: section.PositiveFloat | None = None


class Realtime(section.Section):
    """`[realtime]`: how hard the fast loop is protected from the rest of the machine."""

    timer_standin: bool = True
    late_fraction: float = section.key(0.5, gt=0.0, lt=1.0)
    priority: int | None = section.key(None, span=(1, 98))
    cpus: list[Annotated[int, Field(ge=0)]] = section.key([])
    cpu_latency_us: int | None = section.key(None, span=(0, 10_000))
    lock_memory: bool = False
    freeze_gc: bool = True
    warm_up: bool = True
    rehearse_us: float = section.key(0.0, span=(0.0, 3000.0))
    spin_us: float = section.key(0.0, span=(0.0, 1000.0))
    late_us: section.PositiveFloat = section.key(2000.0, span=(10.0, 1e6))

    def flaws(self) -> Iterator[Flaw]:
        """Yield a wait without time for the rehearsal before it."""
        if self.spin_us >= self.rehearse_us > 0.0:
            larger = f"rehearse_us = {self.rehearse_us:g} must be larger"
            problem = f"{self.spin_us:g} leaves no time for the rehearsal before it: {larger}"
            yield Flaw("spin_us", problem)
