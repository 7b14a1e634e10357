"""Few requests, never across what is not mapped, and only as often as the link can."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.config.polled import ModbusRtu, ModbusTcp, Register
from adaptdrive.control.signals import Command
from adaptdrive.devices.polled.mapping import block_words
from adaptdrive.devices.polled.registers import (
    Block,
    Exchange,
    exchange_bytes,
    exchange_s,
    plan_blocks,
)
from tests.unit.config.modbus_documents import flaws, parse
from tests.unit.devices.modbus.bench import plan

RTU = {"bus__type": '"modbus-rtu"', "bus__host": None, "bus__device": '"drive.tty"'}


addresses = st.lists(
    st.tuples(
        st.sampled_from(["input", "holding"]),
        st.integers(0, 300),
        st.sampled_from(["uint16", "float32"]),
    ),
    min_size=1,
    max_size=40,
)


@given(addresses, st.integers(0, 20), st.integers(2, 125))
def test_blocks_cover_every_register_and_run_across_small_gaps_only(
    chosen: list[tuple[str, int, str]], max_gap: int, max_block: int
) -> None:
    registers = [
        Register.model_validate({"table": table, "address": address, "type": kind})
        for table, address, kind in chosen
    ]
    blocks = plan_blocks(registers, max_gap, max_block)
    assert all(any(block.holds(register) for block in blocks) for register in registers)
    for block in blocks:
        assert block.count <= max_block
        wanted = {
            address
            for register in registers
            if register.table == block.table
            for address in range(register.address, register.end)
        }
        run = 0
        for address in range(block.address, block.end):
            run = 0 if address in wanted else run + 1
            assert run <= max_gap


def test_one_request_reads_all_and_one_writes_all() -> None:
    poll = plan(bus__heartbeat__daemon='"alive"', bus__heartbeat__drive='"state"')
    assert [block for block, _ in poll.reads] == [Block("input", 0, 6)]
    assert [block for block, _ in poll.writes] == [Block("holding", 0, 3)]


def test_a_gap_that_is_too_large_costs_a_request() -> None:
    far = {"bus__registers__speed": "{ address = 9, table = 'input', type = 'float32' }"}
    assert [block for block, _ in plan(**far, bus__max_gap="5").reads] == [
        Block("input", 0, 3),
        Block("input", 9, 2),
    ]
    assert [block for block, _ in plan(**far, bus__max_gap="6").reads] == [Block("input", 0, 11)]


def test_a_write_never_runs_across_a_gap() -> None:
    apart = {"bus__registers__control": "{ address = 2, table = 'holding' }"}
    assert [block for block, _ in plan(**apart).writes] == [
        Block("holding", 0, 1),
        Block("holding", 2, 1),
    ]


def test_reading_and_writing_at_once_needs_holding_registers() -> None:
    assert "none is measured" in flaws(bus__write='"with-read"')["bus.write"]


def test_reading_and_writing_at_once_needs_one_block_to_write() -> None:
    apart = {"bus__registers__control": "{ address = 9, table = 'holding' }"}
    measured = {"bus__registers__power": "{ address = 20, table = 'holding' }"}
    found = flaws(**apart, **measured, bus__write='"with-read"')
    assert "it is 2" in found["bus.write"]
    assert plan(**measured, bus__write='"with-read"').combined


def test_a_drive_whose_safe_command_would_switch_it_on_is_a_flaw() -> None:
    found = flaws(signals__command__bridge="{ signal = 'control', off = 1 }")
    assert found["signals.command.bridge"] == "on and off are both 1"


def test_a_drive_that_could_not_be_switched_off_is_a_flaw() -> None:
    floor = "{ address = 0, table = 'holding', range = { low = 200.0, high = 400.0 } }"
    found = flaws(bus__registers__wanted=floor)
    assert "could not be switched" in found["signals.command.boost_reference_V"]


def test_a_constant_is_written_with_each_command() -> None:
    writes = plan(signals__command__constants__alive="7").writes
    assert [
        block_words(block, sinks, Command(0.0, 2.5, bridge=True), 0) for block, sinks in writes
    ] == [[250, 1, 7]]
    found = flaws(signals__command__constants__alive="7.5")
    assert "alive = 7.5 would be sent as 8" in found["signals.command.constants.alive"]


def resting_at(offset_V: float) -> dict[str, str | None]:
    """A register of 0.1 V a count, whose count 0 is another voltage."""
    return {
        "bus__registers__wanted": "{ address = 0, table = 'holding', scale = 0.1, type = 'int16' }",
        "signals__command__boost_reference_V": f"{{ signal = 'wanted', offset = {offset_V} }}",
    }


@pytest.mark.parametrize(("offset_V", "sent"), [(0.04, "0.04"), (-7.77, "0.03")])
def test_a_safe_command_that_would_be_sent_as_another_value_is_a_flaw(
    offset_V: float, sent: str
) -> None:
    problem = flaws(**resting_at(offset_V))["signals.command.boost_reference_V"]
    assert problem == f"0 would be sent as {sent}: it could not be safe"


@pytest.mark.parametrize("offset_V", [0.0, 0.3, -20.7])
def test_a_safe_command_may_miss_its_count_in_binary(offset_V: float) -> None:
    plan(**resting_at(offset_V))


@pytest.mark.parametrize(
    ("exchange", "rtu", "tcp"),
    [
        # 8 + (5 + 2n), and 12 + (9 + 2n), as the specification counts them
        (Exchange(read=Block("input", 0, 6)), 8 + 17, 12 + 21),
        (Exchange(write=Block("holding", 0, 3)), 9 + 6 + 8, 13 + 6 + 12),
        (
            Exchange(read=Block("holding", 9, 4), write=Block("holding", 0, 3)),
            13 + 6 + 5 + 8,
            17 + 6 + 9 + 8,
        ),
    ],
)
def test_bytes_of_an_exchange(exchange: Exchange, rtu: int, tcp: int) -> None:
    serial = parse(**RTU).bus
    network = parse().bus
    assert isinstance(serial, ModbusRtu)
    assert isinstance(network, ModbusTcp)
    assert exchange_bytes(serial, exchange) == rtu
    assert exchange_bytes(network, exchange) == tcp


def test_a_character_has_eleven_bits_with_parity_and_ten_without() -> None:
    exchange = Exchange(read=Block("input", 0, 6))
    found = {}
    for form in ("8E1", "8N1"):
        bus = parse(
            **RTU,
            bus__form=f'"{form}"',
            bus__baud="9600",
            bus__turnaround_s="0.0",
        ).bus
        assert isinstance(bus, ModbusRtu)
        found[form] = exchange_s(bus, exchange)
    assert found["8E1"] == pytest.approx((25 + 2 * 3.5) * 11 / 9600)
    assert found["8N1"] == pytest.approx((25 + 2 * 3.5) * 10 / 9600)


def test_a_rate_that_does_not_fit_is_refused_with_its_figures() -> None:
    found = flaws(
        **RTU,
        bus__baud="9600",
        bus__poll_ticks="6",
        load__latency_ticks="6",
        bus__timeout_s="0.049",
    )
    message = found["bus.poll_ticks"]
    for figure in ("50.0 ms", "20 per second", "44 bytes", "11 bits", "9600 baud", "5 ms", "80%"):
        assert figure in message
    fitting = message.rpartition("poll_ticks = ")[2].removesuffix(" fits")
    plan(**RTU, bus__baud="9600", bus__poll_ticks="12", load__latency_ticks="12")
    assert 6 < int(fitting) <= 12


def test_a_time_out_shorter_than_an_exchange_is_refused() -> None:
    found = flaws(**RTU, bus__baud="9600", bus__timeout_s="0.02")
    assert "slowest exchange" in found["bus.timeout_s"]
