"""Commands in pages: what cantools reads where several pages of a message carry a signal."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cantools
import pytest

from adaptdrive.config import load_configuration
from adaptdrive.config.bus import CanBus
from adaptdrive.control.signals import SAFE_COMMAND, Command
from adaptdrive.devices.can.mapping import map_drive
from adaptdrive.util.errors import ConfigurationError
from tests.unit.devices.bench import EXAMPLES, TIMING

_COMMAND = 2566872851
_RUN = replace(SAFE_COMMAND, boost_reference_V=300.0, bridge=True)

_SIGNALS = """ SG_ REQUEST m1 : 15|8@0+ (1,0) [0|255] ""  INV
 SG_ MODE m1 : 23|8@0+ (1,0) [0|255] ""  INV
 SG_ U_DC_SET m2 : 15|16@0+ (0.02,0) [0|600] "V"  INV
 SG_ I_LIMIT m2 : 31|16@0+ (0.05,0) [0|1600] "A"  INV
"""


def paged(*signals: tuple[str, str, str]) -> tuple[str, str]:
    """Signals of the command with what selects each, and their pages in the words of a DBC."""
    names = [(name.split()[0], pages) for name, _, pages in signals]
    return (
        "".join(f' SG_ {name} : {layout} "" INV\n' for name, layout, _ in signals),
        "".join(f"SG_MUL_VAL_ {_COMMAND} {name} {pages};\n" for name, pages in names),
    )


_SHARED = paged(
    ("REQUEST m1", "15|8@0+ (1,0) [0|255]", "CMD_PAGE 1-2"),
    ("MODE m1", "23|8@0+ (1,0) [0|255]", "CMD_PAGE 1-2"),
    ("U_DC_SET m2", "31|16@0+ (0.02,0) [0|600]", "CMD_PAGE 2-2"),
    ("I_LIMIT m2", "47|16@0+ (0.05,0) [0|1600]", "CMD_PAGE 2-2"),
)
"""Request and mode in both pages."""

_NESTED = paged(
    ("REQUEST m1", "15|8@0+ (1,0) [0|255]", "CMD_PAGE 1-1"),
    ("MODE m1", "23|8@0+ (1,0) [0|255]", "CMD_PAGE 1-1"),
    ("PART m1M", "31|8@0+ (1,0) [0|255]", "CMD_PAGE 1-1"),
    ("U_DC_SET m7", "39|16@0+ (0.02,0) [0|600]", "PART 7-7"),
    ("I_LIMIT m8", "39|16@0+ (0.05,0) [0|1600]", "PART 8-8"),
)
"""The voltage in a page within the page of request and mode."""

_UNCHOSEN = paged(
    ("REQUEST m1", "15|8@0+ (1,0) [0|255]", "CMD_PAGE 1-1"),
    ("MODE m1", "23|4@0+ (1,0) [0|15]", "CMD_PAGE 1-1"),
    ("PART m1M", "19|4@0+ (1,0) [0|15]", "CMD_PAGE 1-1"),
    ("U_DC_SET m1", "31|16@0+ (0.02,0) [0|600]", "CMD_PAGE 1-1"),
    ("I_LIMIT m8", "47|16@0+ (0.05,0) [0|1600]", "PART 8-8"),
)
"""A page within the page of all that is commanded, which nothing selects; it begins as 0."""


def frames(
    folder: Path, dbc: tuple[str, str], command: Command, **constants: float
) -> list[dict[str, Any]]:
    """The frames of a command, as cantools reads them; without a command the drive would run."""
    text = (EXAMPLES / "inverter.dbc").read_text()
    assert _SIGNALS in text
    start = f'BA_ "GenSigStartValue" SG_ {_COMMAND} REQUEST 85;\n'
    path = folder / "pages.dbc"
    path.write_text(text.replace(_SIGNALS, dbc[0]) + start + dbc[1])
    configuration = load_configuration(EXAMPLES / "motor-inverter.toml")
    assert isinstance(configuration.bus, CanBus)
    bus = configuration.bus.model_copy(update={"database": [path]})
    timing = replace(TIMING, stale_s=0.1, voltage_parts=frozenset())
    signals = configuration.signals
    signals.command.constants.update({f"HOST_CMD.{name}": constants[name] for name in constants})
    orders = map_drive(bus, signals, timing).orders
    message = cantools.database.load_file(path).get_message_by_name("HOST_CMD")  # type: ignore[union-attr]
    return [
        message.decode(order.encode(command), decode_choices=False)  # type: ignore[misc]
        for order in orders
    ]


@pytest.mark.parametrize("dbc", [_SHARED, _NESTED])
@pytest.mark.parametrize(("command", "request_"), [(SAFE_COMMAND, 0), (_RUN, 85)])
def test_every_frame_with_the_request_has_that_of_the_command(
    tmp_path: Path, dbc: tuple[str, str], command: Command, request_: int
) -> None:
    sent = frames(tmp_path, dbc, command)
    assert [frame["REQUEST"] for frame in sent] == [request_] * len(sent)
    assert [frame["MODE"] for frame in sent] == [2] * len(sent)


@pytest.mark.parametrize(("dbc", "count"), [(_SHARED, 2), (_NESTED, 1)])
def test_the_voltage_is_in_its_own_page_alone(
    tmp_path: Path, dbc: tuple[str, str], count: int
) -> None:
    sent = frames(tmp_path, dbc, _RUN)
    assert len(sent) == count
    (voltage,) = [frame["U_DC_SET"] for frame in sent if "U_DC_SET" in frame]
    assert voltage == pytest.approx(300.0)


def test_a_page_that_the_message_has_not_is_refused_until_one_is_named(tmp_path: Path) -> None:
    """It could not be encoded: the daemon would end with its first command."""
    problem = "'PART' is a multiplexer: it would be sent as 0, which is none of its pages"
    with pytest.raises(ConfigurationError, match=problem):
        frames(tmp_path, _UNCHOSEN, SAFE_COMMAND)
    (frame,) = frames(tmp_path, _UNCHOSEN, _RUN, PART=8.0)
    assert (frame["PART"], frame["REQUEST"], frame["U_DC_SET"]) == (8, 85, 300.0)
