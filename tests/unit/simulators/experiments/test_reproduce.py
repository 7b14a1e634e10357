"""`adaptdrive-sim reproduce` as a process: its files and what it prints."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from adaptdrive.util.errors import RefusedError
from adaptdrive_sim.experiments.case import disturbance_of
from adaptdrive_sim.parameters import ParameterError
from adaptdrive_sim.world import NoiseParameters

NAMES = ("direct_rls.parquet", "figure.png", "fixed.parquet", "sweep.png", "adaptive.parquet")


def reproduced(folder: Path) -> tuple[list[str], dict[str, Any]]:
    """What it prints, and its summary."""
    command = [sys.executable, "-m", "adaptdrive_sim", "reproduce", "motor"]
    options = ["--output", str(folder), "--seed", "3", "--spikes", "0.02,0.1"]
    done = subprocess.run([*command, *options], capture_output=True, text=True, check=True)
    assert done.stderr == ""
    summary: dict[str, Any] = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert summary.pop("wall_s") > 0.0
    return done.stdout.splitlines(), summary


@pytest.mark.proof
@pytest.mark.usefixtures("outside")
def test_two_runs_with_one_seed_leave_the_same_bytes(tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "deep" / "second"
    (title, *verdicts), summary = reproduced(first)
    assert title.startswith("motor, paper design, seed 3")
    assert len(verdicts) == 7
    assert all(line.startswith(("holds: ", "FAILS: ")) for line in verdicts)
    assert reproduced(second)[1] == summary
    assert {path.name for path in first.iterdir()} == {"summary.json", *NAMES}
    for name in NAMES:
        assert (first / name).read_bytes() == (second / name).read_bytes(), name
    assert set(summary) == {"experiment", "seed", "controllers", "estimates", "claims"}
    assert [one["load_change_s"] for one in summary["estimates"]] == [600.0, 960.0]
    assert set(summary["claims"][0]) == {"claim", "measured", "target", "met"}
    table = pq.read_table(first / "direct_rls.parquet")
    assert table.num_rows == 1320
    assert {"time_s", "output", "boost_reference_V", "gain", "gain_std"} <= set(table.column_names)
    assert table.schema.metadata[b"controller"] == b"direct_rls"
    assert table.schema.metadata[b"spikes"] == b"0.02,0.1"


def test_noise_and_spikes_are_fractions_of_the_step() -> None:
    noise = disturbance_of(0.002, "0.02,0.1").scaled(0.2)
    assert noise.sigma == pytest.approx(4e-4)
    assert noise.spike_share == 0.02
    assert noise.spike_sigma == pytest.approx(0.02)
    assert disturbance_of(0.0, "0,0") == NoiseParameters(0.0)


@pytest.mark.parametrize("spikes", ["", "1", "1,2,3", "a,b"])
def test_unreadable_spikes_are_refused(spikes: str) -> None:
    with pytest.raises(RefusedError, match="is not RATE,SIGMA"):
        disturbance_of(0.0, spikes)


@pytest.mark.parametrize(("noise", "spikes"), [(-0.1, "0,0"), (0.1, "1.5,0"), (0.1, "0.1,nan")])
def test_impossible_noise_is_refused(noise: float, spikes: str) -> None:
    with pytest.raises(ParameterError, match="must lie in"):
        disturbance_of(noise, spikes)
