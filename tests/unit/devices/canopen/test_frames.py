"""Whatever comes over the bus, the port neither dies nor believes it."""

from __future__ import annotations

import math

import can
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.devices.canopen import port as canopen_port
from adaptdrive.devices.canopen.mapping import map_drive
from adaptdrive.safety.timing import timing_of
from tests.unit.devices.bench import Clock
from tests.unit.devices.canopen.bench import RUN, Ear
from tests.unit.devices.canopen.documents import bus_of, parse

IDS = [0x000, 0x080, 0x085, 0x185, 0x285, 0x205, 0x585, 0x605, 0x705, 0x77F, 0x123]

frames = st.builds(
    can.Message,
    arbitration_id=st.sampled_from(IDS),
    is_extended_id=st.booleans(),
    is_remote_frame=st.just(value=False),
    is_error_frame=st.booleans(),
    data=st.binary(max_size=8),
)


def ready_port() -> tuple[canopen_port.Port, Ear]:
    """A port whose node is up, without a bus."""
    configuration = parse({"bus/interface": "virtual"})
    bus = bus_of(configuration)
    port = canopen_port.Port(
        bus, map_drive(bus, configuration.signals), timing_of(configuration), Clock()
    )
    ear = Ear()
    port._connection.listener = ear
    port._master.ready = True
    return port, ear


@given(st.lists(frames, max_size=30))
def test_no_frame_ends_the_port_or_becomes_a_value_out_of_range(story: list[can.Message]) -> None:
    port, ear = ready_port()
    for frame in story:
        port.take(frame)
        port.catch_up()
        port.hand_out()
        port.send(RUN)
    for reading in ear.readings:
        assert math.isfinite(reading.output)
        assert 0.0 <= reading.boost_voltage_V <= 0xFFFFFFFF * 1e-3
    counts = port.statistics
    assert counts.received <= len(story)
    assert counts.foreign + counts.wrong_length <= counts.received


@given(st.lists(st.sampled_from([0x185, 0x285, 0x080]), max_size=40))
def test_a_reading_never_mixes_two_syncs(story: list[int]) -> None:
    """Each PDO carries the number of its SYNC; both of a reading carry the same."""
    port, ear = ready_port()
    number = 0
    for can_id in story:
        if can_id == 0x080:
            number += 1
            port._reports.begin(0.0)
            continue
        data = {
            0x185: bytes.fromhex("4002") + number.to_bytes(4, "little") + bytes(2),
            0x285: number.to_bytes(4, "little") + bytes(4),
        }[can_id]
        port.take(can.Message(arbitration_id=can_id, is_extended_id=False, data=data))
        port.hand_out()
    for reading in ear.readings:
        assert reading.boost_voltage_V == reading.load_power_W
