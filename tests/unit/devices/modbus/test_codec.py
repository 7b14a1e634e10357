"""Registers against the documented forms, as pymodbus's own converter has them."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymodbus.client.mixin import ModbusClientMixin

from adaptdrive.config.polled import Register
from adaptdrive.config.section import Range
from adaptdrive.devices.polled.registers import (
    decode,
    encode_count,
    encode_value,
    register_field,
)

TYPES = {
    "uint16": (ModbusClientMixin.DATATYPE.UINT16, st.integers(0, 0xFFFE)),
    "int16": (ModbusClientMixin.DATATYPE.INT16, st.integers(-0x7FFF, 0x7FFF)),
    "uint32": (ModbusClientMixin.DATATYPE.UINT32, st.integers(0, 0xFFFF_FFFE)),
    "int32": (ModbusClientMixin.DATATYPE.INT32, st.integers(-0x7FFF_FFFF, 0x7FFF_FFFF)),
    "uint64": (ModbusClientMixin.DATATYPE.UINT64, st.integers(0, 1 << 53)),
    "int64": (ModbusClientMixin.DATATYPE.INT64, st.integers(-(1 << 53), 1 << 53)),
    "float64": (ModbusClientMixin.DATATYPE.FLOAT64, st.floats(-1e30, 1e30)),
    "float32": (
        ModbusClientMixin.DATATYPE.FLOAT32,
        st.floats(-(2.0**99), 2.0**99, width=32),
    ),
}


def register(**keys: object) -> Register:
    return Register.model_validate({"address": 0, "table": "input", **keys})


def decode_value(described: Register, words: list[int], *, measured: bool) -> float | None:
    field = register_field("", described, "measured" if measured else "word")
    return decode(described, field, words)


@pytest.mark.parametrize("order", ["big", "little"])
@pytest.mark.parametrize("name", TYPES)
@given(data=st.data())
def test_a_value_has_the_registers_that_pymodbus_gives_it(
    name: str, order: str, data: st.DataObject
) -> None:
    kind, values = TYPES[name]
    value = data.draw(values)
    described = register(type=name, order="ABCD" if order == "big" else "CDAB")
    words = ModbusClientMixin.convert_to_registers(
        value, kind, word_order="big" if order == "big" else "little"
    )
    assert decode_value(described, words, measured=True) == value  # 64 bits are a float, too
    assert encode_value(described, value) == words
    mirrored = register(type=name, order="BADC" if order == "big" else "DCBA")
    swapped = [int.from_bytes(word.to_bytes(2, "big"), "little") for word in words]
    assert decode_value(mirrored, swapped, measured=True) == value


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("uint16", [0xFFFF]),
        ("int16", [0x8000]),
        ("uint32", [0xFFFF, 0xFFFF]),
        ("int32", [0x8000, 0]),
        ("float32", [0x7FC0, 0]),
        ("float32", [0x7F80, 0]),
        ("float32", [0xFF80, 0]),
        ("float32", [0x7F7F, 0xFFFF]),
        ("float32", [0xFF7F, 0xFFFF]),
    ],
)
def test_what_is_not_available_is_refused(name: str, words: list[int]) -> None:
    assert decode_value(register(type=name), words, measured=True) is None


def test_a_fault_word_may_be_all_ones() -> None:
    assert decode_value(register(), [0xFFFF], measured=False) == 0xFFFF


def test_the_map_says_what_is_not_available() -> None:
    described = register(type="int16", not_available=0x7FFF)
    assert decode_value(described, [0x7FFF], measured=True) is None
    assert decode_value(described, [0x8000], measured=True) == -0x8000


@pytest.mark.parametrize(
    ("kind", "word", "words"),
    [
        ("int16", 0x8000, [0x8000]),
        ("int16", 0xFC18, [0xFC18]),
        ("int16", -1000, [0xFC18]),
        ("int32", 0x8000_0000, [0x8000, 0]),
        ("uint32", 0x8000_0000, [0x8000, 0]),
        ("float32", 0x7F7F_FFFF, [0x7F7F, 0xFFFF]),
        ("float32", 0x4479_C000, [0x4479, 0xC000]),
        ("float32", -9999, [0xC61C, 0x3C00]),
    ],
)
def test_the_word_for_no_value_is_compared_as_a_word(
    kind: str, word: int, words: list[int]
) -> None:
    described = register(type=kind, not_available=word)
    assert decode_value(described, words, measured=True) is None
    assert decode_value(described, words, measured=False) is None
    assert decode_value(described, [1] * len(words), measured=True) is not None


def test_a_value_outside_its_range_is_refused() -> None:
    described = register(scale=0.01, range={"low": 0.0, "high": 600.0})
    assert decode_value(described, [60000], measured=True) == 600.0
    assert decode_value(described, [60001], measured=True) is None
    with pytest.raises(ValueError, match="outside"):
        encode_value(described, 600.01)


@pytest.mark.parametrize(
    ("mask", "word", "value"), [(0x0F00, 0xA5FF, 5), (0xFFFF, 0x1234, 0x1234), (0x8000, 0x8000, 1)]
)
def test_bits_are_taken_as_a_number(mask: int, word: int, value: int) -> None:
    assert decode_value(register(mask=mask), [word], measured=False) == value


@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0, 65536.0])
def test_what_a_register_cannot_hold_is_not_sent(value: float) -> None:
    with pytest.raises(ValueError, match=r"outside|cannot hold"):
        encode_value(register(), value)


def test_a_float_that_is_too_large_is_not_sent() -> None:
    with pytest.raises(ValueError, match=r"outside|cannot hold"):
        encode_count(register(type="float32"), 1e39)


@given(st.floats(0.0, 600.0))
def test_scaling_loses_at_most_half_a_count(value: float) -> None:
    described = register(scale=0.01, range=Range(low=0.0, high=600.0).model_dump())
    back = decode_value(described, encode_value(described, value), measured=True)
    assert back is not None
    assert abs(back - value) <= 0.005 + 1e-9
