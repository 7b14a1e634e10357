"""The connection to a broker: made, kept, made again, under a name that is the daemon's own.

A broker lets one client have a name: it closes the first one's connection when a second one comes.
Two daemons of one drive would take turns without end, and a `disable` would reach one of them. So
the one that loses the name gives way: it connects under another name, where operators reach
both, and reports it. It trips as soon as it is certain of the other daemon.
"""

import asyncio
import math
import ssl
import uuid
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from aiomqtt import Client, MqttError, ProtocolVersion, Will
from aiomqtt.exceptions import MqttConnectError
from paho.mqtt.reasoncodes import ReasonCode

from adaptdrive.mqtt.steady import SteadyClient
from adaptdrive.safety.trips import Trip, TripKind
from adaptdrive.util import clock, files
from adaptdrive.util.errors import first_error
from adaptdrive.util.lines import write_line

# The address of a broker, and the login there.


@dataclass(frozen=True, slots=True)
class Broker:
    """A broker, and who connects to it.

    Attributes:
        host: Name or address.
        port: TCP port.
        tls: Whether to encrypt by TLS.
        ca_file: Certificate authority for TLS, None for those of the machine.
        username: User name, None for none.
        password_file: File that holds the password, None for none.
    """

    host: str = "127.0.0.1"
    port: int = 1883
    tls: bool = False
    ca_file: Path | None = None
    username: str | None = None
    password_file: Path | None = None


# The name of the daemon at the broker, and what happens when another client uses it too.

CLOSINGS = 3
CLOSINGS_WITHIN_S = 120.0
"""Two clients that take turns wait up to 30 s each; brokers are seldom restarted that often."""


@dataclass
class ClientName:
    """The client name of one drive's daemon.

    Attributes:
        own: The drive's own name.
        monotonic: Clock for intervals, in seconds.
        alarm: Reports another client of this name.
        trip: Trips the drive, where the other client is certain.
        present: The name to connect under.
    """

    own: str
    monotonic: Callable[[], float]
    alarm: Callable[[Trip], None]
    trip: Callable[[Trip], None]

    def __post_init__(self) -> None:
        self.present = self.own
        self._certain = False
        self._closings_s: deque[float] = deque(maxlen=CLOSINGS)

    @property
    def is_displaced(self) -> bool:
        """True if another client has the drive's own name."""
        return self.present != self.own

    def connection_ended(self, client: SteadyClient) -> None:
        """Look whether a connection ended because another client took the name."""
        if self.is_displaced:
            return
        if client.taken_over:
            self._change_name("the broker gave its connection to another client", certain=True)
        elif client.closed_by_broker:
            self._count_closing()

    def note_other_publisher(self) -> None:
        """Another client publishes as this drive."""
        if not self._certain:
            self._report_other(f"another client publishes as {self.own}", certain=True)

    def reclaim(self, client: SteadyClient) -> None:
        """Take the drive's own name again: a daemon that has it loses it, and trips."""
        if self.is_displaced:
            self.present, self._certain = self.own, False
            client.end_connection("connects under its own client name again")

    def _count_closing(self) -> None:
        # Not every broker gives a reason; then a name that is lost again and again is the sign.
        now_s = self.monotonic()
        self._closings_s.append(now_s)
        lasted_s = now_s - self._closings_s[0]
        if len(self._closings_s) == CLOSINGS and lasted_s < CLOSINGS_WITHIN_S:
            self._closings_s.clear()
            closed = f"the broker closed its connection {CLOSINGS} times in {lasted_s:.0f} s"
            self._change_name(closed, certain=False)

    def _change_name(self, detail: str, *, certain: bool) -> None:
        self.present = f"{self.own}-{uuid.uuid4().hex[:8]}"
        self._report_other(f"client name {self.own}: {detail}", certain=certain)

    def _report_other(self, detail: str, *, certain: bool) -> None:
        """Report the other client, and trip where it is certain."""
        self._certain = certain
        cause = Trip(
            TripKind.SECOND_CLIENT,
            f"second broker client: {detail}; likeliest a second daemon for this drive on another "
            "machine: end it",
        )
        self.alarm(cause)
        if certain:
            self.trip(cause)


# The connection to a broker: made, kept, and made again.

TIMEOUT_S = 5.0
DISCONNECT_S = 1.0
KEEP_ALIVE_S = 15
_FIRST_PAUSE_S = 0.5
_LONGEST_PAUSE_S = 30.0
_HEALTHY_S = 10.0
"""Life of a connection that makes the next pause the first one again."""

_LONGEST_PASSWORD = 65_535
"""Bytes that MQTT has room for."""


Serve = Callable[[SteadyClient], Awaitable[None]]
"""Uses a connected client; ends with `MqttError` when the connection is lost."""

_UNSUPPORTED_PROTOCOL = (1, 132)  # in the words of MQTT 3.1.1 and of MQTT 5


class BrokerLink:
    """Keeps one client connected for as long as it runs."""

    def __init__(
        self,
        settings: Broker,
        name: ClientName,
        will: Will,
        uniform: Callable[[float, float], float],
    ) -> None:
        self._settings, self._place = settings, f"{settings.host}:{settings.port}"
        self._name = name
        self._will = will
        self._uniform = uniform
        self._failures = 0
        self._since_s = math.inf
        self._problem = ""

    async def run(self, serve: Serve) -> NoReturn:
        """Connect, serve until the connection is lost, wait, and so on until cancelled.

        Args:
            serve: Called with each client that is connected.
        """
        while True:
            name = self._name.present
            try:
                await _contained(self._serve_once(serve))
            except* Exception as problems:  # noqa: BLE001 - control continues without a broker
                self._report(first_error(problems))
            lived_s = max(0.0, asyncio.get_running_loop().time() - self._since_s)
            if self._name.present != name:  # the broker is there, and a stop must arrive
                lived_s = math.inf
            await asyncio.sleep(self.pause_s(lived_s))

    def pause_s(self, lived_s: float) -> float:
        """Return the wait after a connection that lived so long, 0 for one that failed, in s.

        It doubles with each failure up to its longest, and is spread so that a site does not surge.
        """
        if lived_s >= _HEALTHY_S:
            self._failures = 0
        ceiling_s = min(_LONGEST_PAUSE_S, _FIRST_PAUSE_S * 2.0 ** min(self._failures, 30))
        self._failures += 1
        return self._uniform(0.5 * ceiling_s, ceiling_s)

    async def _serve_once(self, serve: Serve) -> None:
        self._since_s = math.inf
        name, protocol = self._name.present, await self._agree()
        async with connection(self._settings, protocol, name, self._will) as client:
            self._since_s = asyncio.get_running_loop().time()
            self._problem = ""
            place = self._place
            write_line("info", "broker connected", broker=place, protocol=protocol.name, name=name)
            try:
                await serve(client)
            finally:
                self._name.connection_ended(client)

    async def _agree(self) -> ProtocolVersion:
        """Find the newest protocol of the broker.

        It is asked without a last will: brokers of only the older protocol take the will
        of the newer one for garbage and hang up, instead of naming the reason. The name has a
        letter that no drive's has: a broker would end the connection of a drive of that name.
        """
        probe = f"{self._name.present}.probe"
        try:
            async with connection(self._settings, ProtocolVersion.V5, probe):
                return ProtocolVersion.V5
        except MqttConnectError as refusal:
            code = refusal.rc.value if isinstance(refusal.rc, ReasonCode) else refusal.rc
            if code not in _UNSUPPORTED_PROTOCOL:
                raise
            return ProtocolVersion.V311

    def _report(self, problem: BaseException) -> None:
        expected = isinstance(problem, MqttError | OSError) and str(problem)
        text = str(problem) if expected else f"{type(problem).__name__}: {problem}"
        if text != self._problem:
            self._problem = text
            write_line("warning", "broker lost", broker=self._place, problem=text)


@asynccontextmanager
async def connection(
    settings: Broker,
    protocol: ProtocolVersion,
    identifier: str | None = None,
    will: Will | None = None,
    timeout_s: float = math.inf,
) -> AsyncIterator[SteadyClient]:
    """One connection to a broker, closed at the end whatever state it is in.

    It ends with a DISCONNECT unless an error ends it: then the broker sends the last will.

    Args:
        settings: Address of the broker, and login.
        protocol: MQTT version.
        identifier: Client identifier, None for a random one.
        will: Message that the broker publishes when the connection breaks.
        timeout_s: Longest wait for the broker, where that is shorter than the usual one.

    Raises:
        MqttError: The broker cannot be reached or refuses.
        OSError: The password or a certificate cannot be read.
    """
    timeout_s = min(TIMEOUT_S, timeout_s)
    await _find_host(settings, timeout_s)
    password, tls = await asyncio.to_thread(_secrets, settings)
    client = SteadyClient(
        settings.host,
        settings.port,
        username=settings.username,
        password=password,
        tls_context=tls,
        identifier=identifier,
        will=will,
        protocol=protocol,
        timeout=timeout_s,
        keepalive=KEEP_ALIVE_S,
    )
    try:
        # a cancelled attempt is waited for, as its thread cannot be stopped
        await _contained(client.__aenter__(), client.cancel_connecting)
        try:
            yield client
        except asyncio.CancelledError:
            await _disconnect(client)
            raise
        await _disconnect(client)
    finally:
        await client.release()


async def _find_host(settings: Broker, timeout_s: float) -> None:
    """Look the broker's host up, so that the thread that connects need not wait for a name server.

    Raises:
        MqttError: There is no such host, or no name server answers.
    """
    try:
        await clock.find(settings.host, settings.port, timeout_s)
    except (OSError, ValueError) as problem:
        raise MqttError(str(problem)) from problem


def _secrets(settings: Broker) -> tuple[str | None, ssl.SSLContext | None]:
    password = _read_password(settings.password_file) if settings.password_file else None
    return password, _tls(settings.ca_file) if settings.tls else None


def _read_password(path: Path) -> str:
    try:
        return files.read_regular(path, _LONGEST_PASSWORD).decode("utf-8").rstrip("\r\n")
    except UnicodeDecodeError as problem:
        raise OSError(f"password file {path} is not text: {problem}") from problem


def _tls(ca_file: Path | None) -> ssl.SSLContext:
    """Return a context that trusts the authority of a file, or those of the machine."""
    if ca_file is None:
        return ssl.create_default_context()
    # comments between certificates may be in any encoding; what counts is ASCII
    certificates = files.read_regular(ca_file).decode("ascii", errors="ignore")
    if "-----BEGIN" not in certificates:  # an empty text would mean the machine's authorities
        raise OSError(f"ca_file {ca_file} contains no certificate")
    try:
        return ssl.create_default_context(cadata=certificates)
    except ssl.SSLError as problem:
        raise OSError(f"ca_file {ca_file} cannot be used: {problem}") from problem


async def _disconnect(client: Client) -> None:
    with suppress(MqttError, TimeoutError):
        async with asyncio.timeout(DISCONNECT_S):
            await client.__aexit__(None, None, None)


async def _contained(
    work: Coroutine[Any, Any, object], cancel: Callable[[], object] | None = None
) -> None:
    """Await work in a separate task, so that a cancellation is never lost.

    A task group that fails while it is being cancelled reports the failure only.

    Args:
        work: What is awaited.
        cancel: Ends it early, at a cancellation; None to cancel it.
    """
    task = asyncio.create_task(work)
    try:
        await asyncio.wait([task])
    except asyncio.CancelledError:
        (cancel or task.cancel)()
        await asyncio.wait([task])
        if not task.cancelled():
            task.exception()
        raise
    task.result()
