"""The fast loop with all its watches, a plant, and a sensor that may lie; in virtual time.

`python -m tools.proof.deceived [SEEDS [SEEDS OF FAULTS]]` prints the tables of
docs/proof/reliability.md: how many of the honest courses tripped, and how soon each fault did.
"""

from __future__ import annotations

import math
import random
import statistics
import sys
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing import Pool

from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings, fast_settings, machine_limits
from adaptdrive.config.file import validate_configuration
from adaptdrive.config.root import Configuration
from adaptdrive.control.controller import Controller
from adaptdrive.control.signals import SAFE_COMMAND, Command, Decision, Snapshot
from adaptdrive.runtime.fast_loop import FastLoop
from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import Disable, Enable, Request, SetSetpoint
from adaptdrive.runtime.state_machine import Machine
from adaptdrive.safety.facts import Reading
from adaptdrive.safety.trips import Trip, TripKind
from adaptdrive.util.errors import RefusedError
from adaptdrive_sim.parameters import EXAMPLES, example_tables
from adaptdrive_sim.plants.bath import Bath, BathParameters
from adaptdrive_sim.plants.battery import Battery, BatteryParameters
from adaptdrive_sim.plants.motor import Motor, MotorParameters
from adaptdrive_sim.world import SimulatedLoad, World
from tests.loopback_port import LoopbackPort, Quiet

LOADS = ("motor", "bath", "battery")
DURATIONS_s = {"motor": 400.0, "bath": 900.0, "battery": 300.0}
WAITS_s = {"motor": 100.0, "bath": 200.0, "battery": 60.0}
TORQUE_Nm = 0.375
"""Worth 20 V of boost voltage."""

Sensor = Callable[[float, float], float]
"""What is measured at a time since the fault, of the true output."""


@dataclass
class Deceived(Quiet):
    """A drive whose output is measured by a sensor of the test."""

    configuration: Configuration
    world: World

    def __post_init__(self) -> None:
        self.now = 1000.0
        self.counter = 0
        self.sent = SAFE_COMMAND
        self.pending: tuple[Snapshot, Decision] | None = None
        self.completed = False
        self.sensor: Sensor = lambda _, output: output
        self.fault_s = math.inf
        self.machine = Machine(machine_limits(self.configuration))
        self.controller = Controller(
            controller_settings(self.configuration), build_load(self.configuration)
        )
        self.port = LoopbackPort(self._command, counter_modulus=65536)
        self.port._up, self.port._listener = True, self
        self.loop = FastLoop(
            self.port, self.controller, self.machine, fast_settings(self.configuration), self
        )
        self.world.shut()

    def run(self, seconds: float) -> bool:
        """Run for a while; False when the drive has tripped or ended."""
        end_s = self.now + seconds
        while self.now < end_s:
            self.tick()
            if self.machine.state is State.TRIPPED or self.completed:
                return False
        return True

    def tick(self) -> None:
        sample = self.world.step(self.sent.current_scale_S, self.sent.bridge)
        self.now += sample.tick_period_s
        self.counter += 1
        age_s = self.now - self.fault_s
        output = self.sensor(age_s, sample.output) if age_s >= 0.0 else sample.output
        reading = Reading(
            arrival_s=self.now,
            oldest_s=self.now,
            counter=self.counter % 65536,
            boost_voltage_V=sample.boost_voltage_V,
            line_voltage_V=sample.line_voltage_V,
            load_power_W=sample.load_power_W,
            output=output,
            fault=0,
            bridge=self.world.bridge,
        )
        self.port.deliver(reading)
        if self.pending is not None:
            snapshot, decision = self.pending
            self.pending = None
            self.loop.deliver(snapshot, decision)

    def ask(self, request: Request) -> None:
        reading = self.loop.reading
        output = reading.output if reading else math.nan
        self.machine.carry_out(request, self.loop.tick, output, self.loop.cause)

    def start(self) -> bool:
        """Enable; True when the drive runs."""
        for _ in range(3):
            self.tick()
        self.ask(Enable())
        while self.machine.state is State.STARTING:
            self.tick()
        return self.machine.state is State.RUNNING

    def _command(self, command: Command) -> None:
        self.sent = command

    def on_reading(self, reading: Reading) -> None:
        self.loop.on_reading(reading)

    def on_bus(self, up: bool, detail: str) -> None:
        """It is never lost."""

    def snapshot_taken(self, snapshot: Snapshot) -> bool:
        self.pending = snapshot, self.controller.decide(snapshot)
        return True

    def decided(self, snapshot: Snapshot, decision: Decision) -> None:
        if decision.fault:
            self.machine.latch(Trip(TripKind(decision.fault_kind), decision.fault))
        elif decision.complete:
            self.completed = True
            self.ask(Disable())


def odds(draw: random.Random, widest: float) -> float:
    """A factor between 1/widest and widest, evenly on a logarithmic scale."""
    return float(widest ** draw.uniform(-1.0, 1.0))


def configured(name: str, draw: random.Random) -> Configuration:
    """The example with a nominal model that is wrong by up to 3 in each gain and each lag."""
    tables = example_tables(f"{name}.toml")
    model = tables["load"]["model"]
    wrong = {
        "motor": ("gain", "tau_motor_s", "tau_filter_s"),
        "bath": ("resistance_K_per_W", "tau_s"),
        "battery": ("internal_Ohm", "relaxation_Ohm", "relaxation_s"),
    }
    for key in wrong[name]:
        model[key] *= odds(draw, 3.0)
    tables["interlocks"]["output_max"] *= 1.5  # noise of 5 % is above the limit of the example
    return validate_configuration(tables, EXAMPLES / f"{name}.toml")


def plant(name: str, draw: random.Random) -> SimulatedLoad:
    """A load in a state in which somebody may find it."""
    if name == "motor":
        return Motor(MotorParameters(dropped_at_rest=draw.random() < 0.5), draw.randint(1, 3))
    if name == "bath":
        bath = Bath(BathParameters())
        bath.output = draw.uniform(-2.0, 12.0)
        return bath
    return Battery(BatteryParameters(charge=draw.uniform(0.1, 0.97)))


def honest_sensor(draw: random.Random, reference_range: float) -> Sensor:
    """Noise of up to 5 % of the range, and a last digit of up to 1 %."""
    sigma = draw.choice([0.0, 0.002, 0.01, 0.05]) * reference_range
    digit = draw.choice([0.0, 0.0002, 0.002, 0.01]) * reference_range

    def measure(_: float, output: float) -> float:
        noisy = output + draw.gauss(0.0, sigma) if sigma else output
        return round(noisy / digit) * digit if digit else noisy

    return measure


def disturb(world: World, draw: random.Random) -> None:
    """What may happen to a load while it runs."""
    load = world.load
    if isinstance(load, Motor):
        if draw.random() < 0.5:
            load.torque_Nm = draw.choice([0.0, TORQUE_Nm])
        else:
            load.disks = draw.randint(1, 3)
    elif isinstance(load, Bath):
        load.resize(odds(draw, 2.5), draw.choice([0.0, 60.0, 600.0]))


def honest(job: tuple[str, int]) -> str:
    """One course with an honest sensor: why it tripped, or an empty string."""
    name, seed = job
    draw = random.Random(f"honest {name} {seed}")
    drive = begin(name, draw)
    load = drive.configuration.load
    drive.sensor = honest_sensor(draw, load.reference_max - load.reference_min)
    drive.fault_s = 0.0
    if not drive.start():
        return str(drive.machine.trip)
    end_s = drive.now + DURATIONS_s[name]
    low, high = reachable(drive)
    while drive.now < end_s:
        if low < high:
            drive.ask(SetSetpoint(draw.uniform(low, high)))
        for _ in range(2):
            if not drive.run(draw.uniform(0.02, 0.15) * DURATIONS_s[name]):
                return "" if drive.machine.trip is None else drive.machine.trip.text
            disturb(drive.world, draw)
    return ""


def reachable(drive: Deceived) -> tuple[float, float]:
    """Ends of the set-points that are accepted; a wrong model may leave none."""
    load, reach = drive.configuration.load, drive.machine.reach
    if not reach.is_known:
        return load.reference_min, load.reference_max
    return max(load.reference_min, reach.low), min(load.reference_max, reach.high)


def begin(name: str, draw: random.Random) -> Deceived:
    return Deceived(configured(name, draw), World(plant(name, draw)))


def decaying(tau_s: float) -> Sensor:
    return lambda age_s, output: output * math.exp(-age_s / tau_s)


def stuck() -> Sensor:
    held: list[float] = []

    def measure(_: float, output: float) -> float:
        if not held:
            held.append(output)
        return held[0]

    return measure


FAULTS: dict[str, Callable[[], Sensor]] = {
    "reversed from the start": lambda: lambda _, output: -output,
    "wire broken: reads 0": lambda: lambda _, _output: 0.0,
    "decays, 3 s": lambda: decaying(3.0),
    "decays, 10 s": lambda: decaying(10.0),
    "decays, 30 s": lambda: decaying(30.0),
    "stuck, then a step of the set-point": stuck,
    "scale x 0.3 from one moment on": lambda: lambda _, output: 0.3 * output,
    "scale x 0.3 from the start": lambda: lambda _, output: 0.3 * output,
}


def lied_to(job: tuple[str, str, int]) -> float:
    """Time from a fault of the sensor to the trip, infinite for none."""
    name, fault, seed = job
    draw = random.Random(f"{fault} {name} {seed}")
    drive = begin(name, draw)
    drive.sensor = FAULTS[fault]()
    if fault.endswith("from the start"):
        drive.fault_s = drive.now
    try:
        drive.start()
    except RefusedError:  # the drive is not even enabled
        return 0.0
    low, high = reachable(drive)
    if low >= high:
        return math.nan
    drive.ask(SetSetpoint(draw.uniform(0.5 * (low + high), high)))
    if drive.fault_s == math.inf:
        if not drive.run(draw.uniform(0.5, 1.0) * WAITS_s[name]):
            return math.nan
        drive.fault_s = drive.now
    began_s = drive.now
    if fault.startswith("stuck"):
        drive.run(1.0)
        drive.ask(SetSetpoint(high if drive.machine.asked.setpoint < 0.75 * high else low))
    drive.run(WAITS_s[name])
    return drive.now - began_s if drive.machine.state is State.TRIPPED else math.inf


def main() -> None:
    """Print both tables."""
    counts = [int(word) for word in sys.argv[1:]] or [20]
    with Pool(2) as pool:
        say("| load | honest courses | trips of a watch | limit cycles of the fixed controller |")
        say("|---|---|---|---|")
        for name in LOADS:
            say(
                *honest_line(name, pool.map(honest, [(name, seed) for seed in range(counts[0])], 1))
            )
        say(f"\n| fault | {' | '.join(LOADS)} |\n|---|---|---|---|")
        for fault in FAULTS:
            jobs = [[(name, fault, seed) for seed in range(counts[-1])] for name in LOADS]
            say(f"| {fault} | {' | '.join(cell(pool.map(lied_to, job, 1)) for job in jobs)} |")


def honest_line(name: str, trips: list[str]) -> tuple[str, ...]:
    """One line of the first table, with the trips that must not be.

    A wrong model can make the fixed controller drive V_c from limit to limit. No sensor is at
    fault then, and the trip is right.
    """
    cycles = [trip for trip in trips if trip.startswith("limit cycle")]
    false = [trip for trip in trips if trip and trip not in cycles]
    words = "; ".join([str(len(false)), *sorted(set(false))])
    return (f"| {name} | {len(trips)} | {words} | {len(cycles)} |",)


def cell(found: list[float]) -> str:
    """Median and worst time to the trip, and the courses without one."""
    times = [time_s for time_s in found if not math.isnan(time_s)]
    tripped = [time_s for time_s in times if math.isfinite(time_s)]
    if not tripped:
        return f"{len(tripped)} of {len(times)} tripped"
    shown = f"{statistics.median(tripped):.3g} s ({max(tripped):.3g})"
    return f"{shown}, {len(tripped)} of {len(times)}"


def say(*words: str) -> None:
    """Print a line at once."""
    sys.stdout.write(" ".join(words) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
