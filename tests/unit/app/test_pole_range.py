"""Poles whose fixed gains stand an error of the model: the file's must, and a command's too."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np
import pytest

from adaptdrive.analysis.replay import reconfigured
from adaptdrive.app.check_report import sound_report, tables
from adaptdrive.app.examine import implausible
from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings, machine_limits, operator_profile
from adaptdrive.config import Configuration, load_configuration
from adaptdrive.control.design.pole_placement import Plant, discrete_model
from adaptdrive.runtime.requests import SetPole
from adaptdrive.runtime.state_machine import Machine
from adaptdrive.util.errors import RefusedError

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"


def configured(name: str, *changes: str) -> Configuration:
    path = EXAMPLES / f"{name}.toml"
    return reconfigured(path.read_text(encoding="utf-8"), path, changes)


def ask(configuration: Configuration, pole: float) -> float:
    """The pole in force after a command."""
    machine = Machine(machine_limits(configuration))
    machine.carry_out(SetPole(pole), 0, math.nan, None)
    return machine.pole


def worst_radius(configuration: Configuration, pole: float, error: float) -> float:
    """Largest pole of the fixed loop with the loads at the corners of the box, by numpy."""
    settings, load = controller_settings(configuration), build_load(configuration)
    values, period_s = load.physical([*load.numerator], [*load.denominator]), 1.0
    models = [
        discrete_model(settings, load, *load.realise(list(np.multiply(values, shares))), period_s)
        for shares in itertools.product((1.0, 1.0 - error, 1.0 + error), repeat=len(values))
    ]
    nominal = Plant(*models[0])
    gains = nominal.gains(nominal.asked(pole))
    taps = len(gains) - load.order - 1
    radii = []
    for a, b in models:
        forward, back = np.convolve(a, [1.0, *gains[:taps]]), np.convolve(b, gains[taps:])
        length = max(len(forward), len(back))
        padded = [np.pad(one, (0, length - len(one))) for one in (forward, back)]
        radii.append(float(np.abs(np.roots(padded[0] + padded[1])).max()))
    return max(radii)


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.toml")), ids=lambda path: path.stem)
def test_every_example_may_be_asked_for_its_own_pole(path: Path) -> None:
    configuration = load_configuration(path)
    assert ask(configuration, configuration.load.pole) == configuration.load.pole


@pytest.mark.parametrize(("filter_s", "slowest"), [(10.0, 0.97), (5.0, 0.95), (2.0, 0.92)])
def test_a_pole_too_slow_for_an_error_of_the_model_is_refused(
    filter_s: float, slowest: float
) -> None:
    configuration = configured("motor", f"load.model.tau_filter_s={filter_s}")
    assert ask(configuration, slowest) == slowest
    assert worst_radius(configuration, slowest, 0.1) < 1.0
    assert worst_radius(configuration, slowest + 0.01, 0.1) > 1.0
    with pytest.raises(RefusedError, match=f"is outside 0.5…{slowest:g}"):
        ask(configuration, slowest + 0.01)


def test_a_file_whose_pole_does_not_stand_is_refused_with_those_that_do() -> None:
    flaws = list(implausible(configured("motor-modbus-tcp", "load.pole=0.98")))
    assert [one.place for one in flaws] == ["load.pole"]
    assert "poles of 0.5…0.97 do" in flaws[0].message


def test_check_and_operators_see_the_poles_that_may_be_asked_for() -> None:
    configuration = configured("motor")
    assert "0.5…0.97" in tables(configuration, EXAMPLES / "motor.toml")
    assert sound_report(configuration, EXAMPLES / "motor.toml")["poles"] == [0.5, 0.97]
    limits = operator_profile(configuration).limits
    assert limits is not None
    assert limits["pole"] == (0.5, 0.97)
