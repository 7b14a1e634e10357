"""The process of a daemon: one for a drive, by a lock, and its real time.

The lock is an abstract socket of the kernel. It needs no directory that every user may write to,
no sandbox hides it, and it ends with its process, however that dies. It is seen exactly where the
network interfaces are seen: a container with separate CAN interfaces has separate locks, too.

The warm-up runs ticks and slow steps on synthetic readings before the bus is opened. Imports and
memory are ready then, so that the first real ticks take no longer than later ones.
"""

import errno
import hashlib
import math
import os
import socket
import struct
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from pathlib import Path

from adaptdrive.app import loads, ports
from adaptdrive.app.settings import controller_settings, fast_settings, machine_limits
from adaptdrive.config import Configuration
from adaptdrive.config.polled import RtuLink
from adaptdrive.control.controller import Controller
from adaptdrive.control.signals import Mode, Snapshot
from adaptdrive.devices.port import Port
from adaptdrive.runtime import fast_loop, realtime, reports, requests, state_machine
from adaptdrive.safety.facts import Reading
from adaptdrive.safety.timing import timing_of
from adaptdrive.util.clock import now_s
from adaptdrive.util.errors import AdaptdriveError

# One daemon for a drive: a lock by name that all processes of a machine share.

NAMESPACE = "ADAPTDRIVE_LOCK_NAMESPACE"
"""Environment variable that keeps simulated drives of tests apart from those of this machine."""

_CREDENTIALS = struct.Struct("3i")
_START_FIELD = 19
"""Place of `starttime` in /proc/PID/stat, counted after the name of the program."""

_BACKLOG = 4096
"""Refused processes that learn which process holds a lock; the kernel keeps no more of them."""


_CONTROLLED = (
    "{name} is controlled by {holder}; end that daemon first, or give this one another drive"
)


def lock_names(configuration: Configuration) -> Iterator[str]:
    """Yield the names of exclusive resources: the drive, on Modbus its device, and serial lines.

    On CAN and CANopen another sender is heard; on Modbus nothing is heard of another client. A
    serial line has one master, whether that reads a drive or sensors there.

    Args:
        configuration: The drive.
    """
    yield f"drive {configuration.drive.name!r}"
    yield from ports.bus_kind(configuration.bus.type).lock_names(configuration)
    for link in (configuration.bus, *configuration.sensor_bus):
        if isinstance(link, RtuLink):
            yield f"serial line {link.device.absolute()}"  # relative: that of this folder alone


@contextmanager
def locked(
    names: Iterable[str], environment: Mapping[str, str], refusal: str = _CONTROLLED
) -> Iterator[None]:
    """Hold locks until the block ends.

    Args:
        names: What is locked.
        environment: Process environment.
        refusal: Text of the error, with places for `name` and `holder`.

    Raises:
        AdaptdriveError: Another process of this machine holds one of them.
    """
    namespace = environment.get(NAMESPACE, "")
    with ExitStack() as stack:
        for name in names:
            stack.enter_context(_lock(name, namespace, refusal))
        yield


def _lock(name: str, namespace: str, refusal: str) -> socket.socket:
    digest = hashlib.sha256(f"{namespace}\n{name}".encode()).hexdigest()
    address = f"\0adaptdrive-{digest[:32]}"
    lock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        lock.bind(address)
    except OSError as problem:
        lock.close()
        if problem.errno != errno.EADDRINUSE:
            raise AdaptdriveError(f"{name} cannot be locked: {problem.strerror}") from problem
        raise AdaptdriveError(refusal.format(name=name, holder=_holder(address))) from None
    lock.listen(_BACKLOG)
    return lock


def _holder(address: str) -> str:
    """The process that holds a lock, in words."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as client:
        client.settimeout(0.0)
        try:
            client.connect(address)
            found = client.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
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


# `[realtime]` at start: warm up, request the settings, and report the kernel's answers.

_PERIODS = 4
_READINGS_AT_MOST = 2400
_READINGS_BEFORE_START = 2


class WarmUp:
    """A scratch controller and a scratch fast loop, whose surroundings it is: all goes well."""

    def __init__(self, configuration: Configuration, port: Port) -> None:
        """Build both, and run nothing yet.

        Args:
            configuration: The drive.
            port: A separate port, which is not open: it encodes, and nothing reaches a wire.
        """
        self._configuration = configuration
        self._time_s = 0.0
        law, limits = controller_settings(configuration), machine_limits(configuration)
        self._controller = Controller(law, loads.build_load(configuration))
        self._machine = state_machine.Machine(limits)
        fast = fast_settings(configuration)
        self._loop = fast_loop.FastLoop(port, self._controller, self._machine, fast, self)
        load, reach = configuration.load, limits.reach
        ends = reach.nearest(load.reference_min), reach.nearest(load.reference_max)
        self._output = 0.5 * sum(ends)

    def run(self) -> int:
        """Go through start, run and stop.

        Returns:
            Ticks run.
        """
        loop, machine, output = self._loop, self._machine, self._output
        start = requests.SetMode(Mode.ADAPTIVE), requests.Enable(), requests.SetSetpoint(output)
        readings = min(_READINGS_AT_MOST, _PERIODS * self._configuration.ticks_per_period)
        for number in range(readings):
            self._read(output * (1.0 + 0.001 * math.sin(0.1 * number)))
            for request in start if number == _READINGS_BEFORE_START else ():
                machine.carry_out(request, loop.tick, output, loop.cause)
        loop.on_deadline(self._time_s)
        machine.carry_out(requests.Disable(), loop.tick, math.nan, None)
        loop.send_safe()
        machine.confirm_stop()  # no drive is there to do it
        return loop.ticks

    def now_s(self) -> float:
        """Return the simulated time."""
        return self._time_s

    def snapshot_taken(self, snapshot: Snapshot) -> bool:
        """Decide at once: no drive waits for the end of the tick."""
        self._loop.deliver(snapshot, self._controller.decide(snapshot))
        return True

    def arm(self, *_values: object, **_named: object) -> None:
        """Do nothing: no timer stands in, and nobody looks."""

    met_deadline = ticked = decided = not_stopped = run_ended = arm

    def _read(self, output: float) -> None:
        """Run the tick of a reading with an output of the load."""
        drive, limits = self._configuration.drive, self._configuration.drive.limits
        self._time_s += timing_of(self._configuration).reading_s
        reading = Reading(
            arrival_s=self._time_s,
            oldest_s=self._time_s,
            counter=None,
            boost_voltage_V=0.5 * (limits.boost_reference_min_V + limits.boost_reference_max_V),
            line_voltage_V=drive.line_voltage_V,
            load_power_W=0.1 * limits.load_power_max_W,
            output=output,
            fault=0,
            bridge=self._loop.command.bridge,
        )
        self._loop.on_reading(reading)


@contextmanager
def prepared(configuration: Configuration, source: Path, hub: reports.Hub) -> Iterator[None]:
    """Warm up, ask for what is configured, and publish an event for each answer of the kernel.

    Args:
        configuration: The drive.
        source: Its file.
        hub: Where the events go.
    """
    WarmUp(configuration, ports.build_port(configuration, now_s, source)).run()
    with realtime.real_time(configuration.realtime) as answers:
        for grant in answers:
            severity = reports.Severity.INFO if grant.granted else reports.Severity.WARNING
            answer = "granted" if grant.granted else "refused"
            detail = f"{grant.asked} {answer}: {grant.meaning}"
            hub.publish(reports.Event("realtime", severity, detail, -1))
        yield
