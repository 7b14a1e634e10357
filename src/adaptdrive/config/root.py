"""The whole configuration, the drive and its sensors."""

from collections.abc import Iterable, Iterator, Mapping
from graphlib import TopologicalSorter
from itertools import chain
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from adaptdrive.config import polled, references, section, services
from adaptdrive.config.bus import CanBus, CanDescription, CanOpenBus, Quantity, Signals
from adaptdrive.config.load import AnyLoad, Estimator, SimulatorSection, Supervisor
from adaptdrive.util.errors import Flaw
from adaptdrive.util.quantity import BOOST_VOLTAGE, MEASURED, Given

# `[drive]` and `[voltage_loop]`: the power stage and the control of its boost voltage.

BROKER_USERS = frozenset({"operator", "viewer"})
"""Users of `deploy/mosquitto/adaptdrive.acl` that are operators, not drives."""


class DriveLimits(section.Section):
    """`[drive.limits]`: what the drive may be asked for."""

    rising: ClassVar = ("boost_reference_min_V", "boost_reference_max_V")

    boost_reference_min_V: section.FiniteFloat = 200.0
    """lowest V_c: above the line's peak where the daemon holds the voltage; below 0 for a motor
    that turns both ways"""
    boost_reference_max_V: section.PositiveFloat = 400.0
    """highest V_c"""
    current_scale_max_S: section.PositiveFloat = 0.15
    """largest line-current scale k (line current over line voltage)"""
    regeneration_scale_max_S: section.PositiveFloat | None = None
    """largest -k of a bidirectional drive: times the line voltage squared, the power that the line
    takes; current_scale_max_S when left out"""
    current_scale_slew_S: section.PositiveFloat = 0.15
    """largest change of k from one tick to the next"""

    manual_slew_V_per_s: section.PositiveFloat = 100.0
    """largest slope of V_c in mode `manual`"""
    load_power_max_W: section.PositiveFloat = 1500.0
    """load power above which V_c is held back"""


class Manipulated(section.Section):
    """`[drive.manipulated]`: what a drive is commanded, and gives, where that is no voltage.

    All keys and topics that end in `_V` are then in its unit.
    """

    name: str = section.key(BOOST_VOLTAGE, pattern=r"^[A-Za-z_][A-Za-z0-9_ ]{0,31}$")
    """name in all that leaves the daemon, such as `frequency`, `torque` or `duty`; `v_bst` is the
    voltage of a boost stage, which is there before the load is fed"""
    unit: str = section.key("V", max_length=16)
    """unit in all that leaves the daemon, such as `Hz`, `Nm`, `A` or `%`"""


class DriveSection(section.Section):
    """`[drive]`: the power-electronic drive."""

    name: str = Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_-]{0,63}$")
    """name in topics, sessions, commands, and of the drive's user on the broker"""
    kind: Literal["unidirectional", "bidirectional"] = "unidirectional"
    """whether load current may be negative"""
    line_frequency_Hz: Literal[50, 60] = 60
    """line frequency; two fast ticks fit in one period"""
    line_voltage_V: section.PositiveFloat = 120.0
    """nominal line voltage, rms, of a drive whose voltage the daemon holds"""
    boost_capacitance_F: section.PositiveFloat = 1.0e-3
    """boost capacitor"""
    enable_bit: Literal["bridge", "bridge-and-boost"] = "bridge"
    """stages that `signals.command.bridge` switches: the bridge, on from `running`, or also the
    boost stage, on from `starting`; the load is then energised while v_bst rises"""
    limits: DriveLimits = Field(default_factory=DriveLimits)
    manipulated: Manipulated = Field(default_factory=Manipulated)

    @property
    def given(self) -> Given:
        """The words for what it is commanded, and gives."""
        return Given(self.manipulated.name, self.manipulated.unit)

    @property
    def boost_needs_bridge(self) -> bool:
        """True where the bridge is on while v_bst rises."""
        return self.enable_bit == "bridge-and-boost"

    @property
    def half_cycle_s(self) -> float:
        """Half a line cycle at nominal frequency: one fast tick."""
        return 0.5 / self.line_frequency_Hz

    @property
    def current_scale_min_S(self) -> float:
        """Lowest line-current scale: 0, or negative for a bidirectional drive."""
        if self.kind == "unidirectional":
            return 0.0
        limits = self.limits
        return -(limits.regeneration_scale_max_S or limits.current_scale_max_S)

    @property
    def largest_W(self) -> float:
        """Largest power that the line is commanded to give."""
        return self.limits.current_scale_max_S * self.line_voltage_V**2

    def flaws(self) -> Iterator[Flaw]:
        """Yield a name with too many rights, and a limit of another kind of drive."""
        if self.name.lower() in BROKER_USERS:
            problem = f"{self.name!r} is a user of the broker: a drive of that name could command"
            yield Flaw("name", f"{problem} all others; choose another name")
        if self.kind == "unidirectional" and self.limits.regeneration_scale_max_S is not None:
            yield Flaw("", "limits.regeneration_scale_max_S needs kind = 'bidirectional'")


class VoltageLoop(section.Section):
    """`[voltage_loop]`: the fast loop that makes v_bst follow V_c."""

    where: Literal["daemon", "drive"] = "daemon"
    """place of the voltage loop (from V_c to the current scale)"""
    lag_s: section.NonNegativeFloat | None = None
    """mean delay from V_c to v_bst of a drive that holds its own v_bst; at most the slow period; 9
    half line cycles when left out"""


# `[[sensor_bus]]`: sensors on other buses than the drive, each with its cycle time.

STALE_CYCLES = 1.5
"""Cycles that a value must be allowed to age: it is one old when the next one comes."""

DEFAULT_STALE_CYCLES = 3.0
"""Cycles that a value may age by default: two replies in a row may be lost."""


MOST_STALE_CYCLES = 10.0
"""Cycles after which a value is old: ten replies in a row are not lost by chance."""

LONGEST_STALE_S = 10.0
"""Age at which a value is old however seldom it comes, but for the two cycles that may be lost."""


class SensorRegister(polled.Register):
    """`[sensor_bus.registers.NAME]`: one value of a module's register map."""

    device_id: int | None = section.key(None, span=(1, 255))
    """device on the same link that has the register; the bus's when left out"""


class SensorBusSection(section.Section):
    """Keys of `[[sensor_bus]]` for every kind of bus."""

    name: str = Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_-]{0,63}$")
    """name in telemetry, events and messages"""
    cycle_s: section.PositiveFloat = Field(ge=1e-3)
    """time from one measurement to the next"""
    stale_s: section.PositiveFloat | None = None
    """age at which a needed value trips the drive; three cycles when left out"""
    signals: dict[str, Quantity]
    """values by name: a quantity of `[signals]`, or any other name for `[derived]`"""

    @property
    def oldest_s(self) -> float:
        """The oldest usable value."""
        return DEFAULT_STALE_CYCLES * self.cycle_s if self.stale_s is None else self.stale_s

    def flaws(self) -> Iterator[Flaw]:
        """Yield an age that is too low, or too high."""
        yield from super().flaws()
        cycle_s, oldest_s = self.cycle_s, self.oldest_s
        lowest = f"{STALE_CYCLES * cycle_s:.4g} s, {STALE_CYCLES} times cycle_s"
        yield from section.misfit("stale_s", oldest_s, "at least", STALE_CYCLES * cycle_s, lowest)
        rare_s = max(LONGEST_STALE_S, DEFAULT_STALE_CYCLES * cycle_s)
        highest_s = min(MOST_STALE_CYCLES * cycle_s, rare_s)
        if oldest_s > highest_s:
            limits = f"{MOST_STALE_CYCLES:g} times cycle_s, and {LONGEST_STALE_S:g} s or"
            problem = f"{self.stale_s} must not exceed {highest_s:.4g} s: {limits}"
            yield Flaw("stale_s", f"{problem} {DEFAULT_STALE_CYCLES:g} times cycle_s")


class ModbusSensorSection(SensorBusSection, polled.ModbusLink):
    """Keys of `[[sensor_bus]]` for every kind of Modbus."""

    registers: dict[str, SensorRegister] = section.key({})
    """register map, by name"""

    def flaws(self) -> Iterator[Flaw]:
        """Yield what is wrong in the register maps, and with names in them."""
        yield from super().flaws()
        for device in {register.device_id for register in self.registers.values()}:
            own = {name: one for name, one in self.registers.items() if one.device_id == device}
            yield from references.map_flaws("registers", own, zero_based=self.zero_based)
        named = [(f"signals.{name}.signal", one.signal) for name, one in self.signals.items()]
        missing = "[sensor_bus.registers] has no register"
        yield from references.unknown_flaws(named, self.registers, missing)


class ModbusTcpSensors(ModbusSensorSection, polled.TcpLink):
    """`[[sensor_bus]]` with `type = "modbus-tcp"`."""

    type: Literal["modbus-tcp"]
    """kind of bus"""


class ModbusRtuSensors(ModbusSensorSection, polled.RtuLink):
    """`[[sensor_bus]]` with `type = "modbus-rtu"`."""

    type: Literal["modbus-rtu"]
    """kind of bus"""


class CanSensorSection(SensorBusSection, CanDescription):
    """`[[sensor_bus]]` with `type = "can"`: sensors that send by themselves."""

    type: Literal["can"]
    """kind of bus"""


AnySensorBus = CanSensorSection | ModbusTcpSensors | ModbusRtuSensors


# `[derived.NAME]`: quantities from measured values.

VOLTAGE_TICKS = 3.0
"""Half cycles from one value of v_bst to the next for a voltage loop in the daemon: it overshoots
by a fiftieth then, with 12 it charges the capacitor past the trip of `boost_voltage_max_V`."""


Rule = Literal["sum", "mean", "difference", "product", "ratio", "smallest", "largest"]

PAIRS = ("difference", "ratio")


class Derived(section.Converted):
    """`[derived.NAME]`: a quantity of `[signals]`, or any other name, from measured values."""

    rule: Rule
    """rule: `difference` is the first minus the second, `ratio` the first divided by the second"""
    of: list[str] = Field(min_length=1)
    """names of values: of the drive, of sensor buses, or derived"""
    follows: list[str] | None = None
    """names of `of` that the load moves: each is watched for a frozen value
    (`interlocks.stuck_distance`, `stuck_s`). All when left out, of a `difference` and a `ratio` the
    first"""

    @property
    def moved(self) -> list[str]:
        """Names of those values that the load moves."""
        if self.follows is not None:
            return self.follows
        return self.of[:1] if self.rule in PAIRS else self.of


def moved_inputs(name: str, derived: Mapping[str, Derived]) -> tuple[str, ...]:
    """Return the measured values that the load moves a derived one by; none for a measured one.

    Args:
        name: The value.
        derived: `[derived]`, without cycles.
    """
    if name not in derived:
        return ()
    found = (moved_inputs(part, derived) or (part,) for part in derived[name].moved)
    return tuple(dict.fromkeys(chain.from_iterable(found)))


def in_order(derived: Mapping[str, Derived]) -> list[str]:
    """Names, each after those that it is made of.

    Raises:
        CycleError: A value is made of itself.
    """
    order = TopologicalSorter({name: one.of for name, one in derived.items()}).static_order()
    return [name for name in order if name in derived]


def needed_names(derived: Mapping[str, Derived], names: Iterable[str] = MEASURED) -> set[str]:
    """Return every name that values are made of, and their own.

    Args:
        derived: `[derived]`.
        names: Names of the values, the quantities when left out.
    """
    needed = set(names)
    while more := {part for name in needed & derived.keys() for part in derived[name].of} - needed:
        needed |= more
    return needed


# The whole configuration of one drive.

AnyBus = CanBus | CanOpenBus | polled.ModbusTcp | polled.ModbusRtu | polled.ScpiBus

SensorBus = Annotated[AnySensorBus, Field(discriminator="type")]


class Configuration(section.Section):
    """One TOML file, one drive; `consistency_flaws` compares the sections with each other."""

    drive: DriveSection
    bus: AnyBus = Field(discriminator="type")
    signals: Signals
    sensor_bus: list[SensorBus] = Field(default=[])
    derived: dict[str, Derived] = Field(default={})
    voltage_loop: VoltageLoop = Field(default_factory=VoltageLoop)
    load: AnyLoad = Field(discriminator="type")
    estimator: Estimator = Field(default_factory=Estimator)
    supervisor: Supervisor = Field(default_factory=Supervisor)
    interlocks: services.InterlocksSection
    mqtt: services.Mqtt = Field(default_factory=services.Mqtt)
    recording: services.Recording = Field(default_factory=services.Recording)
    health: services.Health = Field(default_factory=services.Health)
    realtime: services.Realtime = Field(default_factory=services.Realtime)
    simulation: SimulatorSection = Field(default_factory=SimulatorSection)

    @property
    def ticks_per_period(self) -> int:
        """Q: fast ticks in one slow period."""
        return round(2 * self.drive.line_frequency_Hz * self.load.period_s)
