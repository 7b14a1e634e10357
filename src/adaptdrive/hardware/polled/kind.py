"""Parts by which each kind of polled drive takes its place in the daemon."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import replace
from ipaddress import IPv6Address, ip_address
from pathlib import Path

from adaptdrive.config import Configuration
from adaptdrive.config.modbus import ModbusBus
from adaptdrive.errors import Flaw
from adaptdrive.hardware.bus_kind import timeout_cautions
from adaptdrive.hardware.demands import demands_of
from adaptdrive.hardware.polled.mapping import Poll, map_drive
from adaptdrive.hosts import look_up

_LOOK_UP_S = 2.0
"""Longest wait for the addresses of a drive's host: its daemon starts without them, too."""


def planned(
    configuration: Configuration, bus: ModbusBus, source: Path | str, *, passive: bool
) -> Poll:
    """Return the polls of a drive.

    Args:
        configuration: The drive.
        bus: `[bus]`, with a register for each value.
        source: The configuration's file, for error messages.
        passive: Whether nothing may be written to the drive.

    Raises:
        ConfigurationError: Bus and signals do not fit; every flaw is listed.
    """
    half_cycle_s, demands = configuration.timing.half_cycle_s, demands_of(configuration)
    poll = map_drive(bus, configuration.signals, half_cycle_s, source, demands)
    return replace(poll, setup=()) if passive else poll  # without a command, nothing is written


def polled_cautions(configuration: Configuration) -> Iterator[Flaw]:
    """Yield what the own time-out of a drive that is polled does not fit."""
    return timeout_cautions(configuration.timing, "bus.poll_ticks")


def tcp_locks(kind: str, host: str, port: int, rest: str = "") -> Iterator[str]:
    """Yield a device by each address of its host, none where its name server does not answer.

    Args:
        kind: Kind of bus.
        host: Name or address.
        port: TCP port.
        rest: What else tells the device from others.
    """
    with contextlib.suppress(OSError, ValueError, TimeoutError):
        found = look_up(host, port).result(_LOOK_UP_S)
        for address in sorted({*map(_plain, found)}):
            yield f"{kind} address {address} port {port}{rest}"


def _plain(address: str) -> str:
    """Return the IPv4 address that an IPv6 address stands for, and each other one as it is."""
    found = ip_address(address)
    mapped = found.ipv4_mapped if isinstance(found, IPv6Address) else None
    return str(mapped or found)
