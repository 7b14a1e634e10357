import math
from collections import OrderedDict
from collections.abc import Collection, Mapping

import pytest
from cantools.database.can.message import Message
from cantools.database.can.signal import Signal
from cantools.database.conversion import BaseConversion
from cantools.database.namedsignalvalue import NamedSignalValue
from hypothesis import assume, given
from hypothesis import strategies as st

from adaptdrive.config.bus import FrameIntegrity
from adaptdrive.devices.can.codec import MessageCodec
from adaptdrive.devices.can.integrity import FrameVerdict
from adaptdrive.devices.can.layout import compile_field
from tests.unit.devices.bench import motor_bus, odd_database, reference_database, with_crc


def coded(
    message: Message,
    integrity: FrameIntegrity | None = None,
    *,
    wanted: Collection[str] | None = None,
    measured: Collection[str] = (),
    states: Mapping[str, float] | None = None,
) -> MessageCodec:
    """The codec of a message with signals that are measured, or the state of a bridge."""
    fields = {
        one.name: compile_field(
            one,
            measured=one.name in measured,
            state=one.name in (states or {}),
            on=(states or {}).get(one.name),
        )
        for one in message.signals
        if wanted is None or one.name in wanted
    }
    return MessageCodec(message, integrity, fields)


SCALES = st.sampled_from([1, 2, 0.5, 0.1, 0.01, 1e-6, -0.25])
OFFSETS = st.sampled_from([0, -40, 273.15])


LENGTHS = st.sampled_from([1, 2, 5, 8, 12, 16, 64])


def conversion_of(draw: st.DrawFn, *, is_float: bool) -> BaseConversion:
    if is_float:  # a factor would cost a digit, here as in cantools, but not the same one
        return BaseConversion.factory(is_float=True)
    return BaseConversion.factory(draw(SCALES), draw(OFFSETS))


def signal_at(draw: st.DrawFn, first: int, length: int, **more: object) -> Signal:
    """A signal of either byte order that fills the bits `first`... of the frame.

    Whole bytes may be taken in either order; within a byte both orders are the same bits.
    """
    whole = first % 8 == 0 and length in {16, 32, 64}
    is_float = length == 64 or (whole and draw(st.booleans()))
    big = (first % 8 + length <= 8 or (first % 8, length % 8) == (0, 0)) and draw(st.booleans())
    start = first
    if big:  # named after its highest bit, which lies in its first byte
        start = 8 * (first // 8) + (first % 8 + length - 1 if length < 8 else 7)
    return Signal(
        f"S{first}_{more.get('multiplexer_ids', '')}",
        start,
        length,
        byte_order="big_endian" if big else "little_endian",
        is_signed=not is_float and length > 1 and draw(st.booleans()),
        conversion=conversion_of(draw, is_float=is_float),
        **more,  # type: ignore[arg-type]
    )


def signals_in(draw: st.DrawFn, first: int, end: int, **more: object) -> list[Signal]:
    """Signals one behind the other, with gaps."""
    found = []
    while first < end:
        lengths = (1, 3, 4, 8, 12, 16, 24, 32, *([] if first % 8 else [64]))
        length = draw(st.sampled_from([bits for bits in lengths if first + bits <= end]))
        if length > 8 and first % 8:
            length = 8 - first % 8
        if draw(st.booleans()):
            found.append(signal_at(draw, first, length, **more))
        first += length
    return found


@st.composite
def layouts(draw: st.DrawFn) -> Message:
    """Any message: both byte orders, floats, signs, factors, offsets, gaps, lengths of CAN FD."""
    length = draw(LENGTHS)
    signals = signals_in(draw, 0, 8 * length)
    return Message(0x123, "Any", length, signals, strict=True, is_fd=length > 8)


@st.composite
def multiplexed_layouts(draw: st.DrawFn) -> Message:
    """Any message with a multiplexer in its first byte, and pages of their own."""
    length = draw(st.sampled_from([4, 8, 24]))
    signals = [Signal("Page", 0, 8, is_multiplexer=True), *signals_in(draw, 8, 16)]
    for page in draw(st.sets(st.integers(0, 255), min_size=1, max_size=4)):
        paged = {"multiplexer_ids": [page], "multiplexer_signal": "Page"}
        signals += signals_in(draw, 16, 8 * length - 8, **paged)
        signals.append(Signal(f"Mark_{page}", 8 * length - 1, 1, **paged))  # type: ignore[arg-type]
    return Message(0x123, "Any", length, signals, strict=False, is_fd=length > 8)


def data_of(message: Message, draw: st.DataObject) -> bytes:
    data = draw.draw(st.binary(min_size=message.length, max_size=message.length))
    pages = [page for signal in message.signals for page in signal.multiplexer_ids or ()]
    return bytes((draw.draw(st.sampled_from(pages)),)) + data[1:] if pages else data


@given(layouts() | multiplexed_layouts(), st.data())
def test_decodes_what_cantools_decodes(message: Message, draw: st.DataObject) -> None:
    data = data_of(message, draw)
    expected = message.decode_simple(data)
    decoded = MessageCodec(message).decode(data)
    finite = {name: one for name, one in expected.items() if math.isfinite(float(str(one)))}
    whole = len(finite) == len(expected)
    assert decoded[0] is (FrameVerdict.GOOD if whole else FrameVerdict.OUT_OF_RANGE)
    assert decoded[1] == finite


@given(layouts() | multiplexed_layouts(), st.data())
def test_encodes_what_cantools_encodes(message: Message, draw: st.DataObject) -> None:
    values = message.decode_simple(data_of(message, draw))
    numbers = {name: float(str(value)) for name, value in values.items()}
    assume(all(math.isfinite(value) for value in numbers.values()))
    assert MessageCodec(message).encode(numbers) == message.encode(values, strict=False)


def dbc(signals: str) -> Message:
    return odd_database(signals).get_message_by_name("Odd")


MULTIPLEXED = (
    ' SG_ Page M : 0|2@1+ (1,0) [0|0] "" X\n'
    ' SG_ Volts m0 : 8|16@1+ (0.1,0) [0|4000] "V" X\n'
    ' SG_ Amps m1 : 8|16@1- (0.5,0) [0|0] "A" X'
)


def test_a_multiplexed_frame_of_an_unknown_page_is_refused() -> None:
    assert MessageCodec(dbc(MULTIPLEXED)).decode(bytes((3, *bytes(7))))[0] is (
        FrameVerdict.OUT_OF_RANGE
    )


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_float_that_is_not_finite_is_refused(value: float) -> None:
    signal = Signal("Volts", 0, 32, conversion=BaseConversion.factory(is_float=True))
    message = Message(0x123, "Floats", 8, [signal])
    frame = message.encode({"Volts": value})
    assert MessageCodec(message).decode(frame)[0] is FrameVerdict.OUT_OF_RANGE
    with pytest.raises(ValueError, match="Volts"):
        MessageCodec(message).encode({"Volts": value})


@pytest.mark.parametrize(
    ("names", "unknown"),
    [
        (["Unknown"], {0}),
        (["Off", "On", "Ready", "Invalid"], {3}),
        ([*"abcdefg", "SNA"], {7}),
        ([*"abcdefg", "Not available or not requested"], {7}),
        ([*"abcdefg", "signal_not_available"], {7}),
        (["Off", "Error", "Unknown device", "Invalid parameters"], set()),
        (["DI_STATE_OFF", "DI_STATE_ON", "DI_STATE_FAULT", "DI_STATE_SNA"], {3}),
        (["Bridge open", "Bridge closed", "Bridge fault", "Bridge unknown"], {3}),
        (["Not ready", "Not off", "Not on", "Not available"], {3}),
    ],
)
def test_a_state_whose_name_says_that_nothing_is_known_is_none(
    names: list[str], unknown: set[int]
) -> None:
    """A prefix of all names hides no state of which nothing is known."""
    choices: OrderedDict[int, str | NamedSignalValue] = OrderedDict(enumerate(names))
    state = Signal("State", 0, 3, conversion=BaseConversion.factory(choices=choices))
    message = Message(0x123, "Drive", 1, [state])
    codec = coded(message, states={"State": 1.0})
    refused = {raw for raw in range(len(names)) if not codec.decode(bytes((raw,)))[1]}
    assert refused == unknown
    values = [MessageCodec(message).decode(bytes((raw,)))[1] for raw in range(len(names))]
    assert all(values)


def reference(name: str) -> MessageCodec:
    message = reference_database().get_message_by_name(name)
    return MessageCodec(message, motor_bus().integrity[name])


@pytest.mark.parametrize(
    ("signal", "value"),
    [
        ("CurrentScale", 0.30001),
        ("CurrentScale", -0.31),
        ("CurrentScale", math.nan),
        ("BoostReference", 600.01),
        ("BoostReference", -0.01),
        ("BoostReference", math.inf),
        ("BridgeEnable", 2),
    ],
)
def test_what_a_signal_cannot_hold_is_not_sent(signal: str, value: float) -> None:
    """It costs no count of the alive counter."""
    codec = reference("DriveCommand")
    with pytest.raises(ValueError, match=signal):
        codec.encode({signal: value})
    assert codec.encode({})[6] >> 4 == 0


@pytest.mark.parametrize("length", [0, 1, 7, 9, 64])
def test_a_frame_of_another_length_is_refused(length: int) -> None:
    assert reference("DriveStatus").decode(bytes(length))[0] is FrameVerdict.WRONG_LENGTH


@pytest.mark.parametrize("order", ["little", "big"])
@pytest.mark.parametrize("length", [4, 5, 7, 9, 64])
def test_a_frame_of_another_length_without_proofs_gives_what_it_has(
    length: int, order: str
) -> None:
    place = {"little": "16|16@1+", "big": "23|16@0+"}[order]
    signals = f""" SG_ Volts : {place} (0.1,0) [0|6553.4] "V" X
 SG_ Late : 56|8@1+ (1,0) [0|255] "" X"""
    message = odd_database(signals).get_message_by_name("Odd")
    volts = (1234).to_bytes(2, "little" if "@1" in place else "big")
    data = bytes(2) + volts + bytes(60)
    decoded = coded(message, wanted=["Volts"]).decode(data[:length])
    assert decoded[1] == {"Volts": pytest.approx(123.4)}
    assert coded(message, wanted=["Volts"]).needed == 4
    for short in (0, 1, 3):
        verdict = coded(message, wanted=["Volts"]).decode(data[:short])[0]
        assert verdict is FrameVerdict.WRONG_LENGTH
    both = coded(message, wanted=["Volts", "Late"]).decode(data[:length])
    assert both[0] is (FrameVerdict.GOOD if length > 7 else FrameVerdict.WRONG_LENGTH)


def test_a_short_frame_of_a_multiplexed_message_is_read_by_its_page() -> None:
    message = odd_database(""" SG_ Page M : 0|8@1+ (1,0) [0|255] "" X
 SG_ Volts m1 : 8|16@1+ (0.1,0) [0|6553.4] "V" X
 SG_ Late m2 : 48|16@1+ (1,0) [0|65535] "" X""").messages[0]
    codec = coded(message, wanted=["Volts"])
    assert codec.decode(b"\x01\x0a\x00")[1] == {"Volts": pytest.approx(1.0)}
    assert codec.decode(b"\x02\x0a\x00")[1] == {}
    assert codec.decode(b"\x01\x0a")[0] is FrameVerdict.WRONG_LENGTH


WORDS = """ SG_ Volts : 0|16@1+ (0.1,0) [0|6553.4] "V" X
 SG_ Amps : 16|16@1+ (0.1,0) [0|6553.4] "A" X
 SG_ Fault : 32|8@1+ (1,0) [0|255] "" X
 SG_ State : 40|4@1+ (1,0) [0|8] "" X
 SG_ On : 44|1@1+ (1,0) [0|1] "" X
 SG_ Alive : 48|4@1+ (1,0) [0|14] "" X
 SG_ Crc : 56|8@1+ (1,0) [0|255] "" X"""


@pytest.mark.parametrize(
    ("status", "values"),
    [
        ("0214", {"Fault": 2, "State": 4, "On": 1}),
        ("0009", {"Fault": 0, "On": 0}),
        ("ffff", {"Fault": 255, "On": 1}),
    ],
    ids=["in range", "one out of range", "all bits set"],
)
def test_the_values_beside_a_refused_one_are_those_in_range(
    status: str, values: dict[str, float]
) -> None:
    integrity = FrameIntegrity(counter="Alive", checksum="Crc")
    codec = coded(dbc(WORDS), integrity, measured={"Volts", "Amps"})
    frame = with_crc(bytes.fromhex("ffff 0100") + bytes.fromhex(status) + bytes(2))
    decoded = codec.decode(frame)
    assert decoded[0] is FrameVerdict.OUT_OF_RANGE
    assert decoded[1] == {"Amps": pytest.approx(0.1), **values}


@pytest.mark.parametrize(
    ("raw", "on", "named", "known"),
    [
        ("ff", 1.0, "", False),
        ("fe", 1.0, "", True),
        ("ff", -1.0, "", True),
        ("ff", 1.0, '\nVAL_ 291 State -1 "Off" ;', True),
    ],
    ids=["all bits set", "another", "means on", "named"],
)
def test_a_state_with_all_bits_set_is_none(raw: str, on: float, named: str, known: bool) -> None:
    """As a gateway sends it of a drive that it does not hear: it would be a bridge that is off."""
    state = dbc(f' SG_ State : 0|8@1- (1,0) [0|0] "" X{named}')
    decoded = coded(state, states={"State": on}).decode(bytes.fromhex(raw) + bytes(7))
    assert bool(decoded[1]) is known


def test_a_frame_with_nothing_available_has_no_values() -> None:
    """As a drive sends while its control starts; a word of one bit looks like a 1 there."""
    codec = coded(dbc(WORDS), FrameIntegrity(), measured={"Volts", "Amps"})
    assert codec.decode(b"\xff" * 7 + b"\x7f")[1]["On"] == 1
    decoded = codec.decode(b"\xff" * 8)
    assert decoded[0] is FrameVerdict.OUT_OF_RANGE
    assert not decoded[1]


@pytest.mark.parametrize("alive", [0, 15], ids=["repeated", "beyond its end"])
def test_a_frame_whose_counter_is_wrong_has_no_values(alive: int) -> None:
    codec = coded(dbc(WORDS), FrameIntegrity(counter="Alive"), measured={"Volts", "Amps"})
    frame = bytes.fromhex("ffff 0100 0214")
    assert codec.decode(frame + bytes(2))[1]
    decoded = codec.decode(frame + bytes((alive, 0)))
    assert not decoded[1]
    assert (decoded[0] is FrameVerdict.OUT_OF_RANGE) is (alive == 15)


@pytest.mark.parametrize("declared", ["[0|0]", "[0|6553.5]"])
def test_a_measurement_is_unavailable_even_where_the_database_forgot_it(declared: str) -> None:
    message = dbc(f' SG_ Volts : 0|16@1+ (0.1,0) {declared} "V" X')
    frame = b"\xff\xff" + bytes(6)
    assert MessageCodec(message).decode(frame)[0] is FrameVerdict.GOOD
    assert coded(message, measured={"Volts"}).decode(frame)[0] is FrameVerdict.OUT_OF_RANGE


def test_a_counter_that_the_database_ends_early_wraps_there() -> None:
    # AUTOSAR profile 1 counts from 0 to 14; 15 is an error
    message = dbc(' SG_ Alive : 8|4@1+ (1,0) [0|14] "" X\n SG_ Crc : 0|8@1+ (1,0) [0|255] "" X')
    integrity = FrameIntegrity(counter="Alive", checksum="Crc", data_id=0x123)
    sender, receiver = MessageCodec(message, integrity), MessageCodec(message, integrity)
    frames = [sender.encode({}) for _ in range(31)]
    assert frames[0][:2] == b"\xcc\x00"
    assert frames[1][:2] == b"\x91\x01"
    assert [frame[1] for frame in frames] == [*range(15), *range(15), 0]
    assert {receiver.decode(frame)[0] for frame in frames} == {FrameVerdict.GOOD}
