"""`adaptdrive-sim reproduce` as a process: its files, what it prints, and its errors."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from adaptdrive.errors import RefusedError
from adaptdrive_sim.experiments.case import Disturbance, disturbance_of
from adaptdrive_sim.parameters import ParameterError

Finished = subprocess.CompletedProcess[str]


def reproduce(*options: str | Path) -> Finished:
    command = [sys.executable, "-m", "adaptdrive_sim", "reproduce", *map(str, options)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


@pytest.fixture(scope="module")
def twice(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Finished]:
    folder = tmp_path_factory.mktemp("reproduce")
    first, second = folder / "first", folder / "deep" / "second"
    done = reproduce("motor", "--output", first, "--seed", "3", "--spikes", "0.02,0.1")
    reproduce("motor", "--output", second, "--seed", "3", "--spikes", "0.02,0.1")
    return first, second, done


def summary(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    return found


@pytest.mark.slow
def test_it_says_what_became_of_every_claim_and_shows_no_progress_in_a_pipe(
    twice: tuple[Path, Path, Finished],
) -> None:
    _, _, done = twice
    assert done.returncode == 0
    assert done.stderr == ""
    title, *verdicts = done.stdout.splitlines()
    assert title.startswith("motor, paper design, seed 3")
    assert len(verdicts) == 7
    assert all(line.startswith(("holds: ", "FAILS: ")) for line in verdicts)


@pytest.mark.slow
def test_two_runs_with_one_seed_leave_the_same_bytes(twice: tuple[Path, Path, Finished]) -> None:
    first, second, _ = twice
    names = sorted(path.name for path in first.iterdir())
    assert names == [
        *("adaptive.parquet", "direct_rls.parquet", "figure.png", "fixed.parquet"),
        *("summary.json", "sweep.png"),
    ]
    for name in names:
        if name != "summary.json":
            assert (first / name).read_bytes() == (second / name).read_bytes(), name
    one, other = summary(first), summary(second)
    assert one.pop("wall_s") > 0.0
    other.pop("wall_s")
    assert one == other


@pytest.mark.slow
def test_the_summary_has_its_published_shape(twice: tuple[Path, Path, Finished]) -> None:
    found = summary(twice[0])
    assert set(found) == {"experiment", "seed", "wall_s", "controllers", "estimates", "claims"}
    assert (found["experiment"], found["seed"]) == ("motor", 3)
    assert set(found["controllers"]) == {"fixed", "adaptive", "direct_rls"}
    for controller in found["controllers"].values():
        assert [one["start_s"] for one in controller["cycles"]] == [120.0 * i for i in range(11)]
        for one in controller["cycles"]:
            assert set(one) == {"start_s", "load", "overshoot", "settling_s", "model_error_rms"}
    assert [one["load_change_s"] for one in found["estimates"]] == [600.0, 960.0]
    assert set(found["estimates"][0]) == {"load_change_s", "cycles_to_5_percent"}
    assert set(found["claims"][0]) == {"claim", "measured", "target", "met"}


@pytest.mark.slow
def test_the_recorded_runs_say_what_they_are(twice: tuple[Path, Path, Finished]) -> None:
    table = pq.read_table(twice[0] / "direct_rls.parquet")
    assert table.num_rows == 1320
    assert {"time_s", "reference", "output", "boost_reference_V", "gain", "gain_std"} <= set(
        table.column_names
    )
    assert table.schema.metadata == {
        b"experiment": b"motor",
        b"controller": b"direct_rls",
        b"design": b"paper",
        b"seed": b"3",
        b"noise": b"0.002",
        b"dropped_at_rest": b"true",
        b"spikes": b"0.02,0.1",
    }


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (("--spikes", "often"), "spikes 'often' is not RATE,SIGMA"),
        (("--noise", "-1"), "noise = -1.0 must lie in"),
        (("--seed", "-4"), "seed = -4 must lie in"),
    ],
)
def test_what_cannot_be_asked_for_is_one_clear_line(
    tmp_path: Path, options: tuple[str, ...], complaint: str
) -> None:
    done = reproduce("motor", "--output", tmp_path, *options)
    assert done.returncode == 1
    assert done.stderr.startswith(f"adaptdrive-sim: {complaint}")
    assert done.stderr.count("\n") == 1
    assert done.stdout == ""


def test_a_bath_has_no_disks_whose_speed_could_stay(tmp_path: Path) -> None:
    done = reproduce("bath", "--output", tmp_path, "--keep-speed")
    assert done.returncode == 1
    assert done.stderr == "adaptdrive-sim: --keep-speed: a bath has no disks\n"


def test_a_folder_that_cannot_be_made_is_one_clear_line(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    done = reproduce("bath", "--output", tmp_path / "file")
    assert done.returncode == 1
    assert done.stderr == f"adaptdrive-sim: {tmp_path / 'file'}: File exists\n"


def test_noise_and_spikes_are_fractions_of_the_step() -> None:
    noise = disturbance_of(0.002, "0.02,0.1").scaled(0.2)
    assert noise.sigma == pytest.approx(4e-4)
    assert noise.spike_share == 0.02
    assert noise.spike_sigma == pytest.approx(0.02)
    assert disturbance_of(0.0, "0,0") == Disturbance(0.0)


@pytest.mark.parametrize("spikes", ["", "1", "1,2,3", "a,b"])
def test_unreadable_spikes_are_refused(spikes: str) -> None:
    with pytest.raises(RefusedError, match="is not RATE,SIGMA"):
        disturbance_of(0.0, spikes)


@pytest.mark.parametrize(("noise", "spikes"), [(-0.1, "0,0"), (0.1, "1.5,0"), (0.1, "0.1,nan")])
def test_impossible_noise_is_refused(noise: float, spikes: str) -> None:
    with pytest.raises(ParameterError, match="must lie in"):
        disturbance_of(noise, spikes)
