"""Several fault words, whole or some bits of them, each named in the trip by its signal and bit."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.config.polled import Heartbeat
from adaptdrive.devices.can.assembly import StatusAssembly
from adaptdrive.devices.can.mapping import map_drive
from adaptdrive.devices.polled.mapping import map_drive as map_registers
from adaptdrive.devices.polled.reports import PollAssembly
from adaptdrive.safety.facts import FaultLatch, FaultWord
from tests.support import text_of
from tests.unit.config.modbus_documents import flaws, parse
from tests.unit.devices.bench import MOTOR_BUS, TIMING, motor_signals
from tests.unit.devices.canopen.documents import flaws as object_flaws
from tests.unit.devices.canopen.documents import plan as plan_objects

WORDS = {
    "fault.0": FaultWord("Post_Lo", -1, {1 << 8: "hw_overcurrent"}),
    "fault.1": FaultWord("Run_Hi", 0x0F, {}),
    "fault.2": FaultWord("Code", -1, {3: "over-voltage", 5: "over-current", 4: "hot"}),
}


def test_the_trip_names_signal_and_bit() -> None:
    latch = FaultLatch(WORDS)
    assert latch.trip_cause is None
    latch.see({"fault.0": float(0x100)})
    assert text_of(latch.trip_cause) == "drive fault: Post_Lo bit 8 hw_overcurrent (word 0x100)"
    latch.see({"fault.1": float(0xF2)})  # bits outside its mask are no faults
    latch.see({"fault.2": 5.0})
    latch.see({"fault.2": 3.0})
    assert latch.name == "Post_Lo bit 8 hw_overcurrent, Run_Hi bit 1, Code over-current"
    latch.clear(0x100)  # what no reading has carried stays
    assert latch.name == "Run_Hi bit 1, Code over-current"
    latch.clear(latch.word)
    assert (latch.word, latch.name) == (0, "")


def test_bits_of_a_word_add_up_until_a_reading_has_carried_them() -> None:
    latch = FaultLatch(WORDS)
    for bit in (8, 1, 8):
        latch.see({"fault.0": float(1 << bit)})
    assert (latch.word, latch.name) == (0x102, "Post_Lo bit 1, bit 8 hw_overcurrent")


def test_a_value_that_is_healthy_is_no_fault_and_each_other_one_is_a_code() -> None:
    latch = FaultLatch({"fault": FaultWord("state", -1, {61: "None", 65: "Open"}, frozenset({61}))})
    latch.see({"fault": 61.0})
    assert latch.trip_cause is None
    latch.see({"fault": 65.0})
    latch.see({"fault": 61.0})
    latch.see({"fault": 64.0})
    assert text_of(latch.trip_cause) == "drive fault: state Open (word 0x41)"
    latch.clear(latch.word)
    latch.see({"fault": 64.0})
    assert text_of(latch.trip_cause) == "drive fault: state 64 (word 0x40)"


@given(st.lists(st.integers(1, 0xFFFF), min_size=1, max_size=4))
def test_a_number_that_nothing_describes_is_shown_as_one_and_never_mixed(codes: list[int]) -> None:
    latch = FaultLatch({"fault": FaultWord("Error", -1, {})})
    for code in codes:
        latch.see({"fault": float(code)})
    bits = [bit for bit in range(16) if codes[0] >> bit & 1]
    assert latch.name == f"Error {codes[0]} ({', '.join(f'bit {bit}' for bit in bits)})"
    assert latch.word == codes[0]


@pytest.mark.parametrize(
    ("names", "said"), [("", "last 7"), (", names = { ground = 7 }", "last ground")]
)
def test_a_fault_bit_names_the_register_with_its_code(names: str, said: str) -> None:
    configuration = parse(
        bus__registers__state="{ address = 5, table = 'input', mask = 0x8 }",
        bus__registers__last=f"{{ address = 9, table = 'input'{names} }}",
        signals__fault="[{ signal = 'state', names = { 0 = 'tripped' }, code = 'last' }]",
    )
    poll = map_registers(configuration, configuration.bus, "bench.toml", passive=False)  # type: ignore[arg-type]
    assembly = PollAssembly(poll, Heartbeat())
    for state, last, fault in ((0, 7, ""), (8, 7, f"state bit 0 tripped, {said}"), (0, 7, "")):
        assembly.begin()
        for block, sources in poll.reads:
            words = {5: state, 9: last}
            found = [words.get(block.address + number, 0) for number in range(block.count)]
            assembly.take(block, sources, found)
        reading = assembly.reading(1.0, 1.0, bridge_sent=True)
        assert reading is not None
        assert (reading.fault_name, reading.other) == (fault, {})
        assembly.faults.clear(reading.fault)
    assert (
        "has no register 'lost'"
        in flaws(signals__fault="[{ signal = 'state', code = 'lost' }]")[
            "signals.fault.code.signal"
        ]
    )


@pytest.mark.parametrize("form", ["{}", "[{}]"])
@pytest.mark.parametrize("healthy", ["[2, 4]", "['Run', 'Ready']"])
def test_a_state_register_has_healthy_values(form: str, healthy: str) -> None:
    given = f"{{ signal = 'state', healthy = {healthy} }}"
    names = "{ Ready = 2, Fault = 3, Run = 4 }"
    words: dict[str, str | None] = {
        "bus__registers__state": f"{{ address = 5, table = 'input', names = {names} }}",
        "signals__fault": form.format(given),
    }
    configuration = parse(**words)
    poll = map_registers(configuration, configuration.bus, "bench.toml", passive=False)  # type: ignore[arg-type]
    assembly = PollAssembly(poll, Heartbeat())
    for state, fault in ((4, 0), (2, 0), (3, 3), (7, 3)):
        assembly.begin()
        for block, sources in poll.reads:
            assembly.take(block, sources, [0, 0, 2, 0, 0, state][: block.count])
        reading = assembly.reading(1.0, 1.0, bridge_sent=True)
        assert reading is not None
        assert (reading.fault, "Fault" in reading.fault_name) == (fault, fault == 3)


def test_what_cannot_be_healthy_is_refused() -> None:
    state = "{ address = 5, table = 'input', names = { Down = 0, Run = 4 } }"

    def found(healthy: str) -> dict[str, str]:
        fault = f"{{ signal = 'state', healthy = {healthy} }}"
        return flaws(bus__registers__state=state, signals__fault=fault)

    assert "leaves out 0 (Down)" in found("[4]")["signals.fault.healthy"]
    assert "has no 'Rum'" in found("['Rum', 0]")["signals.fault.healthy"]
    assert found("['Run', 'Down']") == {}


FAULTS = [{"signal": "DriveStatus.Fault", "mask": 0x6, "names": {"1": "hot", "2": "fast"}}]


def test_a_can_drive_has_several_words() -> None:
    mapping = map_drive(MOTOR_BUS, motor_signals(fault=FAULTS), TIMING)
    assembly = StatusAssembly(mapping)
    for status in mapping.statuses:
        found = {source.field.name: 0.0 for source in status.sources}
        found |= {"Fault": 5.0} if status.codec.name == "DriveStatus" else {}
        assembly.keep(status, found, 1.0)
    reading = assembly.newest.reading(1.0, bridge=True)
    assert reading is not None
    assert (reading.fault, reading.fault_name) == (4, "Fault bit 2 fast")
    assert reading.other == {}


def test_a_drive_on_modbus_has_several_words() -> None:
    fault = "[{ signal = 'state', mask = 0x100, names = { 8 = 'hw_overcurrent' } }, 'power']"
    warning = "{ signal = 'state', mask = 0x01, names = { 0 = 'derating' } }"
    configuration = parse(signals__fault=fault, signals__warning=warning)
    poll = map_registers(configuration, configuration.bus, "bench.toml", passive=False)  # type: ignore[arg-type]
    assembly = PollAssembly(poll, Heartbeat())
    assembly.begin()
    for block, sources in poll.reads:
        assembly.take(block, sources, [0, 0, 2, 0, 0, 0x101][: block.count])
    reading = assembly.reading(1.0, 1.0, bridge_sent=True)
    assert reading is not None
    assert reading.fault == 0x102
    assert reading.fault_name == "state bit 8 hw_overcurrent, power 2 (bit 1)"
    assert reading.warning == "state bit 0 derating"
    assert "'speed' must be an integer" in flaws(signals__fault="['speed']")["signals.fault"]


def test_a_node_on_canopen_has_several_words() -> None:
    warning = {"signal": "0x603F", "mask": 0x70, "names": {"4": "derating"}}
    mapping = plan_objects({"signals/fault": ["0x2000.1"], "signals/warning": [warning]})
    assert {one.quantity: one.word for one in mapping.sources if one.word} == {
        "fault": FaultWord("0x2000.1", -1, {}),
        "warning": FaultWord("0x603F", 0x70, {0x10: "derating"}, warns=True),
    }
    assert "no object" in object_flaws({"signals/fault": ["0x2009"]})["signals.fault"]


def test_a_fault_and_a_warning_share_a_word() -> None:
    latch = FaultLatch(
        {
            "fault": FaultWord("Word", 0x0F, {}),
            "warning": FaultWord("Word", 0xF0, {1 << 4: "derating"}, warns=True),
        }
    )
    for quantity in ("fault", "warning"):
        latch.see({quantity: float(0x30)})
    assert (latch.word, latch.name, latch.trip_cause) == (0, "", None)
    assert latch.warning == "Word bit 4 derating, bit 5"
    latch.clear(0)
    assert latch.warning == ""


NO_BIT = "'state' has no bit 16: its highest is 15"
NO_NUMBER = "is no number of a bit"
TWICE = "is watched by signals.{} already: leave one out, or give each a mask"


@pytest.mark.parametrize(
    ("key", "given", "place", "words"),
    [
        ("fault", "['state', 'nothing']", ".1.signal", "no register 'nothing'"),
        ("warning", "'nothing'", ".signal", "no register 'nothing'"),
        ("warning", "{ signal = 'state', mask = 0x1_0000 }", ".mask", NO_BIT),
        ("fault", "[{ signal = 'state', names = { 16 = 'hot' } }]", ".names", NO_BIT),
        (
            "warning",
            "{ signal = 'state', mask = 0x6, names = { 1 = 'hot', 3 = 'fan' } }",
            ".names",
            "3 is outside mask = 0x6: leave its name out, or add 0x8",
        ),
        (
            "fault",
            "['state', { signal = 'state', mask = 2 }]",
            ".1",
            f"bits 0x2 of 'state' {TWICE.format('fault.0')}",
        ),
        (
            "fault",
            "{ signal = 'state', healthy = [0], names = { hot = 'x' } }",
            ".names",
            "'hot' is no number of a value",
        ),
        ("fault", "{ signal = 'state', healthy = [0], names = { 65536 = 'x' } }", ".names", NO_BIT),
        ("fault", "[{ signal = 'state', mask = 0 }]", ".0.mask", "(it is 0)"),
        ("fault", "{ signal = 'state', mask = 0 }", ".mask", "(it is 0)"),
        ("fault", "[{ signal = 'state', names = { 64 = 'x' } }]", None, NO_NUMBER),
        ("fault", "[{ signal = 'state', names = { -1 = 'x' } }]", None, NO_NUMBER),
        ("fault", "[{ signal = 'state', names = { hot = 'x' } }]", None, NO_NUMBER),
    ],
)
def test_what_cannot_be_watched_is_refused(
    key: str, given: str, place: str | None, words: str
) -> None:
    found = flaws(**{f"signals__{key}": given})
    if place is not None:
        assert list(found) == [f"signals.{key}{place}"]
    assert words in str([*found.values()])


def test_a_word_is_watched_once() -> None:
    found = flaws(signals__fault="'state'", signals__warning="'state'")
    assert found == {"signals.warning": f"the word of 'state' {TWICE.format('fault')}"}


def test_a_file_names_the_values_of_a_code() -> None:
    code = {"signal": "0x603F", "healthy": [0], "names": {"8880": "over-current", "5": "hot"}}
    latch = plan_objects({"signals/fault": code}).newest_values().faults
    latch.see({"fault": float(0)})
    assert latch.trip_cause is None
    latch.see({"fault": float(0x22B0)})
    assert text_of(latch.trip_cause) == "drive fault: 0x603F over-current (word 0x22b0)"
