"""Values that can be used but are probably not meant give a warning with the figures."""

from __future__ import annotations

from pathlib import Path

import pytest

from adaptdrive.app.examine import advice, implausible
from adaptdrive.config import load_configuration
from tests.unit.config.modbus_documents import parse

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.toml")), ids=lambda path: path.stem)
def test_every_example_is_plausible_and_needs_no_advice(path: Path) -> None:
    configuration = load_configuration(path)
    assert list(implausible(configuration)) == []
    assert [one for one in advice(configuration) if "password" not in one.place] == []


@pytest.mark.parametrize(
    ("cycle_ms", "clock_ticks", "timeout_s", "named"),
    [
        (80, 1, None, []),
        (81, 1, None, ["message 'DriveStatus' comes every 81 ms: after 80 ms"]),
        (500, 1, None, ["message 'DriveStatus' comes every 500 ms: after 80 ms"]),
        (500, 1, 0.58, ["message 'DriveStatus' comes every 500 ms: after 80 ms"]),
        (500, 1, 0.59, []),
        (0, 1, None, ["message 'DriveStatus' has no GenMsgCycleTime: after 80 ms"]),
        (0, 1, 1.0, []),
        (240, 12, None, []),
        (260, 12, None, ["message 'DriveStatus' comes every 260 ms: after 250 ms"]),
    ],
)
def test_a_report_of_the_bridge_that_comes_too_seldom_is_named(
    tmp_path: Path, cycle_ms: int, clock_ticks: int, timeout_s: float | None, named: list[str]
) -> None:
    text = (EXAMPLES / "adaptdrive.dbc").read_text(encoding="utf-8")
    text = text.replace("BO_ 256 8;", f"BO_ 256 {cycle_ms};")
    (tmp_path / "seldom.dbc").write_text(text, encoding="utf-8")
    configuration = load_configuration(EXAMPLES / "motor.toml")
    bus = {
        "database": [tmp_path / "seldom.dbc"],
        "clock_ticks": clock_ticks,
        "command_timeout_s": timeout_s,
    }
    configuration = configuration.model_copy(
        update={
            "bus": configuration.bus.model_copy(update=bus),
            "voltage_loop": configuration.voltage_loop.model_copy(update={"where": "drive"}),
            "interlocks": configuration.interlocks.model_copy(update={"stale_s": 0.3}),
        }
    )
    flaws = [one for one in advice(configuration) if one.place == "signals.bridge"]
    assert [one.message[: len(words)] for one, words in zip(flaws, named, strict=True)] == named


@pytest.mark.parametrize(
    ("framing", "timeout_s", "stale_s", "named"),
    [
        ("tcp", 0.05, 0.25, None),  # 1.5 polls of 0.1 s, and two lost replies
        ("tcp", 0.06, 0.25, "0.25 s is shorter than 0.27 s"),
        ("rtu", 0.05, 0.45, None),  # a line that is not numbered falls silent for three time-outs
        ("rtu", 0.05, 0.44, "0.44 s is shorter than 0.45 s"),
    ],
)
def test_a_stale_limit_that_two_lost_replies_reach_is_named(
    framing: str, timeout_s: float, stale_s: float, named: str | None
) -> None:
    changes = {"bus__framing": f'"{framing}"', "bus__timeout_s": f"{timeout_s}"}
    flaws = advice(parse(**changes, interlocks__stale_s=f"{stale_s}"))
    found = [one.message for one in flaws if one.place == "interlocks.stale_s"]
    assert [one.partition(",")[0] for one in found] == ([] if named is None else [named])
