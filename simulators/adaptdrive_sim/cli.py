"""The command `adaptdrive-sim`."""

import sys
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import App, Parameter

import adaptdrive
from adaptdrive.cli import FAILED, carry_out, options, print_error
from adaptdrive_sim.device import DeviceSettings, parse_address

app = App(
    name="adaptdrive-sim",
    help="Simulated drives, loads and buses for adaptdrive.",
    version=adaptdrive.__version__,
    print_error=False,
    exit_on_error=False,
    suppress_keyboard_interrupt=False,
    result_action="return_value",
)

NO_ANSWER = 3
ANSWER_s = 5.0


def main() -> None:
    """Run the command line; an error is one clear line and a non-zero status."""
    try:
        sys.exit(carry_out(app.name[0], options.parsed_command(app), sys.argv[1:], unusable=FAILED))
    except ModuleNotFoundError as problem:
        if (problem.name or "").split(".")[0] in {"adaptdrive", "adaptdrive_sim"}:
            raise
        sys.exit(f"adaptdrive-sim: {problem.name} is missing: pip install 'adaptdrive[sim]'")


@app.command
def device(config: Path, *, settings: DeviceSettings | None = None) -> None:
    """Run the simulated drive as a node on the bus that a configuration names.

    Args:
        config: The drive's configuration, the same file that the daemon reads.
        settings: What is added to it.
    """
    from adaptdrive_sim.device import run_device  # noqa: PLC0415  # keeps --help fast

    run_device(config, settings or DeviceSettings())


@app.command(usage="Usage: adaptdrive-sim disturb [OPTIONS] DRIVE ACTION [VALUES]")
def disturb(
    drive: options.DriveName,
    action: str,
    values: Annotated[tuple[float, ...], Parameter(allow_leading_hyphen=True)] = (),
    /,
    *,
    broker: Annotated[str, Parameter(env_var="ADAPTDRIVE_BROKER")] = "127.0.0.1:1883",
) -> int:
    """Disturb a running simulated drive.

    The status is 0 when it was done, 1 when it was refused and 3 without an answer.

    Args:
        drive: Name of the drive.
        action: Of a motor add-disk, remove-disk or torque N_m; of a bath volume US_GALLONS SECONDS
            or inflow L_PER_MIN; of a battery series-resistance OHM or charge SHARE; of any load
            sag FRACTION SECONDS, noise SIGMA, fault WORD, or sensor-fault KIND (1 broken wire,
            2 frozen, 3 unplugged, 0 none).
        values: What the action needs.
        broker: HOST:PORT of the MQTT broker.
    """
    import asyncio  # noqa: PLC0415  # keeps --help fast

    from adaptdrive.mqtt.client import NoAnswerError  # noqa: PLC0415
    from adaptdrive.mqtt.client import disturb as ask  # noqa: PLC0415
    from adaptdrive_sim.devices.disturbances import from_words  # noqa: PLC0415

    request = from_words(action, values)
    try:
        reply = asyncio.run(ask(parse_address(broker), drive, request, ANSWER_s))
    except NoAnswerError as silence:
        late = isinstance(silence.__cause__, TimeoutError)
        text = f"no answer from {drive} at {broker}" if late else silence.problem
        return print_error(app.name[0], text, NO_ANSWER)
    if not reply.accepted:
        return print_error(app.name[0], f"refused: {reply.reason}", FAILED)
    print(f"{drive}: {' '.join([action, *(f'{value:g}' for value in values)])}: done")
    return 0


@app.command
def reproduce(  # noqa: PLR0913 - one parameter for each option
    experiment: Literal["bath", "motor"],
    /,
    *,
    output: Path,
    seed: options.Integer = 0,
    noise: float | None = None,
    spikes: str = "0,0",
    design: Literal["paper", "exact"] = "paper",
    keep_speed: bool = False,
) -> None:
    """Reproduce an experiment of the paper, faster than real time.

    Writes figure.png (laid out like the paper's), sweep.png (other settings of the estimator),
    summary.json and one Parquet file for each run, and prints whether the paper's claims hold.
    The status is 0 when it ran, whatever the verdict.

    Args:
        experiment: bath (three hours, Fig. 4) or motor (22 minutes, Fig. 9).
        output: Folder for the results; made when it is not there.
        seed: Seed of the noise: the same seed gives the same data.
        noise: Standard deviation of each fast sample, as a fraction of the reference step; that
            of the published experiment when left out.
        spikes: RATE,SIGMA: share of samples that carry a spike, and its deviation, as above.
        design: paper is the controller as printed and corrected; exact is the daemon's default.
        keep_speed: The motor's disks turn with the shaft when they are added, so that its speed
            stays. Without it they land at rest and share its momentum, as in the paper.
    """
    from adaptdrive_sim.experiments import reproduce as run  # noqa: PLC0415  # keeps --help fast
    from adaptdrive_sim.experiments.case import Case, disturbance_of  # noqa: PLC0415

    chosen = run.find_experiment(experiment, keep_speed=keep_speed)
    disturbance = disturbance_of(chosen.noise if noise is None else noise, spikes)
    claims = run.run_experiment(Case(chosen, design, disturbance, seed), output)
    run.print_claims(f"{experiment}, {design} design, seed {seed}: {output}", claims)


@app.command
def campaign(  # noqa: PLR0913 - one parameter for each option
    file: Path,
    /,
    *,
    output: Path,
    scheduler: str | None = None,
    processes: options.Integer | None = None,
    runs: options.Integer | None = None,
    only: options.Integer | None = None,
) -> None:
    """Run thousands of randomised motors, baths or batteries, each with fixed and adaptive control.

    Writes results.parquet (one row for each run) and plots, and prints what fraction was worse
    than fixed, what broke, and how to repeat it. The status is 0 when it ran, whatever was found.

    Args:
        file: What to draw from; standard.toml, wide.toml, life.toml, bath.toml and
            battery.toml come along.
        output: Folder for the results; made when it is not there.
        scheduler: Address of a Dask scheduler, HOST:PORT; this machine when left out.
        processes: Processes on this machine; one for each processor when left out.
        runs: Number of runs instead of the file's.
        only: Seed of one run to repeat, recorded and drawn.
    """
    from adaptdrive_sim.campaign import repeat_run, run_campaign  # noqa: PLC0415

    if only is not None:
        repeat_run(file, only, output)
    else:
        run_campaign(file, output, scheduler=scheduler, processes=processes, runs=runs)


@app.command(usage="Usage: adaptdrive-sim demo [OPTIONS] [STORY]")
def demo(
    story: str = "motor",
    /,
    *,
    duration: float | None = None,
    headless: Annotated[bool, Parameter(negative=())] = False,
    speed: float | None = None,
) -> int:
    """Watch a simulated drive being controlled while things happen to its load.

    The daemon's controller and a simulated load are one process, in which time passes as fast as
    is asked for. The status is 0 when control worked and 1 when it failed.

    Args:
        story: Name of the story, such as motor, bath or battery; an unknown one lists them all.
        duration: Seconds of the story; the whole story when left out. The last scene of a story
            lasts until then.
        headless: Show nothing; print one line of JSON at the end.
        speed: Times real time; the story's own when left out.
    """
    from adaptdrive_sim.demo.main import run_demo  # noqa: PLC0415  # keeps --help fast

    return run_demo(story, duration, headless=headless, speed=speed)
