"""Rows of a long session: one simulated stretch of a motor with noise, repeated with later times.

Measurements have the resolution of the reference drive's messages. A stretch is longer than a row
group of a closed file, so that the repetition does not make the files smaller.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import msgspec
import numpy as np

from adaptdrive.config import load_configuration
from adaptdrive.control.signals import Command, Measurement, Mode, Order, Shape, Waveform
from adaptdrive.recording.records import EventRow, Ticks
from adaptdrive.runtime.reports import MONOTONIC, LoadReport, State, TickReport
from adaptdrive.runtime.requests import Enable, SetMode, SetSetpoint, SetWaveform
from adaptdrive_sim.site import OperatedDrive
from adaptdrive_sim.world import NoiseParameters, World, load_of
from tests.unit.recording.material import Batch, make_batch

CONFIG = Path(__file__).parents[2] / "deploy" / "examples" / "motor.toml"
TICKS_per_s = 120
STRETCH_s = 20 * 60
"""Length of the stretch: 144,000 ticks; a row group has 100,000."""

_NOISE = 2e-3
_WAVE = Waveform(Shape.SQUARE, 3.0, 3.2, 60.0)
_EVENT_EVERY_s = 600
_JITTER_s = 2e-4


class _Drive(OperatedDrive):
    """A drive that keeps the reports since they were last taken."""

    fast: list[TickReport]
    steps: list[LoadReport]
    number = 0
    chance = random.Random(1)

    def control(self, measurement: Measurement, order: Order) -> tuple[Command, bool]:
        measurement = replace(
            measurement,
            boost_voltage_V=round(measurement.boost_voltage_V, 2),
            line_voltage_V=round(measurement.line_voltage_V + self.chance.gauss(0.0, 0.2), 1),
            load_power_W=round(measurement.load_power_W, 1),
            output=round(measurement.output, 6),
        )
        command, decided = super().control(measurement, order)
        time_s = self.number / TICKS_per_s + self.chance.uniform(0.0, _JITTER_s)
        late_us, answered_us, took_us = (self.chance.gauss(300.0, 80.0) for _ in range(3))
        applied = self._schedule.applied_k
        times = (late_us, answered_us, took_us, time_s)
        one = TickReport(self.number, measurement, order, applied, command, *times)
        self.fast.append(one)
        self.number += 1
        if decided and self.snapshot is not None and self.decision is not None:
            self.steps.append(LoadReport(self.snapshot, self.decision, time_s))
        return command, decided


def stretch(seconds: int) -> list[Batch]:
    """Simulate so many seconds; a batch for each."""
    drive = _started()
    batches = []
    for _ in range(seconds):
        drive.fast, drive.steps = [], []
        while len(drive.fast) < TICKS_per_s:
            drive.tick()
        batches.append(make_batch(drive.fast, drive.steps))
    return batches


def _started() -> _Drive:
    configuration = load_configuration(CONFIG)
    world = World(load_of(configuration), noise=NoiseParameters(_NOISE))
    world.settle(world.boost_voltage_for(_WAVE.low))
    drive = _Drive(configuration, world)
    drive.fast, drive.steps = [], []
    drive.tick()
    drive.carry_out(Enable())
    while drive.machine.state is not State.RUNNING:
        drive.tick()
    for request in (SetSetpoint(_WAVE.low), SetMode(Mode.ADAPTIVE), SetWaveform(_WAVE)):
        drive.carry_out(request)
    drive.number = 0
    return drive


def repeated(batches: list[Batch], seconds: int, offset_s: float) -> Iterator[Batch]:
    """Yield a batch for each second of a long session.

    Args:
        batches: The stretch.
        seconds: Length of the session.
        offset_s: UTC minus the time of the session.
    """
    for second in range(seconds):
        rounds, index = divmod(second, len(batches))
        moved = _moved(batches[index], rounds * len(batches))
        event = EventRow(
            time=datetime.fromtimestamp(second + offset_s, UTC),
            tick=second * TICKS_per_s,
            kind="mode",
            severity="info",
            detail="mode fixed to adaptive",
            monotonic_s=float(second),
            number=second // _EVENT_EVERY_s + 1,
        )
        events = [] if second % _EVENT_EVERY_s else [event]
        yield msgspec.structs.replace(
            moved,
            events=events,
            utc_offset_s=offset_s,
            last=second + 1 == seconds,
        )


def _moved(batch: Batch, by_s: int) -> Batch:
    ticks = dict(batch.ticks.columns)
    for name in ("sequence", "tick"):
        ticks[name] = _plus(ticks[name], np.int64, by_s * TICKS_per_s)
    ticks[MONOTONIC] = _plus(ticks[MONOTONIC], np.float64, by_s)
    slow = [
        row | {MONOTONIC: row[MONOTONIC] + by_s, "tick": row["tick"] + by_s * TICKS_per_s}
        for row in batch.slow
    ]
    return msgspec.structs.replace(batch, ticks=Ticks(batch.ticks.rows, ticks), slow=slow)


def _plus(packed: bytes | list[str], kind: type[np.generic], by: float) -> bytes:
    values = np.frombuffer(bytes(packed), dtype=kind)  # type: ignore[arg-type]
    moved: bytes = np.add(values, by, dtype=kind).tobytes()
    return moved
