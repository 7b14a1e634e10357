"""What the benchmarks with processes share: raw frames, real-time processes, the kernel's books."""

from __future__ import annotations

import json
import os
import socket
import struct
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import msgpack
from can.interfaces.udp_multicast.utils import pack_message

from adaptdrive.app.process import NAMESPACE
from tools.benchmarks.frames import status_frames

ROOT = Path(__file__).parents[2]
GROUP = "239.74.163.2"
COMMAND_ID = 0x080
PRIORITY = 50
ECHO = b"E"
"""What an echo puts before the frame that it answers."""

PATHS = (os.environ.get("PYTHONPATH", ""), f"{ROOT}/src", f"{ROOT}/simulators", str(ROOT))
BUSY = {
    NAMESPACE: f"benchmarks-{os.getpid()}",  # daemons of another run are not these
    **os.environ,
    "PYTHONPATH": ":".join(filter(None, PATHS)),
}


def packed_frames(count: int, *, bridge: bool) -> list[tuple[bytes, bytes]]:
    """Datagrams of so many half cycles, as python-can puts them on the bus.

    Args:
        count: Half cycles.
        bridge: What the drive reports of its bridge: as it is commanded, or it is not driven.
    """
    pairs = status_frames(count, 0 if bridge else count)
    return [(pack_message(one), pack_message(other)) for one, other in pairs]


def commanded_bridge(datagram: bytes) -> bool | None:
    """The bridge that a command asks for, None for any other frame and for an echo."""
    if datagram.startswith(ECHO):
        return None
    content = msgpack.unpackb(datagram)
    return bool(content["data"][4] & 1) if content["arbitration_id"] == COMMAND_ID else None


def is_command(datagram: bytes) -> bool:
    """Whether a datagram is a command frame."""
    return bool(msgpack.unpackb(datagram)["arbitration_id"] == COMMAND_ID)


def bus_socket(port: int) -> socket.socket:
    """A bare socket on the bus, on the loopback interface only."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    loopback = socket.inet_aton("127.0.0.1")
    sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, loopback)
    sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
    sock.bind((GROUP, port))
    membership = struct.pack("4s4s", socket.inet_aton(GROUP), loopback)
    sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
    return sock


def bus_ports(count: int) -> list[int]:
    """Ports for so many buses, no two of them the same."""
    with ExitStack() as stack:
        probes = [
            stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            for _ in range(count)
        ]
        for probe in probes:
            probe.bind(("127.0.0.1", 0))
        return [int(probe.getsockname()[1]) for probe in probes]


def try_fifo(priority: int) -> bool:
    """Real-time scheduling for this process, where it is granted."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except PermissionError:
        return False
    return True


def cpu_s(pid: int) -> float:
    """CPU time that all threads of a process have used."""
    threads = Path(f"/proc/{pid}/task").glob("*/schedstat")
    return 1e-9 * sum(int(one.read_text(encoding="ascii").split()[0]) for one in threads)


def run_json(module: str, *words: object) -> dict[str, list[float]]:
    """Run a module in a process of its own; what it prints is JSON."""
    command = [sys.executable, "-m", module, *map(str, words)]
    run = subprocess.run(command, check=False, capture_output=True, text=True, env=BUSY)
    if run.returncode != 0:
        raise RuntimeError(run.stderr)
    found = json.loads(run.stdout)
    assert isinstance(found, dict)
    return found


@contextmanager
def process(command: Sequence[str | Path], **options: object) -> Iterator[subprocess.Popen[bytes]]:
    """A process that ends with the block."""
    started = subprocess.Popen(command, **{"env": BUSY, **options})  # type: ignore[call-overload]
    try:
        yield started
    finally:
        started.terminate()
        try:
            started.wait(10.0)
        except subprocess.TimeoutExpired:
            started.kill()
            started.wait()
