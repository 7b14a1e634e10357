"""What `check` prints of the lowest output that is believed, against the watch itself."""

from __future__ import annotations

from dataclasses import replace

import pytest

from adaptdrive.analysis.replay import reconfigured
from adaptdrive.app.check_report import tables
from adaptdrive.app.loads import response_limits
from adaptdrive.cli.configuration import check
from adaptdrive.config import load_configuration
from adaptdrive.safety.facts import Reading
from adaptdrive.safety.plausibility import Response, ResponseLimits
from tests.unit.devices.bench import EXAMPLES
from tests.unit.runtime.bench import CALM


def limits(example: str) -> ResponseLimits:
    found = response_limits(load_configuration(EXAMPLES / f"{example}.toml"))
    assert found is not None
    return found


def printed(table: str, what: str) -> float:
    line = next(line for line in table.splitlines() if line.startswith(what))
    return float(line.removeprefix(what).split()[0])


def at_largest_input(found: ResponseLimits, output: float, time_s: float) -> Reading:
    voltage_V = (found.input_max / found.input_gain) ** (1.0 / found.input_exponent)
    return replace(CALM, arrival_s=time_s, boost_voltage_V=voltage_V, output=output)


@pytest.mark.parametrize("example", ["motor", "bath"])
def test_the_printed_level_is_where_it_trips(example: str) -> None:
    found = limits(example)
    path = EXAMPLES / f"{example}.toml"
    shown = tables(load_configuration(path), path)
    level = printed(shown, "trips at rest, largest input, below")
    step_s = sum(found.lags_s) / 10.0
    for output, trips in ((level + 0.01 * found.reference_range, False), (0.9 * level, True)):
        watch = Response(found)
        causes = [
            watch.find_cause(at_largest_input(found, output, n * step_s)) for n in range(1000)
        ]
        assert (causes[-1] is not None) is trips


@pytest.mark.parametrize("example", ["motor", "bath", "battery"])
def test_check_prints_the_factor_in_force(example: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert check(EXAMPLES / f"{example}.toml") == 0
    in_force = 2 if example == "battery" else 4
    assert f"interlocks.response_factor, in force: {in_force}" in capsys.readouterr().out


def test_without_a_factor_nothing_trips() -> None:
    path = EXAMPLES / "motor.toml"
    configuration = reconfigured(
        path.read_text(encoding="utf-8"), path, ["interlocks.response_factor=0.0"]
    )
    assert "never  interlocks.response_factor = 0" in tables(configuration, path)
