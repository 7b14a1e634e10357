"""Sessions of every kind of load and every source of V_c, driven and recorded without waiting.

`python -m tools.builds.sessions record FOLDER SHARE` prints the build at hand, and records that
share of each course with it; `python -m tools.builds.sessions replay FOLDER` replays the sessions.
"""

from __future__ import annotations

import sys
from pathlib import Path

import msgspec

from adaptdrive import build_name
from adaptdrive.cli.sessions import replay
from adaptdrive.config import Configuration, load_configuration
from adaptdrive.control.signals import Command, Measurement, Mode, Order, Shape, Waveform
from adaptdrive.recording.records import Header
from adaptdrive.recording.session import create_session
from adaptdrive.runtime.reports import LoadReport, State, TickReport
from adaptdrive.runtime.requests import Enable, SetMode, SetSetpoint, SetVoltage, SetWaveform
from adaptdrive_sim.site import OperatedDrive
from adaptdrive_sim.world import NoiseParameters, World, load_of
from tests.unit.recording.material import INFO, make_batch, record_messages

EXAMPLES = Path(__file__).parents[2] / "deploy" / "examples"
NOISE = 1e-3
"""Standard deviation, as a share of the first set-point."""

KINDS = {
    "motor": (3.1, (3.0, 3.2), 120.0),
    "bath": (11.0, (10.0, 13.0), 1200.0),
    "battery": (2.0, (1.5, 2.5), 90.0),
}
"""First set-point, levels of the square wave, and length in s."""


class RecordedDrive(OperatedDrive):
    """A drive that keeps the reports of which a session is made."""

    def __init__(self, configuration: Configuration, world: World) -> None:
        super().__init__(configuration, world)
        self.reports: list[TickReport] = []
        self.slow: list[LoadReport] = []

    def control(self, measurement: Measurement, order: Order) -> tuple[Command, bool]:
        command, decided = super().control(measurement, order)
        number, applied = len(self.reports), self._schedule.applied_k
        self.reports.append(TickReport(number, measurement, order, applied, command, 0.0, 0.0))
        if decided and self.snapshot is not None and self.decision is not None:
            self.slow.append(LoadReport(self.snapshot, self.decision))
        return command, decided


def record_all(folder: Path, share: float) -> None:
    """Record a session of each load in each mode.

    Args:
        folder: Folder of the sessions.
        share: Part of the length of each session, 1 for the whole.
    """
    for kind, (first, levels, whole_s) in KINDS.items():
        length_s = share * whole_s
        path = EXAMPLES / f"{kind}.toml"
        configuration = load_configuration(path)
        wave = Waveform(Shape.SQUARE, *levels, length_s / 3.0)
        for mode in Mode:
            drive = _drive(configuration, first)
            _operate(drive, mode, wave, length_s)
            _record(folder, f"{kind}-{mode}", configuration, path, drive)


def replay_all(folder: Path) -> bool:
    """Replay every session; return whether all were bit-equal."""
    sessions = sorted(path.parent for path in folder.glob("*/*/session.json"))
    return len(sessions) == len(KINDS) * len(Mode) and not any(
        replay(str(session)) for session in sessions
    )


def _drive(configuration: Configuration, first: float) -> RecordedDrive:
    noise = NoiseParameters(sigma=NOISE * first)
    world = World(load_of(configuration), noise=noise)
    world.settle(world.boost_voltage_for(first))
    return RecordedDrive(configuration, world)


def _operate(drive: RecordedDrive, mode: Mode, wave: Waveform, length_s: float) -> None:
    """Enable a drive, and have it follow set-points or voltages for so long."""
    drive.tick()
    drive.carry_out(Enable())
    drive.carry_out(SetSetpoint(wave.low))
    while drive.machine.state is not State.RUNNING:
        drive.tick()
    drive.carry_out(SetMode(mode))
    drive.carry_out(SetVoltage(290.0) if mode is Mode.MANUAL else SetWaveform(wave))
    while drive.time_s < length_s and drive.machine.state is State.RUNNING:
        drive.tick()


def _record(
    folder: Path, name: str, configuration: Configuration, path: Path, drive: RecordedDrive
) -> None:
    text = path.read_text(encoding="utf-8")
    load = configuration.load
    info = msgspec.structs.replace(
        INFO,
        drive=name,
        ticks_per_period=configuration.ticks_per_period,
        latency_ticks=load.latency_ticks,
    )
    directory = create_session(folder / name, info, text)
    record_messages(directory, Header(info, text), make_batch(drive.reports, drive.slow, last=True))


def main() -> int:
    """Record or replay."""
    verb, folder, *share = sys.argv[1:]
    sys.stdout.write(f"{build_name()}\n")
    if verb == "record":
        record_all(Path(folder), float(share[0]))
        return 0
    return 0 if replay_all(Path(folder)) else 1


if __name__ == "__main__":
    raise SystemExit(main())
