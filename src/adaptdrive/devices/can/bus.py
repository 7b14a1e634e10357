"""CAN buses through python-can: a kernel interface, multicast on loopback, or in-process.

A daemon reads what waits and sends at once, on a socket that is known to be open. That takes one
system call for each frame, in place of python-can's general way, which can wait, filter and log.
Cold, as after each sleep between two half cycles, that way takes tens of microseconds.

The group returns every frame to its sender. Frames go out through a separate socket, whose port
no other socket has: it marks the frames of this bus among those of another sender with their id.

`udp_multicast` stands in for a kernel interface between processes of one machine. Its frames stay
on the loopback interface: a drive must not be commanded by, nor shown to, the network.
"""

import contextlib
import errno
import fcntl
import ipaddress
import os
import socket
import struct
from collections.abc import Iterable, Iterator
from pathlib import Path

import can
from can.interfaces.udp_multicast import UdpMulticastBus
from can.interfaces.udp_multicast.utils import pack_message, unpack_message

from adaptdrive.config.bus import CanDescription, CanLink
from adaptdrive.devices.can.codec import MessageCodec
from adaptdrive.util.errors import BusError, Flaw

# python-can's multicast bus, confined to the loopback interface and quick.

_IP_MULTICAST_ALL = 49
"""Linux: whether a socket receives groups that other sockets of the machine have joined."""

_LARGEST = 4096
"""Bytes of a datagram that are read: many times a packed CAN FD frame, whose data are 64 bytes."""

_TIMESPEC = struct.Struct("@ll")
_ANCILLARY = socket.CMSG_SPACE(_TIMESPEC.size)


class LoopbackMulticast(UdpMulticastBus):
    """A group on the loopback interface; python-can's own buses are peers if they send there."""

    def __init__(self, group: str, port: int, *, fd: bool) -> None:
        """Join a group; call `shutdown()` at the end.

        Args:
            group: An IPv4 multicast group.
            port: UDP port.
            fd: Whether frames of CAN FD may be sent.

        Raises:
            CanError: The socket cannot be opened.
            OSError: The loopback interface cannot be used.
        """
        super().__init__(group, port=port, hop_limit=0, fd=fd)
        self._destination = (group, port)
        self._socket = socket.socket(fileno=os.dup(self.fileno()))
        self._sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            confine_to_loopback(self._socket, group)
            self._own_address = _bind_sender(self._sender)
        except OSError:
            self.shutdown()
            raise

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the next frame, None when none arrives within `timeout` seconds.

        Without a wait (`timeout` 0), frames of this bus itself are left out.

        Raises:
            CanOperationError: The bus is lost; or, with what is wrong as its cause, something came
                that is no frame.
        """
        if timeout != 0.0:
            return super().recv(timeout)
        try:
            received = self._socket.recvmsg(_LARGEST, _ANCILLARY, socket.MSG_DONTWAIT)
            while received[3] == self._own_address:
                received = self._socket.recvmsg(_LARGEST, _ANCILLARY, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return None
        seconds, nanoseconds = _TIMESPEC.unpack(received[1][0][2])
        return parse(received[0], seconds + nanoseconds * 1e-9)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002 - as in the base class
        """Send a frame at once.

        Raises:
            OSError: The bus does not take it.
            CanError: It is a frame of CAN FD on a bus that is not.
        """
        if msg.is_fd and self.protocol is not can.CanProtocol.CAN_FD:
            raise can.CanOperationError("the bus is not one of CAN FD")
        self._sender.sendto(pack_message(msg), socket.MSG_DONTWAIT, self._destination)

    def shutdown(self) -> None:
        """Leave the group."""
        self._socket.close()
        self._sender.close()
        super().shutdown()


def parse(datagram: bytes, timestamp_s: float) -> can.Message:
    """The frame in a datagram.

    Raises:
        CanOperationError: There is none in it; what is wrong is the error's cause.
    """
    try:
        frame = unpack_message(datagram, {"timestamp": timestamp_s}, check=True)
    except Exception as problem:
        raise can.CanOperationError("not a frame") from problem
    if {type(frame.arbitration_id), type(frame.dlc)} != {int}:
        raise can.CanOperationError("not a frame") from TypeError("its id or length is no integer")
    return frame


def confine_to_loopback(sock: socket.socket, group: str) -> None:
    """Receive and send on the loopback interface only, and that group only.

    Raises:
        OSError: The kernel refuses.
    """
    address, loopback = socket.inet_aton(group), socket.inet_aton("127.0.0.1")
    default = socket.inet_aton("0.0.0.0")  # noqa: S104 - names the membership to give up
    with contextlib.suppress(PermissionError):  # kernels before 5.7 ask for a capability
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, b"lo\0")
    sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, loopback)
    sock.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)
    # in this order: the default interface may be loopback itself
    sock.setsockopt(socket.IPPROTO_IP, socket.IP_DROP_MEMBERSHIP, address + default)
    sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, address + loopback)


def _bind_sender(sock: socket.socket) -> tuple[str, int]:
    """Have a socket send on the loopback interface only, from a separate port; its address.

    Raises:
        OSError: The kernel refuses.
    """
    sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
    sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
    sock.bind(("127.0.0.1", 0))
    host, port = sock.getsockname()
    return host, port


# Opening a CAN bus through python-can: a kernel interface, multicast on loopback, or in-process.

_SIOCGIFFLAGS = 0x8913
_IFF_UP = 0x1
_IFNAMSIZ = 16

_REQUEST = 0x18EA0000
"""Id of a request of J1939, of priority 6, without its addresses (SAE J1939-21, PGN 59904)."""

_EVERYBODY, _NOBODY, _SERVICE_TOOL = 0xFF, 0xFE, 0xF9
"""The global address of J1939, and that of a sender without one."""

_INTERFACES = Path("/sys/class/net")


def describe_bus(config: CanLink) -> str:
    """The bus in one phrase, such as `udp_multicast 239.74.163.2:43113`."""
    port = f":{config.udp_port}" if config.interface == "udp_multicast" else ""
    return f"{config.interface} {config.channel}{port}"


def channel_flaws(config: CanLink, bus: str = "bus") -> list[Flaw]:
    """Return the errors in the channel that can be detected without opening it."""
    place, channel = f"{bus}.channel", config.channel
    if config.interface == "udp_multicast" and not _is_group(channel):
        example = "an IPv4 multicast group such as 239.74.163.2"
        return [Flaw(place, f"udp_multicast needs {example} (it is {channel!r})")]
    if config.interface == "socketcan" and not 0 < len(channel.encode()) < _IFNAMSIZ:
        return [Flaw(place, f"socketcan needs an interface such as can0 (it is {channel!r})")]
    return []


def open_bus(config: CanLink, listen: Iterable[int] = ()) -> can.BusABC:
    """Open a bus; the caller must call its `shutdown()`.

    Args:
        config: Which bus.
        listen: Frame ids to receive, all when empty. A kernel interface then keeps other
            frames away from the process; other buses ignore it.

    Raises:
        BusError: The bus cannot be opened.
    """
    try:
        if config.interface == "socketcan":
            return _open_socketcan(config, listen)
        if config.interface == "udp_multicast":
            return LoopbackMulticast(config.channel, config.udp_port, fd=_has_fd(config))
        protocol = can.CanProtocol.CAN_FD if _has_fd(config) else can.CanProtocol.CAN_20
        return can.Bus(
            interface="virtual", channel=config.channel, protocol=protocol, ignore_config=True
        )
    except (can.CanError, OSError, ValueError) as problem:
        raise BusError(describe_bus(config), str(problem)) from problem


def missing_here(config: CanLink) -> str:
    """Return why a kernel's interface cannot be opened on this machine, empty where it can."""
    problem = next(_obstacles(config), None) if config.interface == "socketcan" else None
    return str(BusError(describe_bus(config), problem)) if problem else ""


def requests(bus: CanDescription, codecs: Iterable[MessageCodec]) -> list[can.Message]:
    """Return the frames that ask for those messages of a bus that come only when asked.

    Args:
        bus: The bus.
        codecs: Messages that are read.
    """
    return [
        _request(one, remote=bus.polled[one.name] == "rtr")
        for one in codecs
        if one.name in bus.polled
    ]


def _request(codec: MessageCodec, *, remote: bool) -> can.Message:
    """Return a remote frame, or a request of J1939 from the address that the reply goes to."""
    if remote:
        frame = codec.frame(b"")
        frame.is_remote_frame, frame.dlc = True, codec.length
        return frame
    own = _SERVICE_TOOL
    group, sender = codec.frame_id >> 8 & 0x3FFFF, codec.frame_id & 0xFF
    if group & 0xFF00 < 0xF000:  # its last byte is the receiver
        group, receiver = group & ~0xFF, group & 0xFF
        own = own if receiver == _EVERYBODY else receiver
    to = _EVERYBODY if sender == _NOBODY else sender
    return can.Message(arbitration_id=_REQUEST | to << 8 | own, data=group.to_bytes(3, "little"))


def _has_fd(config: CanLink) -> bool:
    """Return whether the bus carries CAN FD frames; CANopen's are classic."""
    return isinstance(config, CanDescription) and config.fd


def _is_group(channel: str) -> bool:
    try:
        return ipaddress.IPv4Address(channel).is_multicast
    except ValueError:
        return False


def _open_socketcan(config: CanLink, listen: Iterable[int]) -> can.BusABC:
    for problem in _obstacles(config):
        raise BusError(describe_bus(config), problem)
    filters = [_filter(key) for key in listen]
    return can.Bus(
        interface="socketcan",
        channel=config.channel,
        fd=_has_fd(config),
        can_filters=filters or None,
        ignore_config=True,
    )


def _filter(key: int) -> can.typechecking.CanFilter:
    extended = bool(key & socket.CAN_EFF_FLAG)
    mask = socket.CAN_EFF_MASK if extended else socket.CAN_SFF_MASK
    return {"can_id": key & mask, "can_mask": mask, "extended": extended}


def _obstacles(config: CanLink) -> Iterator[str]:
    """Yield why a kernel's interface cannot be used.

    One that is down can be opened, and carries nothing. So can one whose controller is bus-off: it
    has no carrier until it restarts.
    """
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError as problem:
        if problem.errno not in {errno.EAFNOSUPPORT, errno.EPROTONOSUPPORT}:
            raise
        yield (
            "this kernel has no AF_CAN; an adapter needs a kernel with CAN (modprobe can); for a "
            "simulated drive use udp_multicast"
        )
    request = struct.pack("16sh14x", config.channel.encode(), 0)
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            answer = fcntl.ioctl(probe, _SIOCGIFFLAGS, request)
    except OSError:
        yield "there is no such interface; connect the adapter, or load its driver"
    else:
        if not struct.unpack_from("h", answer, _IFNAMSIZ)[0] & _IFF_UP:
            yield f"the interface is down; try: ip link set {config.channel} up"
    with contextlib.suppress(OSError):
        carrier = (_INTERFACES / config.channel / "carrier").read_text(encoding="ascii")
        if carrier.strip() == "0":
            advice = f"ip link set {config.channel} type can restart-ms 100"
            yield f"the controller is bus-off; to have it come back by itself: {advice}"
