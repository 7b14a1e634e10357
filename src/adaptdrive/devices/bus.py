"""The place of a bus in the daemon, and what the ports of all buses have in common.

No tick commands it: an operator asks for it while the drive is off.
"""

import asyncio
import contextlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from ipaddress import IPv6Address, ip_address
from pathlib import Path
from typing import Any, TypeVar

from adaptdrive.config import Configuration
from adaptdrive.devices import description
from adaptdrive.devices.port import Port, PortStatistics, SensorPort
from adaptdrive.safety.timing import Timing, timing_of
from adaptdrive.util import clock, errors
from adaptdrive.util.quantity import MEASURED

# The parts by which one kind of bus takes its place in the daemon.

Bus = TypeVar("Bus")

Row = tuple[str, float, str]
"""Name of a limit, its duration in seconds, and the keys that set it."""


_LOOK_UP_S = 2.0
"""Longest wait for the addresses of a drive's host: its daemon starts without them, too."""

BuildPort = Callable[[Configuration, Callable[[], float], Path | str, bool], Port]
"""Builds the port of a drive from it, clock, source, and whether nothing may be written to it.

Nothing is opened yet. It raises `ConfigurationError` with every flaw where bus and signals do not
fit.
"""

BuildSensors = Callable[
    [Any, str, Callable[[], float], Path | str, description.Demands], SensorPort
]
"""Builds the port of an entry of `[[sensor_bus]]` from it, its place, clock, source and demands."""


def stale_limits(configuration: Configuration, _: Path | str) -> Iterator[Row]:
    """Yield the age limit of each measured value, which `interlocks.stale_s` sets.

    Args:
        configuration: The drive.
    """
    signals = configuration.signals
    given = [name for name in MEASURED if getattr(signals, name) is not None]
    for name in (*given, *signals.other):
        yield f"stale {name}", configuration.interlocks.stale_s, "interlocks.stale_s"


def timeout_cautions(timing: Timing, key: str, slack_s: float = 0.0) -> Iterator[errors.Flaw]:
    """Yield one word on a drive's time-out that is not stated, or ends before pauses of the daemon.

    One command may be lost, and the next one late; the drive or the daemon may be silent.

    Args:
        timing: Times of the drive; each reading has a command.
        key: Key that determines how often a reading comes.
        slack_s: How much older than `interlocks.stale_s` each value may be, by `bus.stale_cycles`.
    """
    timeout_s, every_ms = timing.command_timeout_s, timing.reading_s * 1e3
    if timeout_s is None:
        yield errors.Flaw(
            "bus.command_timeout_s",
            "is left out: a drive without a time-out of its own stays energised when the daemon, "
            "its computer or the cable fails; state it, or wire a contactor for that",
        )
        return
    silence_key = "bus.stale_cycles" if slack_s else "interlocks.stale_s"
    late = f"two and a half times the {every_ms:.4g} ms from one command to the next"
    pauses = (
        (timing.command_pause_s, late, key),
        (timing.stale_s + slack_s, "the silence after which the daemon trips", silence_key),
    )
    longer = [pause for pause in pauses if timeout_s <= pause[0]]
    if longer:
        named = ", nor than ".join(f"{pause_s:.4g} s, {meaning}" for pause_s, meaning, _ in longer)
        keys = " and ".join(one for _, _, one in longer)
        yield errors.Flaw(
            "bus.command_timeout_s",
            f"{timeout_s:g} s is not longer than {named}: the drive stops by itself before; set a "
            f"longer time-out in the drive, or lower {keys}",
        )


def polled_cautions(configuration: Configuration) -> Iterator[errors.Flaw]:
    """Yield what the own time-out of a drive that is polled does not fit."""
    return timeout_cautions(timing_of(configuration), "bus.poll_ticks")


def tcp_locks(kind: str, host: str, port: int, rest: str = "") -> Iterator[str]:
    """Yield a device by each address of its host, none where its name server does not answer.

    Args:
        kind: Kind of bus.
        host: Name or address.
        port: TCP port.
        rest: The rest of its address, such as the id of the device.
    """
    with contextlib.suppress(OSError, ValueError, TimeoutError):
        found = clock.look_up(host, port).result(_LOOK_UP_S)
        for address in sorted({*map(_plain, found)}):
            yield f"{kind} address {address} port {port}{rest}"


def _plain(address: str) -> str:
    """Return the IPv4 address that an IPv6 address stands for, and each other one as it is."""
    found = ip_address(address)
    mapped = found.ipv4_mapped if isinstance(found, IPv6Address) else None
    return str(mapped or found)


def bus_of(configuration: Configuration, kind: type[Bus]) -> Bus:
    """Return the bus of a configuration that was selected by its type."""
    assert isinstance(configuration.bus, kind)  # noqa: S101 - selected by it
    return configuration.bus


@dataclass(frozen=True, slots=True)
class BusKind:
    """One kind of bus.

    Attributes:
        build_port: Builds the port of a drive.
        cautions: Yields what can be used, and probably does not work well.
        build_sensors: Builds the port of a sensor bus, None where there are none of this kind.
        time_limits: Yields the limits of time of a drive.
        lock_names: Yields what one daemon alone may have, in addition to the drive's name; nothing
            where frames of another sender are received.
    """

    build_port: BuildPort
    cautions: Callable[[Configuration], Iterator[errors.Flaw]]
    build_sensors: BuildSensors | None = None
    time_limits: Callable[[Configuration, Path | str], Iterator[Row]] = stale_limits
    lock_names: Callable[[Configuration], Iterator[str]] = lambda _: iter(())


# Counts of a port, answers that most ports have in common, and delays of a bus that is lost.

_FIRST_S = 0.1
"""An interface or a server that is restarted is soon back."""

_LONGEST_S = 2.0
"""A cable or an adapter that is plugged in again should not be waited for."""


class CountingPort:
    """Counts of a port, and answers that most ports have in common."""

    counter_modulus: int | None = None
    """None: no frame of the drive counts half cycles."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()

    @property
    def statistics(self) -> PortStatistics:
        """Counts since the port was built."""
        return PortStatistics(**self._counts)

    def take_garbage(self) -> None:
        """Count something on the bus that is no frame, or none of the drive."""
        self._counts["received"] += 1
        self._counts["foreign"] += 1

    def catch_up(self) -> None:
        """Nothing waits: each answer is taken where it was asked for."""

    def details(self) -> list[str]:
        """Return no lines: what is refused is announced on its own."""
        return []

    async def reset_fault(self) -> None:
        """No-op: the drive clears its fault word by itself."""


def backoff_s(received: Callable[[], int]) -> Iterator[float]:
    """Yield the delay before each attempt, in s: it doubles until the bus has carried something.

    Args:
        received: Returns the number of frames or replies since the port was built.
    """
    before, delay_s = received(), _FIRST_S
    while True:
        now = received()
        if now > before:
            before, delay_s = now, _FIRST_S
        yield delay_s
        delay_s = min(2.0 * delay_s, _LONGEST_S)


# Reset of a drive's fault by a part of its command: on for a moment, and off again.

_READINGS = 3.0
"""Readings for which each level lasts: a drive that is polled takes one command in each."""

_LEAST_S = 0.1
"""Shortest time of a level: drives look at such a bit every few milliseconds."""


async def pulse_reset(sinks: Iterable[description.Sink[Any]], reading_s: float) -> None:
    """Switch the reset of a fault on and off with the next commands; nothing where there is none.

    Args:
        sinks: All parts of the command.
        reading_s: Time from one reading of the drive to the next.
    """
    resets = [sink.reset for sink in sinks if sink.reset is not None]
    if not resets:
        return
    level_s = max(_LEAST_S, _READINGS * reading_s)
    try:
        for reset in resets:
            reset.set()
        await asyncio.sleep(level_s)
    finally:
        for reset in resets:
            reset.clear()
    await asyncio.sleep(level_s)
