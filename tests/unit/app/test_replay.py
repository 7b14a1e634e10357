"""A session that started from a checkpoint replays from it, bit for bit."""

import dataclasses
import json
from pathlib import Path

import msgspec
import pytest

from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings
from adaptdrive.cli.sessions import controller_at_start, replay
from adaptdrive.config import load_configuration
from adaptdrive.control.controller import Controller
from adaptdrive.control.signals import Mode, Stage
from adaptdrive.recording.records import Header
from adaptdrive.recording.session import create_session, read_info, write_info
from adaptdrive.runtime.reports import LoadReport, TickReport
from adaptdrive_sim.world import NoiseParameters
from tests.integration.closed_loop.bench import STEP, Bench, order, square_wave
from tests.unit.recording.material import INFO, make_batch, record_messages

EXAMPLE = Path(__file__).parents[3] / "deploy" / "examples" / "motor.toml"
PRIOR = (0.0113, 40.0 + 1.0 / 3.0, 300.7)
SECONDS = 50


def lived(
    prior: tuple[float, ...] | None, seconds: int = SECONDS, resolution: float = 0.0
) -> tuple[list[TickReport], list[LoadReport]]:
    """Ticks and slow periods of a run that ends under adaptive control.

    With a resolution, which an earlier run has found, the tachometer is rounded to it.
    """
    configuration = load_configuration(EXAMPLE)
    bench = Bench(noise=NoiseParameters(sigma=0.002 * STEP), seed=3)
    bench.motor.disks = 3
    settings = controller_settings(configuration)
    controller = Controller(settings, build_load(configuration), prior, resolution)
    ticks: list[TickReport] = []
    slow: list[LoadReport] = []
    due = -1
    for n in range(seconds * 120):
        wanted = order(square_wave(n / 120), Mode.ADAPTIVE, Stage.RUN)
        applied = slow[-1].decision.k if n == due else -1
        if applied >= 0:
            controller.apply(slow[-1].decision)
        bench.n = n
        sample = bench.measurement()
        if resolution:
            output = round(sample.output / resolution) * resolution
            sample = dataclasses.replace(sample, output=output)
        command = controller.tick(sample, wanted)
        ticks.append(TickReport(n, sample, wanted, applied, command, 0.0, 0.0))
        if (snapshot := controller.take_snapshot()) is not None:
            slow.append(LoadReport(snapshot, controller.decide(snapshot)))
            due = n + settings.rates.latency_ticks
        bench._sample = bench.world.step(command.current_scale_S, command.bridge)
    return ticks, slow


def test_the_prior_is_part_of_the_record(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    info = msgspec.structs.replace(INFO, prior=PRIOR)
    text = EXAMPLE.read_text(encoding="utf-8")
    directory = create_session(tmp_path, info, text)
    ticks, slow = lived(PRIOR)
    assert slow[-1].decision.controller is Mode.ADAPTIVE
    header = Header(info, text)
    record_messages(directory, header, make_batch(ticks, slow, last=True))
    recorded = read_info(directory)
    assert recorded.prior == PRIOR
    assert replay(str(directory)) == 0, capsys.readouterr().out
    write_info(directory, INFO)
    assert replay(str(directory)) == 1
    capsys.readouterr()
    assert replay(str(directory), as_json=True) == 1
    report = json.loads(capsys.readouterr().out)
    assert not report["bit_equal"]
    assert report["ticks"] == len(ticks)
    assert report["first_command"]["tick"] >= 0


def test_so_is_the_resolution_that_an_earlier_run_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    step = 0.01
    text = EXAMPLE.read_text(encoding="utf-8")
    info = msgspec.structs.replace(INFO, prior=PRIOR, resolution=step)
    directory = create_session(tmp_path, info, text)
    ticks, slow = lived(PRIOR, 10, step)
    assert all(one.snapshot.resolution == step for one in slow)
    record_messages(directory, Header(info, text), make_batch(ticks, slow, last=True))
    assert read_info(directory).resolution == step
    assert replay(str(directory)) == 0, capsys.readouterr().out
    assert controller_at_start(read_info(directory), load_configuration(EXAMPLE)).resolution == step
    older = msgspec.structs.replace(info, resolution=0.0)
    assert controller_at_start(older, load_configuration(EXAMPLE)).resolution == 0.0


@pytest.mark.parametrize(
    ("setting", "warned"),
    [
        ("load.pole=0.8", True),
        ("mqtt.port=1884", True),
        ("estimator.forgetting=0.95", False),
        ("load.samples=30", False),
    ],
)
def test_a_setting_without_effect_on_a_replay_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], setting: str, warned: bool
) -> None:
    text = EXAMPLE.read_text(encoding="utf-8")
    directory = create_session(tmp_path, INFO, text)
    ticks, slow = lived(None, seconds=3)
    record_messages(directory, Header(INFO, text), make_batch(ticks, slow, last=True))
    replay(str(directory), settings=(setting,))
    said = capsys.readouterr().err
    assert (setting in said) is warned
    assert ("has no effect on a replay" in said) is warned
