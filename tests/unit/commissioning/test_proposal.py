"""Proposed settings against the true load, which neither experiment nor proposal knows."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from adaptdrive.analysis.curves import Response
from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings
from adaptdrive.commissioning.course import Samples
from adaptdrive.commissioning.evaluation import evaluate, predict
from adaptdrive.commissioning.experiment import load_experiment
from adaptdrive.commissioning.proposal import Proposal, propose
from adaptdrive.control.design.pole_placement import Plant, discrete_model
from adaptdrive.control.loads.motor import motor_load
from adaptdrive.identification import identify
from adaptdrive.identification.excerpt import Excerpt
from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import Enable, SetSetpoint
from adaptdrive_sim import parameters
from adaptdrive_sim.plants.boost import CouplingParameters
from adaptdrive_sim.site import OperatedDrive
from adaptdrive_sim.world import World
from tests.integration.wire.rig import EXAMPLES
from tests.support import sample
from tests.unit.commissioning.draws import KINDS, Draw, Rig, finish
from tests.unit.identification.plants import open_loop, random_voltage

RAISED_V = 40.0
"""Distance from the lowest V_c: a torque takes the rest below what the model reaches."""


@cache
def proposed(kind: str, seed: int) -> tuple[Draw, Proposal, Response, float]:
    """A draw, what commissioning proposes for it, what it predicts, and the voltage before."""
    random = np.random.default_rng([seed, 15])
    draw = KINDS[kind](random)
    found = load_experiment(draw.target)
    finish(found, Rig(draw, random))
    assert found.outcome is not None
    load = build_load(draw.configuration)
    identified = evaluate(found.record, found.outcome, [load])
    proposal = propose(identified, draw.text, parameters.EXAMPLES / "drawn.toml")
    rest_V = draw.target.middle_V(found.outcome.low_V, found.outcome.high_V)
    prediction = predict(identified, proposal.configuration, rest_V, draw.target.move)
    return draw, proposal, prediction, rest_V


def roots(proposal: Proposal, factor: float) -> float:
    """Largest pole of the proposed loop around a load with so many times the gain."""
    configuration = proposal.configuration
    load, settings = build_load(configuration), controller_settings(configuration)
    section = configuration.load
    model = (list(load.numerator), list(load.denominator))
    plant = Plant(*discrete_model(settings, load, *model, section.period_s))
    gains = plant.gains(plant.asked(section.pole))
    closed = Plant(plant.a, [factor * one for one in plant.b]).closed(gains)
    return float(np.abs(np.roots(closed)).max())


@pytest.mark.parametrize(
    "kind", ["battery", "motor", pytest.param("bath", marks=pytest.mark.proof)]
)
@pytest.mark.parametrize("seed", sample([2, 0, 1], 1))
def test_the_gain_margin_is_where_the_loop_becomes_unstable(kind: str, seed: int) -> None:
    _, proposal, _, _ = proposed(kind, seed)
    assert roots(proposal, 1.0) < 1.0
    assert roots(proposal, 0.98 * proposal.margins.gain) < 1.0
    assert roots(proposal, 1.02 * proposal.margins.gain) > 1.0


@pytest.mark.parametrize("seed", sample([2, 0, 1], 1))
def test_a_motor_responds_as_predicted(seed: int) -> None:
    draw, proposal, prediction, rest_V = proposed("motor", seed)
    drive = settled(draw, proposal, rest_V)
    rest, samples = drive.world.true_output, proposal.configuration.ticks_per_period
    drive.carry_out(SetSetpoint(rest + draw.target.move))
    outputs = []
    for _ in range(40 * samples):
        drive.tick()
        outputs.append(drive.world.true_output - rest)
    means = np.array(outputs).reshape(-1, samples).mean(axis=1)
    after = prediction.output[prediction.time_s > 0.0][: len(means)]
    before = prediction.output[prediction.time_s < 0.0][-1]
    error = np.sqrt(np.mean((means - (after - before)) ** 2))
    assert drive.machine.trip is None
    assert error < 0.1 * draw.target.move


def settled(draw: Draw, proposal: Proposal, rest_V: float) -> OperatedDrive:
    """The proposed drive with the true load, at rest."""
    coupling = CouplingParameters(ratio=draw.ratio, droop_Ohm=draw.droop_Ohm)
    world = World(draw.load, coupling=coupling)
    world.settle(rest_V + RAISED_V)
    rest = world.true_output
    drive = OperatedDrive(proposal.configuration, world)
    drive.tick()
    drive.carry_out(Enable())
    while drive.machine.state is not State.RUNNING:
        drive.tick()
    drive.carry_out(SetSetpoint(rest))
    for _ in range(60 * proposal.configuration.ticks_per_period):
        drive.tick()
    return drive


@pytest.mark.parametrize("kind", sample(sorted(KINDS, key="motor".__ne__), 1))
def test_the_proposed_configuration_has_the_identified_load(kind: str) -> None:
    draw, proposal, prediction, _ = proposed(kind, 2)
    load = build_load(proposal.configuration)
    values = load.physical(list(load.numerator), list(load.denominator))
    for name, value in zip(load.names, values, strict=True):
        assert value == pytest.approx(draw.truth[name], rel=0.3)
    assert proposal.margins.gain >= 1.75
    assert prediction.quality.overshoot < 0.1
    assert prediction.quality.unsettled == 0


@pytest.mark.parametrize("seed", sample([2, 0, 1], 1))
def test_the_bounds_are_those_that_the_slow_period_suits(seed: int) -> None:
    draw, proposal, _, _ = proposed("motor", seed)
    section = proposal.configuration.supervisor
    periods = draw.truth["tau_sum_s"] / proposal.configuration.load.period_s
    assert 0.1 <= section.ratio_min <= 0.5
    assert 4.0 <= section.ratio_max <= 10.0
    assert section.ratio_min * periods == pytest.approx(4.0, rel=0.2)
    assert section.ratio_max * periods == pytest.approx(120.0, rel=0.2)
    assert "supervisor.ratio_max" in proposal.values


@pytest.mark.parametrize(("noise", "named"), [(0.002, True), (0.05, False)])
def test_the_step_of_a_coarse_sensor_is_proposed(noise: float, named: bool) -> None:
    random, samples = np.random.default_rng(0), Samples()
    for number in range(2000):
        output = 2.0 + 0.1 * np.sin(0.005 * number) + noise * random.standard_normal()
        samples.append(0.1 * number, 200.0, 0.02 * round(output / 0.02))
    assert samples.coarseness() == pytest.approx(0.02 if named else 0.0)


@pytest.mark.parametrize(("line_Hz", "period_s"), [(60, 0.3), (50, 0.48)])
def test_the_slow_period_of_a_polled_drive_is_whole_polls(line_Hz: int, period_s: float) -> None:
    truth = motor_load(0.0085, 0.9, 0.35)
    volts = random_voltage(np.random.default_rng(1), 3000)
    record = Excerpt(volts, open_loop(truth, volts, 0.1), 0.1)
    file = EXAMPLES / "motor-modbus-tcp.toml"
    text = file.read_text(encoding="utf-8").replace("period_s = 1.0 ", "period_s = 1.2 ")
    text = text.replace("line_frequency_Hz = 60", f"line_frequency_Hz = {line_Hz}")
    found = propose(identify([record], truth, longest_delay=0), text.replace("0.35 ", "0.5 "), file)
    assert found.configuration.load.period_s == pytest.approx(period_s, rel=1e-9)
    assert len(str(found.values["load.period_s"])) <= 6
