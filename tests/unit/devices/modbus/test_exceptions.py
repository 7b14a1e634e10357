"""An exception reply is told with the key of the configuration that may end it."""

from __future__ import annotations

import functools

import pytest

from adaptdrive.config.polled import Register
from adaptdrive.devices.modbus.frames import explain_exception
from adaptdrive.devices.polled.registers import Block, Exchange, Table, plan_blocks
from adaptdrive.safety.trips import remedy


def block(table: Table, gap: int = 0, *, single: bool = False) -> Block:
    register = functools.partial(Register, table=table)
    behind = [] if single else [register(address=17 + gap)]
    (found,) = plan_blocks([register(address=16), *behind], gap, 1 if single else 9, write=single)
    return found


READ, ACROSS, WRITE = block("holding"), block("holding", 3), block("holding")


@pytest.mark.parametrize(
    ("code", "exchange", "words", "advice"),
    [
        (2, Exchange(read=ACROSS), "(address from 0); it runs across 3 ad", "set bus.max_gap"),
        (3, Exchange(read=ACROSS), "no entry names: max_gap = 2 reads with", "set bus.max_gap"),
        (2, Exchange(read=READ), "holding 16…17 (address from 0)", "check the register map"),
        (4, Exchange(read=ACROSS), "holding 16…20 (address from 0)", "check the register map"),
        (10, Exchange(read=ACROSS), "gateway without a path", "check device_id"),
        (11, Exchange(read=READ), "gateway: no reply of the device", "check device_id"),
        (1, Exchange(write=WRITE), "; bus.write = 'single' writes by function 6", "set the key"),
        (1, Exchange(write=block("holding", single=True)), "= 'multiple' writes by", "set the key"),
        (1, Exchange(READ, WRITE), "; bus.write = 'multiple' writes in", "set the key"),
        (1, Exchange(write=block("coil", single=True)), "(address from 0)", "check the register"),
        (11, Exchange(write=WRITE), "gateway: no reply of the device", "check device_id"),
        (3, Exchange(write=WRITE), "(address from 0)", "check the register map"),
    ],
)
def test_an_exception_names_the_key_that_may_end_it(
    code: int, exchange: Exchange, words: str, advice: str
) -> None:
    kind, text = explain_exception(code, exchange)
    assert words in text
    assert remedy(kind).startswith(advice)
