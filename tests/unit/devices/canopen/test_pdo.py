"""What travels in a PDO is what the canopen library packs and unpacks."""

from __future__ import annotations

from typing import Any

import canopen
from canopen.pdo.base import PdoMap
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.devices.can.integrity import FrameVerdict
from adaptdrive.devices.canopen.dictionary import Entry, ObjectCatalogue, read_eds
from adaptdrive.devices.canopen.mapping import codec, pack, pdos_of
from tests.unit.devices.canopen.documents import EDS

NODE = 5
CATALOGUE = ObjectCatalogue(*read_eds(EDS, NODE))
ADDRESSES = [(0x6041, 0), (0x6079, 0), (0x2000, 1), (0x2001, 1), (0x2001, 2), (0x2000, 3)]


def entry(address: tuple[int, int]) -> Entry:
    found = CATALOGUE.at(address)
    assert found is not None
    return found


ENTRIES = [entry(address) for address in ADDRESSES]


def library_map(entries: tuple[Entry, ...]) -> PdoMap:
    """The same PDO, as the library has it."""
    node = canopen.RemoteNode(NODE, str(EDS))
    pdo: PdoMap = node.tpdo[1]
    pdo.clear()
    for one in entries:
        pdo.add_variable(*one.address, one.bits)
    return pdo


def raw_values(one: Entry) -> st.SearchStrategy[Any]:
    low, high = one.coding.low, one.coding.high
    if not one.coding.integer:
        return st.floats(width=32).filter(lambda value: low <= value <= high)
    return st.integers(int(low), int(high))


fillings = st.lists(st.sampled_from(ENTRIES), min_size=1, max_size=4, unique=True).flatmap(
    lambda entries: st.tuples(st.just(entries), st.tuples(*map(raw_values, entries)))
)


@given(fillings)
def test_frames_are_those_of_the_library_in_both_directions(
    filling: tuple[list[Entry], tuple[float, ...]],
) -> None:
    entries, values = filling
    for pdo in pack(pdos_of("TPDO", NODE), entries) or []:
        given_values = {
            one.label: value
            for one, value in zip(entries, values, strict=True)
            if one in pdo.entries
        }
        theirs = library_map(pdo.entries)
        for variable, one in zip(theirs.map, pdo.entries, strict=True):
            variable.raw = given_values[one.label]
        ours = codec(pdo)
        assert ours.encode(given_values) == bytes(theirs.data)
        decoded = ours.decode(bytes(theirs.data))
        assert decoded[0] is FrameVerdict.GOOD
        assert decoded[1] == given_values


@given(st.lists(st.sampled_from(ENTRIES), unique=True))
def test_everything_is_packed_once_and_no_frame_is_too_long(entries: list[Entry]) -> None:
    empty = pdos_of("TPDO", NODE)
    pdos = pack(empty, entries)
    assert pdos is not None
    packed = [one for pdo in pdos for one in pdo.entries]
    assert sorted(one.label for one in packed) == sorted(one.label for one in entries)
    assert all(sum(one.bits for one in pdo.entries) <= 64 for pdo in pdos)


def test_channels_are_those_of_the_predefined_connection_set() -> None:
    node = canopen.RemoteNode(NODE, str(EDS))
    sent, taken = pdos_of("TPDO", NODE), pdos_of("RPDO", NODE)
    for number, (tpdo, rpdo) in enumerate(zip(sent, taken, strict=True), start=1):
        assert tpdo.cob_id == node.tpdo[number].predefined_cob_id
        assert rpdo.cob_id == 0x100 * (number + 1) + NODE
