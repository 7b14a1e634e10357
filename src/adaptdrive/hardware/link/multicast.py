"""python-can's multicast bus, confined to the loopback interface and quick.

A daemon reads what waits and sends at once, on a socket that is known to be open. That takes one
system call for each frame, in place of python-can's general way, which can wait, filter and log.
Cold, as after each sleep between two half cycles, that way takes tens of microseconds.

The group returns every frame to its sender. Frames go out through a separate socket, whose port
no other socket has: it marks the frames of this bus among those of another sender with their id.
"""

from __future__ import annotations

import contextlib
import os
import socket
import struct

import can
from can.interfaces.udp_multicast import UdpMulticastBus
from can.interfaces.udp_multicast.utils import pack_message, unpack_message

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
    """Hear and send on the loopback interface only, and that group only.

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
