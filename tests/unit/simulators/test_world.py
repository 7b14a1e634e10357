"""The plant as a whole: delay, energy, rest, noise, determinism."""

import itertools
import math
import statistics

import pytest
from scipy.integrate import solve_ivp

from adaptdrive_sim.plants.boost import LineParameters, Sample
from adaptdrive_sim.plants.motor import Motor, MotorParameters
from adaptdrive_sim.world import NoiseParameters, World


def rough() -> World:
    noise = NoiseParameters(sigma=0.01, spike_share=0.02, spike_sigma=0.1)
    return World(Motor(MotorParameters()), line=LineParameters(drift_Hz=0.1), noise=noise, seed=7)


def run(plant: World, ticks: int) -> list[Sample]:
    return [plant.step(0.03 + 0.02 * math.sin(0.01 * n), n % 500 < 400) for n in range(ticks)]


def test_the_same_seed_gives_the_same_samples_bit_for_bit() -> None:
    assert run(rough(), 2000) == run(rough(), 2000)


def test_a_command_acts_one_half_cycle_after_its_frame() -> None:
    plant = World(Motor(MotorParameters()))
    at_rest_V = plant.boost.voltage_V
    first = plant.step(0.1, bridge=True)
    second = plant.step(0.0, bridge=False)
    third = plant.step(0.0, bridge=False)
    assert first.boost_voltage_V == pytest.approx(at_rest_V)
    assert first.load_current_A == 0.0
    assert second.boost_voltage_V > at_rest_V + 10.0
    assert second.load_current_A > 0.0
    assert third.load_current_A == 0.0


def test_settled_at_280_V_the_plant_has_its_published_operating_point_and_keeps_it() -> None:
    plant = World(Motor(MotorParameters()))
    plant.settle(280.0)
    scale_S = plant.current_scale_S
    for _ in range(12_000):
        sample = plant.step(scale_S, bridge=True)
    assert sample.boost_voltage_V == pytest.approx(280.0, rel=1e-9)
    assert sample.load_power_W == pytest.approx(437.5, rel=1e-9)
    assert plant.load.state()["speed_rad_s"] == pytest.approx(150.0, rel=1e-9)


def test_stage_and_motor_together_agree_with_an_independent_integrator() -> None:
    plant, own = World(Motor(MotorParameters())), MotorParameters()
    plant.settle(273.0)
    start = [273.0**2, plant.load.emf_V / own.constant_Vs, plant.true_output]
    scale_S = 0.1
    plant.current_scale_S = scale_S

    def slope(_: float, state: list[float]) -> list[float]:
        v = math.sqrt(state[0])
        current = (0.25 * v - own.constant_Vs * state[1]) / 4.0
        return [
            2000.0 * (scale_S * 120.0**2 - v * 0.25 * current),
            (own.constant_Vs * current - own.friction_Nms * state[1]) / own.disk_kgm2,
            (own.tachometer_Vs * state[1] - state[2]) / own.filter_s,
        ]

    true = solve_ivp(slope, (0.0, 1.0), start, rtol=1e-11, atol=1e-9).y[:, -1]
    for _ in range(120):
        sample = plant.step(scale_S, bridge=True)
    assert sample.boost_voltage_V == pytest.approx(math.sqrt(true[0]), abs=0.02)
    assert plant.load.state()["speed_rad_s"] == pytest.approx(true[1], abs=2e-3)
    assert sample.output == pytest.approx(true[2], abs=2e-5)


def test_the_noise_has_the_asked_deviation_and_leaves_the_truth_alone() -> None:
    plant = World(Motor(MotorParameters()), noise=NoiseParameters(sigma=0.004))
    plant.settle(280.0)
    scale_S = plant.current_scale_S
    errors = [plant.step(scale_S, bridge=True).output - plant.true_output for _ in range(8000)]
    assert statistics.fmean(errors) == pytest.approx(0.0, abs=2e-4)
    assert statistics.stdev(errors) == pytest.approx(0.004, rel=0.05)
    assert plant.true_output == pytest.approx(280.0 * plant.truth()["gain"], rel=1e-9)


def test_the_line_drifts_within_its_bounds_and_reaches_them() -> None:
    samples = run(rough(), 12_000)
    frequencies = [0.5 / sample.tick_period_s for sample in samples]
    assert (min(frequencies), max(frequencies)) == pytest.approx((59.9, 60.1), abs=1e-3)


@pytest.mark.parametrize("line", [LineParameters(), LineParameters(drift_Hz=1e-9)])
def test_a_sag_takes_its_share_for_its_time(line: LineParameters) -> None:
    plant = World(Motor(MotorParameters()), line=line)
    plant.step(0.0, bridge=False)
    plant.line.sag(0.2, 0.1)
    voltages = [plant.step(0.0, bridge=False).line_voltage_V for _ in range(40)]
    runs = [(round(v), len(list(same))) for v, same in itertools.groupby(voltages, round)]
    assert runs == [(96, 12), (120, 28)]
