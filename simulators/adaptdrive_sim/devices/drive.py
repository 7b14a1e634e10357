"""Behaviour of the simulated drive that does not depend on its bus, in half cycles of real time.

Once per half cycle it steps the plant under the last valid command and measures. It protects
itself and does not trust its host:

* 100 ms (or longer, as configured) after the last valid command it shuts down: k = 0, bridge
  off, no load current. The next valid command ends that. A missing command is no fault.
* Above its highest boost voltage it stops drawing line current and reports over-voltage; the bridge
  stays as it is, since the load discharges the capacitor sooner than a resistor does, down to the
  highest V_c, while the bridge is off. The fault stays until the voltage is low enough again and
  a command with the bridge off has been received.
* Where its boost stage needs the bridge's enable bit, it draws line current only with that bit on.
* While the line is below half of its nominal voltage it reports the line as lost.
* A fault that is injected shuts the drive down until it is cleared.
"""

import asyncio
import time
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from adaptdrive.control import fast
from adaptdrive.util.clock import TickTimer
from adaptdrive.util.quantity import MEASURED
from adaptdrive_sim.parameters import check_range
from adaptdrive_sim.plants.boost import HeldOutput, Sample
from adaptdrive_sim.world import World

# The voltage loop inside a drive that holds its own boost voltage.

SCALE_MAX_S = 0.15
LOWEST_LINE_V = 1.0


class VoltageHolder:
    """Makes v_bst follow V_c by the line current, half cycle by half cycle."""

    def __init__(self, capacitance_F: float, *, bidirectional: bool) -> None:
        self._capacitance_F = capacitance_F
        self._lowest_S = -SCALE_MAX_S if bidirectional else 0.0
        self._sum: float | None = None

    def scale_S(self, reference_V: float, sample: Sample) -> float:
        """The line-current scale k for the coming half cycle; 0 while no voltage is asked for."""
        if reference_V <= 0.0:
            self._sum = None
            return 0.0
        voltage_V = sample.boost_voltage_V
        if self._sum is None:
            self._sum = fast.initial_sum(voltage_V)
        load_W, line_V = sample.load_power_W, max(sample.line_voltage_V, LOWEST_LINE_V)
        duration_s, capacitance_F = sample.tick_period_s, self._capacitance_F
        wanted_S = fast.current_scale(
            self._sum, voltage_V, load_W, line_V, duration_s, capacitance_F
        )
        scale_S = min(max(wanted_S, self._lowest_S), SCALE_MAX_S)
        limit = (wanted_S > scale_S) - (wanted_S < scale_S)
        self._sum = fast.advance_sum(self._sum, reference_V, voltage_V, limit)
        return scale_S


# Behaviour of the simulated drive that does not depend on its bus.

COMMAND_TIMEOUT_s = 0.100
LINE_LOST_SHARE = 0.5
FAULT_MAX = 0x7F

_OVERVOLTAGE, _LINE_LOST = 4, 8
"""Fault bits that the drive raises by itself."""

QUANTITIES = (*MEASURED, "counter", "fault", "bridge")
"""What a drive may send, by the names of the configuration."""

Report = Callable[..., Any]


class Frame(NamedTuple):
    """Status of the drive after one half cycle."""

    sample: Sample
    fault: int
    bridge: bool

    def quantities(self) -> dict[str, float]:
        """Return `QUANTITIES`, and the load current."""
        sample = self.sample
        measured = {name: getattr(sample, name) for name in MEASURED}
        words = {"counter": sample.tick, "fault": self.fault, "bridge": self.bridge}
        return measured | words | {"load_current_A": sample.load_current_A}


class SimulatedDrive:
    """The drive's own logic around the simulated plant.

    Attributes:
        world: The plant.
        fault: Fault word of the last half cycle.
        frame: What was measured in the last half cycle, None before the first.
        has_sensors: Sensor modules on separate buses measure too.
        report: Takes events, as an event's name and its data as keywords.
    """

    def __init__(  # noqa: PLR0913 - what makes one drive another
        self,
        world: World,
        report: Report,
        holder: VoltageHolder | HeldOutput | None = None,
        timeout_s: float = COMMAND_TIMEOUT_s,
        *,
        boost_needs_bridge: bool = False,
        trip_V: float = 450.0,
        over_V: float = 430.0,
        normal_V: float = 400.0,
    ) -> None:
        """Start a drive that has had no command yet, and so is in its safe state.

        Args:
            world: The plant.
            report: Takes events.
            holder: The voltage loop of a drive that holds its own boost voltage.
            timeout_s: Age of the last valid command at which the drive shuts down.
            boost_needs_bridge: Whether the boost stage works only while the bridge is on.
            trip_V: Boost voltage above which the drive draws no line current.
            over_V: Below it the fault can end.
            normal_V: Down to it the capacitor is discharged while the bridge is off.
        """
        self._holder = holder
        self._timeout_s = timeout_s
        self._boost_needs_bridge = boost_needs_bridge
        self._trip_V, self._over_V, self._normal_V = trip_V, over_V, normal_V
        self._reference_V = 0.0
        self.world = world
        self.fault = 0
        self.frame: Frame | None = None
        self.has_sensors = False
        self.report = report
        self._scale_S = 0.0
        self._bridge = False
        self._commanded_s: float | None = None
        self._overvoltage = False
        self._injected = 0
        world.shut()

    @property
    def holds_voltage(self) -> bool:
        """True if the drive takes V_c instead of a line-current scale."""
        return self._holder is not None

    def command(self, value: float, bridge: bool, now_s: float) -> None:
        """Take one valid command.

        Args:
            value: V_c of a drive that holds its own boost voltage, 0 for no line current; of
                another one the line-current scale k.
            bridge: Whether the bridge may feed the load.
            now_s: Monotonic time of its arrival.
        """
        if self.holds_voltage:
            self._reference_V = value
        else:
            self._scale_S = value
        if self._commanded_s is None:
            self.report("commanded", current_scale_S=self._scale_S, bridge=bridge)
        self._commanded_s = now_s
        self._bridge = bridge
        if not bridge and self.world.boost.voltage_V < self._over_V:
            self._overvoltage = False

    def inject(self, fault: int) -> None:
        """Make the drive faulty, or clear what was injected with 0.

        Raises:
            ParameterError: The word has bits that the drive does not have.
        """
        check_range("fault", fault, 0, FAULT_MAX, "")
        self._injected = fault
        self.report("fault injected" if fault else "fault cleared", fault=fault)

    def tick(self, now_s: float) -> Frame:
        """Run the half cycle that has just elapsed.

        Args:
            now_s: Monotonic time.
        """
        self._watch_command(now_s)
        self._watch_voltage()
        if self._injected:
            self.world.shut()
        bridge = self._bridge and not self._injected
        boosts = bridge or not (self._boost_needs_bridge or self._injected)
        scale_S = self._scale_S if boosts and not self._overvoltage else 0.0
        if not self.world.bridge:
            self.world.boost.discharge(self._normal_V, self.world.line.half_cycle_s)
        sample = self.world.step(scale_S, bridge)
        self.fault = self._word(sample.line_voltage_V)
        if self._holder is not None:
            self._scale_S = self._holder.scale_S(self._reference_V if boosts else 0.0, sample)
        self.frame = Frame(sample, self.fault, self.world.bridge)
        return self.frame

    def _watch_command(self, now_s: float) -> None:
        """Shut down when the last valid command is too old."""
        age_s = 0.0 if self._commanded_s is None else now_s - self._commanded_s
        if age_s >= self._timeout_s:
            self.shut_down("command timeout", age_s)

    def shut_down(self, reason: str, age_s: float = 0.0) -> None:
        """Enter the safe state by itself; the next valid command ends that.

        Args:
            reason: Why, for the log.
            age_s: How long it took to notice.
        """
        if self._commanded_s is None:
            return
        self._commanded_s, self._bridge = None, False
        self._scale_S = self._reference_V = 0.0
        self.world.shut()
        self.report(
            "safe",
            reason=reason,
            after_ms=round(1e3 * age_s, 1),
            current_scale_S=self.world.current_scale_S,
            bridge=self.world.bridge,
            load_current_A=self.world.load_current_A,
        )

    def _watch_voltage(self) -> None:
        """Stop drawing line current when the capacitor's voltage is too high."""
        voltage_V = self.world.boost.voltage_V
        if not self._overvoltage and voltage_V > self._trip_V:
            self._overvoltage = True
            self.report("over-voltage", boost_voltage_V=round(voltage_V, 1))
        if self._overvoltage:
            self.world.current_scale_S = 0.0

    def _word(self, line_V: float) -> int:
        word = self._injected
        if self._overvoltage:
            word |= _OVERVOLTAGE
        if line_V < LINE_LOST_SHARE * self.world.line.parameters.voltage_V:
            word |= _LINE_LOST
        return word


# A drive on a bus: half cycles in real time, on an absolute grid that follows the line.

STALL_s = 1.0
"""A process that slept longer than this (a suspended machine) starts a new grid."""


class DriveNode:
    """One simulated drive on one bus.

    Attributes:
        counts: Frames or requests answered, commands obeyed and refused, by name.
    """

    def __init__(self, drive: SimulatedDrive) -> None:
        self.counts: Counter[str] = Counter()
        self._drive = drive
        self._report = drive.report
        self._clock = time.monotonic

    async def run(self, opened: Callable[[str], None]) -> None:
        """Open the bus, pass its description to `opened`, and serve it until cancelled.

        Raises:
            BusError: The bus cannot be opened.
        """
        raise NotImplementedError

    def _obey(self, values: Mapping[str, float]) -> None:
        """Obey a command, by the names of the configuration; what is not among them is 0."""
        self.counts["obeyed"] += 1
        name = "boost_reference_V" if self._drive.holds_voltage else "current_scale_S"
        bridge = bool(values.get("bridge", 0.0))
        self._drive.command(values.get(name, 0.0), bridge, self._clock())

    def _refuse(self, reason: str) -> None:
        """Count a refusal, and report the first of its kind: a flood must not fill the log."""
        self.counts[reason] += 1
        if self.counts[reason] == 1:
            self._report("command refused", reason=reason)

    async def _run_half_cycles(self, deliver: Callable[[Frame], None]) -> None:
        """Run one half cycle after the other, and deliver the last frame of those that passed."""
        expired = asyncio.Event()
        deadline_s = self._clock() + self._drive.world.line.half_cycle_s
        timer = TickTimer(asyncio.get_running_loop(), lambda _: expired.set())
        try:
            while True:
                timer.arm(deadline_s)
                await expired.wait()
                expired.clear()
                now_s = self._clock()
                if now_s - deadline_s > STALL_s:
                    self._report("stalled", seconds=round(now_s - deadline_s, 3))
                    deadline_s = now_s
                deadline_s = self._catch_up(now_s, deadline_s, deliver)
        finally:
            timer.close()

    def _catch_up(self, now_s: float, deadline_s: float, deliver: Callable[[Frame], None]) -> float:
        """Run every half cycle that has passed and deliver the last one; the next deadline."""
        frame: Frame | None = None
        while deadline_s <= now_s:
            frame = self._drive.tick(now_s)
            deadline_s += frame.sample.tick_period_s
        if frame is not None:
            deliver(frame)
        return deadline_s
