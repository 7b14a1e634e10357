"""Opening a Modbus link through pymodbus: TCP, or RTU on a serial port."""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import logging
import socket
import struct
import sys
import termios
from collections.abc import Callable
from functools import partial

from pymodbus import FramerType
from pymodbus.client import AsyncModbusSerialClient, AsyncModbusTcpClient
from pymodbus.pdu import ModbusPDU

from adaptdrive.config.modbus import ModbusLink, RtuLink, TcpLink
from adaptdrive.errors import BusError
from adaptdrive.hardware.modbus.serial_port import PATIENCE_S, SerialPort
from adaptdrive.hosts import find

Client = AsyncModbusTcpClient | AsyncModbusSerialClient
Trace = Callable[[bool, bytes], bytes]
Decode = Callable[[bytes, int, int], tuple[int, ModbusPDU | None]]

_CONNECT_S = 1.0
"""Longest time to connect: a gateway may be slower to accept than a drive is to answer."""

_SINGLE = (b"\x05", b"\x06")
"""Functions whose reply repeats the request."""

_LINGER = struct.Struct("ii")
"""Linux's `struct linger`: whether it applies, and for how many seconds."""

_COUNT = struct.Struct("i")
"""Answer of the kernel to how much a connection still holds."""


def describe_bus(config: ModbusLink) -> str:
    """The link in one phrase, such as `modbus-rtu /dev/ttyUSB0 9600 8E1 device 1`."""
    return f"{_medium(config)} device {config.device_id}"


async def open_client(
    config: TcpLink | RtuLink, trace: Trace, serial: SerialPort | None = None
) -> Client:
    """Connect; the caller must close the client.

    Args:
        config: Which link.
        trace: Sees every packet: whether it is sent, and its bytes as far as they have come.
        serial: Port of a serial link, which whoever opens the link again must keep.

    Raises:
        BusError: There is no connection.
    """
    problem = BusError(describe_bus(config), "it has no address")
    for one in await _addressed(config):
        try:
            return await _connected(unconnected_client(one, trace, serial), config)
        except BusError as failure:
            problem = failure
    raise problem


async def _addressed(config: TcpLink | RtuLink) -> list[TcpLink | RtuLink]:
    """Return the link with each address of its host.

    Raises:
        BusError: Its name has none, or no name server answers in time.
    """
    if isinstance(config, RtuLink):
        return [config]
    try:
        addresses = await find(config.host, config.port, _CONNECT_S)
    except (OSError, ValueError) as problem:
        raise BusError(describe_bus(config), str(problem)) from problem
    return [config.model_copy(update={"host": address}) for address in addresses]


async def _connected(client: Client, config: TcpLink | RtuLink) -> Client:
    """Connect a client to its address of a link.

    Raises:
        BusError: There is no connection.
    """
    try:
        connected = await client.connect()
    except termios.error as problem:
        advice = f"the serial port does not take these settings: {problem.args[-1]}"
        raise BusError(describe_bus(config), advice) from problem
    except (OSError, ValueError) as problem:
        raise BusError(describe_bus(config), str(problem)) from problem
    if not connected:
        client.close()
        raise BusError(describe_bus(config), _why_not(config))
    if not is_connected(client):
        client.close()
        raise BusError(describe_bus(config), "the device closed the connection at once")
    client.ctx.comm_params.timeout_connect = config.timeout_s  # of replies too, from now on
    return client


def is_connected(client: Client) -> bool:
    """Return whether a client has a connection that has not ended.

    pymodbus alone does not say so: it keeps a connection that ended before its `connect` was over.
    """
    return client.connected and not client.ctx.transport.is_closing()


def drop_unsent(client: Client, *, drop: bool) -> None:
    """Choose what becomes of requests that the device has not received, as `drop_unsent_on` does.

    Args:
        client: A connected client; a serial line keeps nothing.
        drop: Whether they are dropped.
    """
    if is_connected(client):
        drop_unsent_on(client.ctx.transport, drop=drop)


def drop_unsent_on(transport: asyncio.BaseTransport, *, drop: bool) -> None:
    """Choose what becomes of requests that the device has not received when a link is closed.

    The kernel sends them for minutes after the end of the connection, and even of the process: a
    command would reach the drive after the safe command that took its place on another connection.

    Args:
        transport: Of the connection.
        drop: Whether they are dropped, and the connection is reset.
    """
    link = transport.get_extra_info("socket")
    if link is None:
        return
    with contextlib.suppress(OSError):  # a connection that has just ended keeps nothing either
        link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _LINGER.pack(drop, 0))


def undelivered_bytes(client: Client) -> int:
    """Return how much of what was sent on TCP has not reached the device's end of the connection.

    Args:
        client: A client; a serial line keeps nothing.
    """
    link = client.ctx.transport.get_extra_info("socket") if is_connected(client) else None
    if link is None:
        return 0
    with contextlib.suppress(OSError):  # a connection that has just ended
        queued = fcntl.ioctl(link.fileno(), termios.TIOCOUTQ, bytes(_COUNT.size))
        return int(_COUNT.unpack(queued)[0])
    return 0


def unconnected_client(
    config: TcpLink | RtuLink, trace: Trace, serial: SerialPort | None = None
) -> Client:
    """Return a client of a link, which is not connected yet.

    Args:
        config: Which link.
        trace: Sees every packet.
        serial: Port of a serial link, None for a new one.
    """
    # a reply that is missing is counted; a line in the log each time would wear out the disk
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)
    echo = _Echo(trace)
    client = _client(config, echo.trace, serial)
    framer = client.ctx.framer
    decode = framer.handleFrame if config.numbered else echo.skipped(framer.handleFrame)
    vars(framer)["handleFrame"] = _without_errors(decode)
    # pymodbus closes after five missing replies, were it one of many devices: the link judges that
    client.ctx.max_until_disconnect = client.ctx.count_until_disconnect = sys.maxsize
    return client


class _Echo:
    """The request as a line repeats it: an adapter of two wires hears what it sends.

    The request for one register from 0x300 to 0x3FF is, byte for byte, also a reply of three bytes.
    The reply to a single write (functions 5 and 6) repeats its request: what came for another
    request shows whether the line repeats it, too.
    """

    def __init__(self, trace: Trace) -> None:
        self._trace = trace
        self._sent = b""
        self._echoes = False

    def trace(self, sending: bool, packet: bytes) -> bytes:
        """Keep what is sent, and let the owner see every packet."""
        if sending:
            self._sent = packet
        return self._trace(sending, packet)

    def skipped(self, decode: Decode) -> Decode:
        """Return a decoder that passes over the request before a reply."""

        def decoded(data: bytes, device_id: int, transaction: int) -> tuple[int, ModbusPDU | None]:
            echoed, single = data.startswith(self._sent), self._sent[1:2] in _SINGLE
            start = len(self._sent) if echoed and (self._echoes or not single) else 0
            used, reply = decode(data[start:], device_id, transaction)
            if reply is None and not start and self._sent.startswith(data):
                return 0, None  # the begin of a request that comes in pieces is no noise
            if reply is not None and not single:
                self._echoes = start > 0
            return start + used, reply

        return decoded


def _without_errors(decode: Decode) -> Decode:
    """Return a decoder for which bytes that it cannot decode are noise, and no reply.

    pymodbus raises for them where the event loop calls it: that would end the daemon.
    """

    def decoded(data: bytes, device_id: int, transaction: int) -> tuple[int, ModbusPDU | None]:
        try:
            return decode(data, device_id, transaction)
        except Exception:  # noqa: BLE001 - of many kinds, by what the bytes are
            return len(data), None

    return decoded


def _client(config: TcpLink | RtuLink, trace: Trace, serial: SerialPort | None) -> Client:
    if isinstance(config, TcpLink):
        return AsyncModbusTcpClient(
            config.host,
            port=config.port,
            timeout=_CONNECT_S,
            retries=0,
            reconnect_delay=0,
            trace_packet=trace,
            framer=FramerType.SOCKET if config.numbered else FramerType.RTU,
        )
    client = AsyncModbusSerialClient(
        str(config.device),
        timeout=2.0 * PATIENCE_S,  # the port gives up first
        retries=0,
        reconnect_delay=0,
        trace_packet=trace,
    )
    port = SerialPort(config) if serial is None else serial
    client.ctx.call_create = partial(_open_serial, port, config, client.ctx)
    return client


async def _open_serial(
    port: SerialPort, config: RtuLink, protocol: asyncio.BaseProtocol
) -> tuple[asyncio.BaseTransport, asyncio.BaseProtocol]:
    """Open a serial port for pymodbus, which would keep back why it hangs.

    Raises:
        BusError: It does not open in time.
        OSError: It cannot be opened.
    """
    try:
        return await port.open(protocol)
    except TimeoutError as problem:
        raise BusError(describe_bus(config), str(problem)) from problem


def _medium(config: ModbusLink) -> str:
    if isinstance(config, TcpLink):
        return f"modbus-tcp {config.host}:{config.port}"
    if isinstance(config, RtuLink):
        form = f"8{config.parity[0].upper()}{config.stop_bits}"
        return f"modbus-rtu {config.device} {config.baud} {form}"
    return "modbus"


def _why_not(config: TcpLink | RtuLink) -> str:
    if isinstance(config, TcpLink):
        return "no connection: refused, or no reply"
    if not config.device.exists():
        return "there is no such serial port"
    return "the serial port cannot be opened: no permission, or another process uses it"
