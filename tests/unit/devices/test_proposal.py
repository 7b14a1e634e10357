"""Which signal of a foreign description is proposed for a quantity."""

from __future__ import annotations

from pathlib import Path

import pytest

from adaptdrive.app.examine import load_examined
from adaptdrive.cli import main
from adaptdrive.config.bus import CanBus
from adaptdrive.devices.description import Candidate, propose, wanted_by


def candidate(
    reference: str,
    *,
    unit: str = "",
    bits: int = 16,
    sent: bool = False,
    names: tuple[str, ...] = (),
) -> Candidate:
    return Candidate(reference, reference, unit, "", sent, names, bits)


def likeliest(quantity: str, *given: Candidate) -> str | None:
    wanted = wanted_by("motor")[quantity]
    return next((one.reference for one in propose(wanted, given)), None)


def test_a_number_of_the_bus_is_no_set_point() -> None:
    number = candidate("Cmd.Set_Node_ID", bits=32, sent=True)
    assert likeliest("command.boost_reference_V", number) is None
    real = candidate("Cmd.Voltage_Set", unit="V", sent=True)
    assert likeliest("command.boost_reference_V", number, real) == "Cmd.Voltage_Set"


def test_a_flag_is_no_speed() -> None:
    flag = candidate("M170.INV_Low_Speed_Limiting", bits=1)
    speed = candidate("M165.INV_Motor_Speed", unit="rpm")
    assert likeliest("output", flag) is None
    assert likeliest("output", flag, speed) == "M165.INV_Motor_Speed"


@pytest.mark.parametrize("name", ["Inverter_Enable_Lockout", "Bridge_Off", "Run_Inhibit"])
def test_a_bit_that_means_off_is_no_bridge(name: str) -> None:
    wrong, right = candidate(f"S.{name}", bits=1), candidate("S.Inverter_Enabled", bits=1)
    assert likeliest("bridge", wrong) is None
    assert likeliest("bridge", wrong, right) == "S.Inverter_Enabled"


@pytest.mark.parametrize(
    ("quantity", "given"),
    [
        ("output", candidate("NLG5_ACT_I.NLG5_MV_ACT", unit="V")),
        ("output", candidate("Speed.DcLinkVoltage", unit="V")),
        ("output", candidate("Cmd.SpeedLimit", unit="rpm")),
        ("boost_voltage_V", candidate("DcLink.Temperature")),
        ("line_voltage_V", candidate("Supply.PowerSupply")),
        ("load_power_W", candidate("DriveLoad.HalfCycle")),
        ("load_power_W", candidate("Load.PowerLimit", unit="W")),
        ("counter", candidate("Counts.ErrorCount")),
        ("bridge", candidate("Status.Duty")),
        ("bridge", candidate("D3_TX.STATUS")),
        ("bridge", candidate("x1D4.ChargeStatus", bits=1)),
        ("bridge", candidate("x1DB.LB_MainRelayOn_flag", bits=1)),
        ("bridge", candidate("M171.INV_Run_Fault_Lo")),
        ("command.boost_reference_V", candidate("Set_Axis_State.Axis_Requested_State", sent=True)),
        ("command.bridge", candidate("Set_Controller.Control_State", bits=32, sent=True)),
    ],
)
def test_a_signal_of_another_meaning_is_not_proposed(quantity: str, given: Candidate) -> None:
    """The name of its message, a word such as `act` and a unit alone say nothing."""
    assert likeliest(quantity, given) is None


def test_a_state_is_a_bridge_where_one_of_its_names_means_on() -> None:
    state = candidate("INV.STATE", names=("idle", "run", "fault"))
    assert likeliest("bridge", state) == "INV.STATE"


CHARGER = """VERSION ""
BU_: C H
BO_ 256 State: 8 C
 SG_ OutCurrent : 0|16@1+ (0.1,0) [0|100] "A" H
 SG_ LinkVoltage : 16|16@1+ (0.1,0) [0|500] "V" H
 SG_ LineVoltage : 32|16@1+ (0.1,0) [0|500] "V" H
 SG_ LoadPower : 48|16@1+ (1,0) [0|5000] "W" H
{more}
BO_ 257 Control: 8 H
 SG_ VoltageSet : 0|16@1+ (0.1,0) [0|500] "V" C
 SG_ Run : 16|1@1+ (1,0) [0|1] "" C

BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 256 1000;
"""


def test_what_is_written_for_a_slow_charger_passes_check(tmp_path: Path) -> None:
    (tmp_path / "c.dbc").write_text(CHARGER.format(more=""))
    words = ["--bus", "can", "--dbc", str(tmp_path / "c.dbc"), "--directory", str(tmp_path)]
    assert main(["init", "battery", *words, "--yes"]) == 0
    written = load_examined(tmp_path / "battery.toml")
    assert isinstance(written.bus, CanBus)
    assert (written.bus.clock_ticks, written.load.period_s) == (120, 10.0)


def test_what_no_signal_means_is_left_out_and_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "c.dbc").write_text(CHARGER.format(more=""))
    words = ["--bus", "can", "--dbc", str(tmp_path / "c.dbc"), "--directory", str(tmp_path)]
    assert main(["init", "battery", *words, "--yes"]) == 0
    named = "counter, fault, bridge, command.current_scale_S\n"
    assert f"left out, as no signal of the file means it: {named}" in capsys.readouterr().out
    assert "\nbridge = " not in (tmp_path / "battery.toml").read_text().partition("[signals.c")[0]


def test_yes_ends_at_a_doubt(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    twin = 'BO_ 258 More: 8 C\n SG_ LoadPower : 0|16@1+ (1,0) [0|5000] "W" H\n'
    (tmp_path / "c.dbc").write_text(CHARGER.format(more=twin))
    words = ["--bus", "can", "--dbc", str(tmp_path / "c.dbc"), "--directory", str(tmp_path)]
    assert main(["init", "battery", *words, "--yes"]) != 0
    assert "State.LoadPower or More.LoadPower? leave out --yes" in capsys.readouterr().err
    assert not (tmp_path / "battery.toml").exists()
