"""Random sequences of accepted commands to healthy drives, compiled or interpreted."""

from __future__ import annotations

import random
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings, daemon_settings
from adaptdrive.config.file import validate_configuration
from adaptdrive.config.root import Configuration
from adaptdrive.control.controller import Controller
from adaptdrive.control.signals import Mode
from adaptdrive.control.waveform import Shape, Waveform
from adaptdrive.errors import RefusedError
from adaptdrive.runtime.machine import Machine
from adaptdrive.runtime.requests import Request, SetSetpoint, SetWaveform
from adaptdrive_sim.course import Course, Run
from adaptdrive_sim.experiments.examples import FOLDER, example_tables
from adaptdrive_sim.plants.bath import Bath, BathParameters
from adaptdrive_sim.plants.load import SimulatedLoad
from adaptdrive_sim.plants.motor import Motor, MotorParameters
from adaptdrive_sim.site import Site
from adaptdrive_sim.world import World

HOLD_PERIODS = (2, 120)
COMMANDS = 4
OVERSHOOT = 0.6
"""Overshoot that a fixed controller may have with three times the nominal inertia."""


@dataclass(frozen=True)
class Sequence:
    """What is asked of a drive, and what its load is.

    Attributes:
        start: Output at rest at the start.
        references: Set-point of each slow period.
        mode: Controller asked for.
        pole: Closed-loop pole asked for.
        size: Size of the load over that of the model.
        sigma: Noise of each sample, in the unit of the output.
        seed: Of the noise.
    """

    start: float
    references: NDArray[np.float64]
    mode: Mode
    pole: float
    size: float
    sigma: float
    seed: int


@cache
def configuration(name: str) -> Configuration:
    return validate_configuration(example_tables(f"{name}.toml"), FOLDER / f"{name}.toml")


def drawn(name: str, seed: int) -> Sequence:
    """Commands over more than the whole range; the state machine refuses what it refuses."""
    draw, section = random.Random(f"{name} {seed}"), configuration(name).load
    limits = daemon_settings(configuration(name)).machine
    low, high = section.reference_min, section.reference_max
    start = draw.uniform(max(low, limits.reach.low), min(high, limits.reach.high))
    machine = Machine(limits, section.pole)
    machine.enable(start, None, 0)
    references: list[float] = []
    per_period = configuration(name).ticks_per_period
    for _ in range(COMMANDS):
        accept(machine, asked(draw, section.period_s, low, high), len(references) * per_period)
        for _ in range(draw.randint(*HOLD_PERIODS)):
            references.append(machine.reference(len(references) * per_period))
    return Sequence(
        start=start,
        references=np.array(references),
        mode=draw.choice([Mode.FIXED, Mode.ADAPTIVE]),
        pole=draw.uniform(section.pole, 0.95),
        size=draw.choice([1.0, draw.uniform(0.8, 2.0)]),
        sigma=draw.choice([0.0, 0.002]) * (high - low),
        seed=seed,
    )


def asked(draw: random.Random, period_s: float, low: float, high: float) -> Request:
    """Any set-point or waveform, at the ends of the reach oftener than elsewhere."""
    value = draw.choice([draw.uniform(low, high), 2.2, 4.4, 5.5])
    if draw.random() < 0.7:
        return SetSetpoint(value)
    other, cycle_s = draw.uniform(low, high), draw.uniform(4.0, 60.0) * period_s
    return SetWaveform(Waveform(draw.choice(list(Shape)), min(value, other), other, cycle_s))


def accept(machine: Machine, request: Request, tick: int) -> bool:
    """Carry a request out unless it is refused; coasting is for other tests."""
    if isinstance(request, SetSetpoint) and request.value <= 0.0:
        return False
    try:
        machine.carry_out(request, tick, 0.0, None, 0.0)
    except RefusedError:
        return False
    return True


def plant(name: str) -> SimulatedLoad:
    return Motor(MotorParameters()) if name == "motor" else Bath(BathParameters())


def run(name: str, sequence: Sequence, *, compiled: bool) -> str:
    """Run a sequence; what went wrong, or an empty string."""
    settings = controller_settings(configuration(name))
    course = Course(
        references=sequence.references,
        sizes=np.full(sequence.references.size, sequence.size),
        over_s=0.0,
        disturbances=noise(sequence, settings.rates.ticks_per_period),
        mode=sequence.mode,
        pole=sequence.pole,
        start=sequence.start,
    )
    load = plant(name)
    world = World(load)
    load.resize(sequence.size, 0.0)  # type: ignore[attr-defined]
    controller = Controller(settings, build_load(configuration(name)))
    found = Site(controller, world).run(course, compiled=compiled)
    return trip(found.interlock) or latch(found) or motion(sequence, found)


def noise(sequence: Sequence, ticks: int) -> NDArray[np.float64]:
    count = sequence.references.size * ticks + 1
    return sequence.sigma * np.random.default_rng(sequence.seed).standard_normal(count)


def trip(cause: int) -> str:
    return f"tripped, cause {cause}" if cause else ""


def latch(found: Run) -> str:
    latched = found["fallback"].max()
    return f"fell back, cause {latched:g}" if latched else ""


def motion(sequence: Sequence, found: Run) -> str:
    """Say where the output left what was asked for by more than an overshoot."""
    outputs, references = found["output"], sequence.references
    low = min(sequence.start, references.min())
    high = max(sequence.start, references.max())
    margin = OVERSHOOT * (high - low) + 5.0 * sequence.sigma + 0.01 * high
    if low - margin <= outputs.min() and outputs.max() <= high + margin:
        return ""
    return f"moved to {outputs.min():.3g}…{outputs.max():.3g}, asked for {low:.3g}…{high:.3g}"


def problems(name: str, seeds: range, *, compiled: bool) -> list[str]:
    """Run sequences; those that went wrong."""
    found = ((seed, run(name, drawn(name, seed), compiled=compiled)) for seed in seeds)
    return [f"{name} {seed}: {text}" for seed, text in found if text]
