"""Campaigns from end to end, small ones."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from adaptdrive.control.signals import Mode
from adaptdrive_sim.campaign import repeat_run, run_campaign, run_seed, workers
from adaptdrive_sim.campaign.report import claims, failures, judge, reason_of, shared_failures
from adaptdrive_sim.campaign.settings import FOLDER, read_campaign
from adaptdrive_sim.campaign.stands import Stand, deployed, draw

STANDARD = Path("standard.toml")


@pytest.mark.proof
def test_a_campaign_leaves_a_row_for_each_seed_that_is_the_same_in_any_process_and_pictures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = run_campaign(STANDARD, tmp_path, scheduler=None, processes=2, runs=12)
    assert [row["seed"] for row in rows] == list(range(1, 13))
    assert rows[2] == run_seed(read_campaign(STANDARD), 3)
    table = pq.read_table(tmp_path / "results.parquet").to_pylist()
    assert [row["ratio"] for row in table] == [row["ratio"] for row in rows]
    assert (tmp_path / "costs.png").stat().st_size > 10_000
    assert (tmp_path / "influences.png").stat().st_size > 10_000
    told = capsys.readouterr().out
    assert "12 runs, each fixed and adaptive" in told
    assert "\x1b" not in told


def test_a_run_is_repeated_with_the_same_result(tmp_path: Path) -> None:
    path = tmp_path / "short.toml"
    text = (FOLDER / STANDARD).read_text(encoding="utf-8")
    path.write_text(text.replace("duration_s = 1320.0", "duration_s = 180.0"), encoding="utf-8")
    repeat_run(path, 5, tmp_path)
    filters = [("mode", "=", "adaptive")]
    recorded = pq.read_table(tmp_path / "run-5.parquet", filters=filters)
    stand = Stand(draw(read_campaign(path), 5))
    assert recorded["output"].to_pylist() == stand.run(Mode.ADAPTIVE)["output"].tolist()
    assert (tmp_path / "run-5.png").exists()


def test_the_ideal_loop_reaches_every_set_point_with_the_designed_poles() -> None:
    stand = Stand(draw(read_campaign(STANDARD), 12))
    references = np.concatenate([np.full(5, 3.0), np.full(75, 3.2)])
    stand.plan = replace(stand.plan, references=references)
    stand.sizes = np.full(80, stand.scenario.inertias[0])
    ideal = stand.ideal
    assert ideal[:6] == pytest.approx(3.0)
    assert ideal[-1] == pytest.approx(3.2, abs=1e-6)
    late = (3.2 - ideal)[50:]
    assert late[1:] / late[:-1] == pytest.approx(deployed().pole, abs=0.08)


@pytest.mark.proof
def test_a_run_that_fixed_control_does_not_hold_either_is_listed_apart_with_its_reason() -> None:
    stand = Stand(draw(read_campaign(STANDARD), 2))
    fixed, adaptive = stand.run(Mode.FIXED), stand.run(Mode.ADAPTIVE)
    for outcome in (fixed, adaptive):
        outcome["output"][100:] += 10.0 * stand.step
    adaptive["boost_reference_V"][: stand.times_s.size // 2] = 400.0
    row = judge(stand, fixed, adaptive)
    assert row["unstable_fixed"]
    assert row["unstable_adaptive"]
    assert failures([row]) == []
    assert shared_failures([row]) == [("unstable, fixed too", row)]
    assert reason_of(row) == "V_c at a limit for 50% of the time"
    claim = claims([row])[0]
    assert claim.met
    assert claim.measured == "0 of 1; 1 with fixed control too"
    alone = row | {"unstable_fixed": False}
    assert shared_failures([alone]) == []
    assert {cause for cause, _ in failures([alone])} == {"unstable"}


def test_without_a_scheduler_there_the_address_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(address: str, **_: object) -> None:
        raise OSError(f"no answer from {address}")

    monkeypatch.setattr("distributed.Client", absent)
    with pytest.raises(match=r"127\.0\.0\.1:1"), workers(None, "127.0.0.1:1"):
        pass


@pytest.mark.proof
@pytest.mark.parametrize("seed", [8007207, 8003293, 8008924])
def test_a_lighter_load_is_found_before_the_gains_of_the_heavy_one_have_swung_it(seed: int) -> None:
    """Inertia of 2.3 to 2.9 disks falls to 0.3 to 0.5 with a slow sine, a square and a triangle."""
    assert run_seed(read_campaign(Path("wide.toml")), seed)["ratio"] < 1.05
