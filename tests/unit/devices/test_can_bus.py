import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

import can
import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.config.bus import CanBus
from adaptdrive.devices.can.bus import _obstacles, open_bus, parse
from adaptdrive.devices.can.codec import frame_key
from adaptdrive.util.errors import BusError
from tests.support import has_can
from tests.unit.devices.bench import motor_bus

FRAME = can.Message(arbitration_id=0x321, is_extended_id=False, data=b"hello")


@contextmanager
def opened(config: CanBus) -> Iterator[can.BusABC]:
    bus = open_bus(config)
    try:
        yield bus
    finally:
        bus.shutdown()


def on_port(port: int, channel: str = "239.74.163.2") -> CanBus:
    return motor_bus(interface="udp_multicast", channel=channel, udp_port=port)


def test_two_buses_of_a_group_hear_each_other(free_udp_port: int) -> None:
    with opened(on_port(free_udp_port)) as one, opened(on_port(free_udp_port)) as other:
        one.send(FRAME)
        heard = other.recv(5.0)
    assert heard is not None
    assert (heard.arbitration_id, bytes(heard.data)) == (0x321, b"hello")


def test_another_group_on_the_same_port_is_not_heard(free_udp_port: int) -> None:
    group, stranger = on_port(free_udp_port), on_port(free_udp_port, "239.74.163.3")
    with opened(group) as one, opened(group) as two, opened(stranger) as other:
        other.send(FRAME)
        assert other.recv(5.0) is not None  # its own echo: it has been sent
        one.send(FRAME)
        assert two.recv(5.0) is not None
        assert two.recv(0.05) is None


def test_frames_leave_through_loopback_only(free_udp_port: int) -> None:
    with opened(on_port(free_udp_port)) as bus:
        sock = socket.socket(fileno=socket.dup(bus.fileno()))
        with closing(sock):
            loopback = sock.getsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, 4)
            assert loopback == socket.inet_aton("127.0.0.1")
            assert sock.getsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL) == 0


def test_only_loopback_has_joined_the_group(free_udp_port: int) -> None:
    # /proc/net/igmp: a line per interface, below it the groups in hexadecimal
    group = "239.99.88.77"
    with opened(on_port(free_udp_port, group)):
        joined = interfaces_of(group)
    assert joined == {"lo"}


ALONE = ["unshare", "--map-root-user", "--net", "sh", "-c"]
HEARS = "test_two_buses_of_a_group_hear_each_other"


@pytest.mark.proof
@pytest.mark.usefixtures("outside")
def test_frames_are_heard_where_multicast_is_routed_through_loopback() -> None:
    """A machine of its own, whose default interface of the group is loopback itself."""
    route = "ip link set lo up && ip route add 224.0.0.0/4 dev lo"
    if subprocess.run([*ALONE, route], check=False, capture_output=True).returncode:
        pytest.skip("needs unshare, ip and user namespaces")
    hears = f"{sys.executable} -m pytest -q -p no:cacheprovider {__file__} -k {HEARS}"
    run = subprocess.run(
        [*ALONE, f"{route} && {hears}"], check=False, capture_output=True, text=True
    )
    assert run.returncode == 0, run.stdout


def interfaces_of(group: str) -> set[str]:
    code = socket.inet_aton(group)[::-1].hex().upper()
    found, interface = set(), ""
    with Path("/proc/net/igmp").open(encoding="ascii") as lines:
        for line in lines:
            words = line.split()
            if words[0].isdigit():
                interface = words[1].rstrip(":")
            elif words[0] == code:
                found.add(interface)
    return found


def test_an_interface_that_is_not_there_is_one_clear_error() -> None:
    config = motor_bus(interface="socketcan", channel="nosuchcan0")
    with pytest.raises(
        BusError,
        match=r"socketcan nosuchcan0: (this kernel has no AF_CAN; .* use udp_multicast"
        r"|there is no such interface; connect the adapter, or load its driver)$",
    ):
        open_bus(config)


@pytest.mark.skipif(has_can(), reason="this kernel has AF_CAN")
def test_a_kernel_without_can_is_named() -> None:
    with pytest.raises(BusError, match=r"has no AF_CAN; .*modprobe can.* use udp_multicast"):
        open_bus(motor_bus(interface="socketcan", channel="can0"))


def test_a_port_that_is_taken_is_a_bus_error(free_udp_port: int) -> None:
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as holder:
        holder.bind(("0.0.0.0", free_udp_port))
        with pytest.raises(BusError, match=f"udp_multicast 239.74.163.2:{free_udp_port}: "):
            open_bus(on_port(free_udp_port))


def test_an_extended_id_never_equals_a_standard_one() -> None:
    assert frame_key(0x100, extended=False) != frame_key(0x100, extended=True)


def test_a_controller_that_is_bus_off_is_not_opened(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "can7").mkdir()
    monkeypatch.setattr("adaptdrive.devices.can.bus._INTERFACES", tmp_path)
    config = motor_bus(interface="socketcan", channel="can7")
    others = list(_obstacles(config))  # no such file: nothing is known
    carrier = tmp_path / "can7" / "carrier"
    carrier.write_text("1\n")
    assert list(_obstacles(config)) == others
    carrier.write_text("0\n")
    *before, found = _obstacles(config)
    assert before == others
    assert "can7 type can restart-ms" in found


ANYTHING = st.none() | st.booleans() | st.integers(-9, 9) | st.floats() | st.binary(max_size=9)
FIELDS = ("arbitration_id", "is_extended_id", "is_error_frame", "is_remote_frame", "dlc", "data")


@given(st.dictionaries(st.sampled_from(FIELDS), ANYTHING | st.text(max_size=3)))
def test_what_a_datagram_holds_is_a_frame_or_refused(odd: dict[str, object]) -> None:
    whole = {"arbitration_id": 256, "is_extended_id": False, "dlc": 2, "data": b"ab"}
    with suppress(can.CanOperationError):
        frame = parse(msgpack.packb(whole | odd), 1.0)
        assert 0 <= frame_key(frame.arbitration_id, extended=frame.is_extended_id) < 1 << 32
        assert len(frame.data) == frame.dlc or frame.is_remote_frame
