"""What a configuration names is found in the EDS, and everything that is wrong is told at once."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.unit.devices.canopen.documents import flaws, other_eds, plan, without


def test_the_example_fits_into_two_pdos_of_the_drive_and_one_of_the_daemon() -> None:
    mapping = plan()
    sends, takes = mapping.sent, mapping.taken
    sent = {pdo.name: [entry.label for entry in pdo.entries] for pdo in sends}
    taken = {pdo.name: [entry.label for entry in pdo.entries] for pdo in takes}
    assert sent == {
        "TPDO1": ["0x6041", "0x6079", "0x2000.1"],
        "TPDO2": ["0x2001.1", "0x2001.2"],
    }
    assert taken == {"RPDO1": ["0x6040", "0x2000.4"]}
    assert [pdo.cob_id for pdo in sends] == [0x185, 0x285]
    assert [pdo.cob_id for pdo in takes] == [0x205]
    unused = [channel.communication for channel in mapping.unused]
    assert unused == [0x1802, 0x1803, 0x1401, 0x1402, 0x1403]
    assert mapping.identity == (((0x1018, 1), 0xAD0), ((0x1018, 2), 0x402))
    assert mapping.counter_modulus is None
    changes = {"bus/sync": "drive", "signals/counter": "Boost stage.Half cycles"}
    assert plan(changes).counter_modulus == 65536


@pytest.mark.parametrize("reference", ["0x2001.2", "0x2001.02", "0X2001.2", "Load.Tachometer"])
def test_an_object_is_named_by_number_or_by_name(reference: str) -> None:
    mapping = plan({"signals/output": {"signal": reference, "scale": 1e-6}})
    (output,) = [source for source in mapping.sources if source.quantity == "output"]
    assert output.item.address == (0x2001, 2)
    assert (output.scale, output.offset) == (1e-6, 0.0)


@pytest.mark.parametrize(
    ("described", "has"),
    [
        ("DataType=0x0006\nHighLimit=0x1F", "16 bits from 0 to 31"),
        ("DataType=0x0006\nLowLimit=0x06", "16 bits from 6 to 65535"),
        ("DataType=0x0005", "8 bits from 0 to 255"),
    ],
)
def test_an_eds_that_keeps_a_controlword_from_being_sent_is_refused(
    described: str, has: str, tmp_path: Path
) -> None:
    head = "[6040]\nParameterName=Controlword\nObjectType=0x7\n"
    eds = other_eds(tmp_path, (f"{head}DataType=0x0006", f"{head}{described}"))
    found = flaws({"bus/eds": str(eds)})
    assert f"0x6040 has {has}" in found["bus.eds"]


def test_a_drive_without_a_reaction_to_a_missing_daemon_is_warned_of(tmp_path: Path) -> None:
    eds = other_eds(tmp_path, without("6007"))
    (caution,) = plan({"bus/eds": str(eds)}).cautions
    assert caution.place == "bus.eds"
    assert "has no 0x6007: the daemon cannot make the drive disable its voltage" in caution.message
    assert plan().cautions == ()


@pytest.mark.parametrize(
    ("index", "words"),
    [
        ("1005", "has no 0x1005: its SYNC is taken to be 0x080"),
        ("1016", "has no 0x1016.1: the drive is asked for it, and not used without"),
    ],
)
def test_what_an_eds_may_leave_out_is_warned_of(tmp_path: Path, index: str, words: str) -> None:
    eds = other_eds(tmp_path, without(index))
    (caution,) = plan({"bus/eds": str(eds)}).cautions
    assert (caution.place, words in caution.message) == ("bus.eds", True)


def test_an_error_code_that_travels_in_no_pdo_is_left_to_the_emergencies(tmp_path: Path) -> None:
    entry = "ParameterName=Error code\nObjectType=0x7\nDataType=0x0006\nAccessType=ro\n"
    mapped = f"{entry}DefaultValue=0\nPDOMapping="
    eds = other_eds(tmp_path, (f"{mapped}1", f"{mapped}0"))
    found = flaws({"bus/eds": str(eds), "signals/fault": ["0x603F"]})["signals.fault"]
    assert "does not send 'Error code' in a PDO: leave it out, its emergencies" in found


def test_one_object_may_be_two_quantities() -> None:
    mapping = plan({"signals/output": {"signal": "0x6079", "scale": 1e-3}})
    labels = [entry.label for pdo in mapping.sent for entry in pdo.entries]
    assert labels.count("0x6079") == 1
    assert {"output", "boost_voltage_V"} <= {source.quantity for source in mapping.sources}


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("signals/output", "Load.Tacho", "did you mean 'Load.Tachometer'?"),
        ("signals/output", "0x2001.7", "no object '0x2001.7'"),
        ("signals/output", "0x2001", "has members: name one of them"),
        ("signals/output", "0x1008", "no number"),
        ("signals/output", "0x1017", "does not send"),
        ("signals/fault", "0x2001.3", "no object"),
        ("signals/fault", "0x2000.3", "must be an integer"),
        ("signals/command/boost_reference_V", "0x6079", "does not take"),
        ("signals/bridge", "0x6041", "the statusword 0x6041 contains it"),
        ("signals/command/bridge", "0x6040", "the controlword 0x6040"),
        ("signals/command/reset", "0x6040", "the controlword 0x6040"),
        ("signals/counter", "0x2000.2", "makes the daemon the clock"),
        ("signals/command/boost_reference_V", None, "is missing"),
        ("bus/own_node_id", 5, "5 is the drive's own node id"),
        ("bus/heartbeat_timeout_s", 0.02, "greater than or equal to 0.025"),
        ("bus/node_id", 128, "less than or equal to 127"),
        ("bus/channel", "can0", "an IPv4 multicast group"),
        ("bus/eds", "none.eds", "no such file"),
        ("bus/eds", "motor.toml", "is no .eds and no .dcf file"),
        ("bus/setup/0x6040", 15, "is written by the daemon itself"),
        ("bus/setup/0x1016.1", 0, "is written by the daemon itself"),
        ("bus/setup/0x6007", 0, "is written by the daemon itself"),
        ("bus/setup/0x1A00.0", 0, "is written by the daemon itself"),
        ("bus/setup/0x2000.4", 300, "is written by the daemon itself"),
        ("bus/setup/0x6060", 128, "128 is outside -128…127"),
        ("bus/setup/0x6060", 1.5, "would be sent as 2"),
        ("bus/setup/0x6061", 1, "cannot be written"),
        ("bus/setup/Mode", 1, "no object 'Mode'"),
    ],
)
def test_each_flaw_is_told_with_its_place(key: str, value: object, message: str) -> None:
    ((place, found),) = flaws({key: value}).items()
    assert place == key.replace("/", ".")
    assert message in found


def test_all_flaws_are_told_at_once() -> None:
    changes = {"signals/output": "Nothing", "signals/load_power_W": "0x9999", "bus/setup/0x6040": 1}
    assert set(flaws(changes)) == {"signals.output", "signals.load_power_W", "bus.setup.0x6040"}


@pytest.mark.parametrize(
    ("index", "consequence"),
    [
        ("1017", "0x1017: its heartbeat could not be monitored"),
        ("6040", "0x6040: it is no CiA 402 drive"),
        ("6041", "0x6041: it is no CiA 402 drive"),
    ],
)
def test_a_drive_that_cannot_be_kept_safe_is_refused(
    tmp_path: Path, index: str, consequence: str
) -> None:
    eds = other_eds(tmp_path, without(index))
    assert consequence in flaws({"bus/eds": str(eds)})["bus.eds"]


def test_a_drive_with_too_few_pdos_is_refused(tmp_path: Path) -> None:
    eds = other_eds(tmp_path, without("1801"), without("1802"), without("1803"))
    assert flaws({"bus/eds": str(eds)}) == {
        "signals": "128 bits do not fit into the drive's 1 TPDOs"
    }


def test_a_mapping_that_is_fixed_is_refused(tmp_path: Path) -> None:
    fixed = "[1A00sub0]\nParameterName=Number of mapped objects\nObjectType=0x7\nDataType=0x0005\n"
    eds = other_eds(tmp_path, (f"{fixed}AccessType=rw", f"{fixed}AccessType=const"))
    assert flaws({"bus/eds": str(eds)}) == {"bus.eds": "the mapping of TPDO1 cannot be changed"}


@pytest.mark.parametrize(("offset_V", "safe"), [(0.4, False), (-7.0, True)])
def test_a_safe_command_between_two_counts_is_refused(
    tmp_path: Path, offset_V: float, *, safe: bool
) -> None:
    reference = "[2000sub4]\nParameterName=Voltage reference\nObjectType=0x7\nDataType="
    eds = other_eds(tmp_path, (f"{reference}0x0008", f"{reference}0x0003"))
    signal = {"signal": "Boost stage.Voltage reference", "offset": offset_V}
    found = flaws({"bus/eds": str(eds), "signals/command/boost_reference_V": signal})
    place = "signals.command.boost_reference_V"
    problem = "0 would be sent as 0.4: it could not be safe"
    assert found == ({} if safe else {place: problem})


@pytest.mark.parametrize("spoilt", ["DataType=zzz", "DataTypo=0x0007", "= = ="])
def test_a_spoilt_object_is_a_flaw_for_who_uses_it(tmp_path: Path, spoilt: str) -> None:
    sound = "[6079]\nParameterName=DC link circuit voltage\nObjectType=0x7\nDataType=0x0007\n"
    eds = other_eds(tmp_path, (sound, sound.replace("DataType=0x0007", spoilt)))
    found = flaws({"bus/eds": str(eds)})
    assert set(found) == {"signals.boost_voltage_V"}
    assert "[6079] is left out: it has" in found["signals.boost_voltage_V"]
    other = {"signals/boost_voltage_V": {"signal": "0x2001.1", "scale": 0.001}}
    assert flaws({"bus/eds": str(eds), **other}) == {}
