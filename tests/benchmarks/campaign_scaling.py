"""Measure how campaigns scale, and draw docs/images/campaign-scaling.png.

One and two processes take turns on the same seeds; each dot is a round. Run it on a machine that
does nothing else, with `python -m tests.benchmarks.campaign_scaling`: it takes about a minute, and
another one where the experiments have to be compiled first.
"""

from __future__ import annotations

from pathlib import Path
from statistics import median

from matplotlib.figure import Figure

from adaptdrive.analysis import style
from adaptdrive_sim.campaign.settings import read_campaign
from adaptdrive_sim.experiments.figure import save
from tests.benchmarks.campaign_speed import Round, measure

COUNTS = (1, 2)
IMAGE = Path(__file__).parents[2] / "docs" / "images" / "campaign-scaling.png"
RUNS, ROUNDS = 80, 9


def draw(found: dict[int, list[Round]], path: Path) -> None:
    """Experiments per second over the number of processes."""
    speeds = {count: median(one.experiments_per_s for one in found[count]) for count in found}
    cpu_ms = median(one.cpu_ms for rounds in found.values() for one in rounds)
    with style.journal():
        figure = Figure(figsize=(style.WIDTH_in / 2.0, 2.6), layout="constrained")
        axes = figure.subplots()
        ideal = [speeds[COUNTS[0]] * count for count in COUNTS]
        axes.plot(COUNTS, ideal, ":", color="0.4", label="in proportion")
        axes.plot(COUNTS, [speeds[count] for count in COUNTS], "-o", label="median")
        for count, rounds in found.items():
            axes.plot([count] * len(rounds), [one.experiments_per_s for one in rounds], "k.", ms=2)
        for count, speed in speeds.items():
            axes.annotate(f"{speed:.0f}", (count, speed), (6.0, -10.0), textcoords="offset points")
        axes.set(xlabel="processes", ylabel="experiments per second", xticks=COUNTS)
        axes.set_xlim(COUNTS[0] - 0.3, COUNTS[-1] + 0.4)
        axes.set_ylim(0.0)
        axes.set_title(f"{cpu_ms:.1f} ms of a processor for each experiment")
        axes.legend(loc="upper left")
        save(figure, path)


def main() -> None:
    """Measure, print and draw."""
    found = measure(read_campaign(Path("standard.toml")), COUNTS, runs=RUNS, rounds=ROUNDS)
    for count, rounds in found.items():
        speeds = sorted(one.experiments_per_s for one in rounds)
        cpu_ms = median(one.cpu_ms for one in rounds)
        told = f"{median(speeds):.1f} experiments/s ({speeds[0]:.1f} to {speeds[-1]:.1f})"
        print(f"{count} processes: {told}, {cpu_ms:.2f} ms CPU each")  # noqa: T201
    draw(found, IMAGE)


if __name__ == "__main__":
    main()
