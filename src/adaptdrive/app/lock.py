"""One daemon for a drive: a lock by name that all processes of a machine share.

The lock is an abstract socket of the kernel. It needs no directory that every user may write to,
no sandbox hides it, and it ends with its process, however that dies. It is seen exactly where the
network interfaces are seen: a container with separate CAN interfaces has separate locks, too.
"""

from __future__ import annotations

import errno
import hashlib
import os
import socket
import struct
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from pathlib import Path

from adaptdrive.app.ports import bus_kind
from adaptdrive.config import Configuration
from adaptdrive.config.polled import RtuLink
from adaptdrive.util.errors import AdaptdriveError

NAMESPACE = "ADAPTDRIVE_LOCK_NAMESPACE"
"""Environment variable that keeps simulated drives of tests apart from those of this machine."""

_CREDENTIALS = struct.Struct("3i")
_START_FIELD = 19
"""Place of `starttime` in /proc/PID/stat, counted after the name of the program."""

_VISITORS = 4096
"""Refused processes that may wait to be sent away; more cannot learn which process holds a lock."""

VISITS_S = 1.0
"""Time from one visit of the locks to the next."""

_VISITORS_AT_ONCE = 64
"""Refused processes that are sent away between two ticks: about 1 ms."""


class LockedError(AdaptdriveError):
    """Another process of this machine controls the drive."""

    def __init__(self, what: str, holder: str) -> None:
        self.what = what
        self.holder = holder
        super().__init__(
            f"{what} is controlled by {holder}; end that daemon first, or give this one another "
            "drive"
        )


def lock_names(configuration: Configuration) -> Iterator[str]:
    """Yield the names of exclusive resources: the drive, on Modbus its device, and serial lines.

    On CAN and CANopen another sender is heard; on Modbus nothing is heard of another client. A
    serial line has one master, whether that reads a drive or sensors there.

    Args:
        configuration: The drive.
    """
    yield f"drive {configuration.drive.name!r}"
    yield from bus_kind(configuration.bus.type).lock_names(configuration)
    for link in (configuration.bus, *configuration.sensor_bus):
        if isinstance(link, RtuLink):
            yield f"serial line {link.device.absolute()}"  # relative: that of this folder alone


@contextmanager
def locked(names: Iterable[str], environment: Mapping[str, str]) -> Iterator[list[socket.socket]]:
    """Hold locks until the block ends.

    Args:
        names: What is locked.
        environment: Process environment.

    Raises:
        LockedError: Another process holds one of them.
    """
    namespace = environment.get(NAMESPACE, "")
    with ExitStack() as stack:
        yield [stack.enter_context(_lock(name, _address(namespace, name))) for name in names]


async def send_visitors_away(locks: Iterable[socket.socket]) -> None:
    """Keep the locks able to name this process to those that are refused."""
    for lock in locks:
        _empty(lock)


def _address(namespace: str, name: str) -> str:
    digest = hashlib.sha256(f"{namespace}\n{name}".encode()).hexdigest()
    return f"\0adaptdrive-{digest[:32]}"


def _lock(name: str, address: str) -> socket.socket:
    lock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        lock.bind(address)
    except OSError as problem:
        lock.close()
        if problem.errno != errno.EADDRINUSE:
            raise AdaptdriveError(f"{name} cannot be locked: {problem.strerror}") from problem
        raise LockedError(name, _holder(address)) from None
    lock.listen(_VISITORS)
    lock.settimeout(0.0)
    return lock


def _empty(lock: socket.socket) -> None:
    for _ in range(_VISITORS_AT_ONCE):
        try:
            lock.accept()[0].close()
        except OSError:
            return


def _holder(address: str) -> str:
    """The process that holds a lock, in words."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as visitor:
        visitor.settimeout(0.0)
        try:
            visitor.connect(address)
            found = visitor.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
        except OSError:
            return "another process (`ss -xlp` as root names it)"
    pid, uid, _ = _CREDENTIALS.unpack(found)
    if not pid:
        return "a process of another container"
    return f"process {pid} of user {uid}, {_since(pid)}"


def _since(pid: int) -> str:
    """Return the start time of a process as text."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8")
    except OSError:
        return "which this user cannot see"
    ticks = int(stat.rpartition(")")[2].split()[_START_FIELD])
    age_s = time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf("SC_CLK_TCK")
    started = datetime.fromtimestamp(time.time() - age_s, UTC)
    return f"running since {started:%Y-%m-%dT%H:%M:%SZ}"
