"""Contents of a campaign's file, for motors and for baths."""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Literal, Self, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import ErrorDetails

from adaptdrive.config.file import read_tables, read_text
from adaptdrive.util.errors import ConfigurationError, Flaw
from adaptdrive_sim.plants.bath import Bath, BathParameters
from adaptdrive_sim.plants.boost import CouplingParameters

# Contents of a campaign's file.

Range = tuple[float, float]
WholeRange = tuple[int, int]


class CampaignTable(BaseModel):
    """A table of a campaign's file."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


def within(low: float, high: float) -> AfterValidator:
    """Make sure that a range is one, and lies within limits."""

    def check(pair: Range) -> Range:
        if not (low <= pair[0] and pair[1] <= high):
            raise ValueError(f"must lie within {low:g}…{high:g}")
        if pair[0] > pair[1]:
            raise ValueError(f"the lower end {pair[0]:g} is above the upper end {pair[1]:g}")
        return pair

    return AfterValidator(check)


class LifeRanges(CampaignTable):
    """Nothing of it happens where it is left out.

    Attributes:
        torque_changes: How often the load torque moves.
        torque_V: Where it moves to, in volts of V_c.
        torque_ramp_s: How long each movement takes that is no jump.
        inertia_ramp_s: How long each change of the inertia takes that is no jump.
        sudden: Share of the movements of torque and inertia that are jumps.
        idle: How often the reference stops where it is.
        idle_s: For how long.
        constant: Share of runs whose reference never moves.
        restarted: Share of runs in which the drive is disabled once, and enabled again while the
            motor coasts.
        off_s: For how long.
        coulomb_V: Dry friction, in volts of V_c.
        drag_V: Quadratic friction in the middle of the range of set-points, in volts of V_c.
        offset: What the sensor shows in addition to the output, in the unit of the output.
    """

    torque_changes: Annotated[WholeRange, within(0, 1000)] = (0, 0)
    torque_V: Annotated[Range, within(0.0, 60.0)] = (0.0, 0.0)
    torque_ramp_s: Annotated[Range, within(0.0, 1e5)] = (0.0, 0.0)
    inertia_ramp_s: Annotated[Range, within(0.0, 1e5)] = (0.0, 0.0)
    sudden: float = Field(default=0.0, ge=0.0, le=1.0)
    idle: Annotated[WholeRange, within(0, 100)] = (0, 0)
    idle_s: Annotated[Range, within(0.0, 1e6)] = (0.0, 0.0)
    constant: float = Field(default=0.0, ge=0.0, le=1.0)
    restarted: float = Field(default=0.0, ge=0.0, le=1.0)
    off_s: Annotated[Range, within(2.0, 60.0)] = (10.0, 10.0)
    coulomb_V: Annotated[Range, within(0.0, 40.0)] = (0.0, 0.0)
    drag_V: Annotated[Range, within(0.0, 40.0)] = (0.0, 0.0)
    offset: Annotated[Range, within(-0.2, 0.2)] = (0.0, 0.0)


NOMINAL_REACH = (2.2, 4.4)
"""Outputs that V_c = 200…400 V holds with the gain of the controller's model, in volts."""

NOMINAL_GAIN = 0.011
"""Gain of the controller's model, in tachometer volts per volt of V_c."""

MIDDLE = 3.3
"""Output in the middle of that range: the drag is drawn for it."""

_EDGE = 0.05
"""Least distance from there to a set-point, as a share: torque and noise need some room."""


def reach(gain: float, brake_V: float, drag_V: float) -> Range:
    """Return the least and the largest set-point, by the drawn load and by the model.

    The daemon refuses what the model does not reach, and its output limit lies above that.

    Args:
        gain: Of the tachometer, relative to the model's.
        brake_V: Largest torque and dry friction, in volts of V_c.
        drag_V: Drag in the middle of the range, as above.
    """
    least = (1.0 + _EDGE) * max(1.0, gain) * NOMINAL_REACH[0]
    most = (1.0 - _EDGE) * min(1.0, gain) * NOMINAL_REACH[1]
    speed = most / gain / MIDDLE
    return least, most - NOMINAL_GAIN * gain * (brake_V + drag_V * speed * speed)


MOST_RUNS = 10_000_000
FOLDER = Path(__file__).resolve().parent


class CampaignFile(CampaignTable):
    """Keys that the files of all loads have."""

    runs: int = Field(ge=1, le=MOST_RUNS)
    seed: int = Field(ge=0)


FileOfAnyType = TypeVar("FileOfAnyType", bound=CampaignFile)

ShapeName = Literal["square", "triangle", "sine"]


class LoadRanges(CampaignTable):
    """The motor: inertia in disks, the rest relative to the settings of the controller."""

    inertia: Annotated[Range, within(0.2, 10.0)]
    gain: Annotated[Range, within(0.56, 1.8)]
    filter: Annotated[Range, within(0.3, 3.0)]
    unchanged: float = Field(ge=0.0, le=1.0)
    changes: Annotated[WholeRange, within(1, 20)]
    change_min: float = Field(ge=1.0, le=10.0)
    quiet_s: float = Field(ge=0.0)


class ReferenceRanges(CampaignTable):
    """The set-point's waveform; it is moved into what V_c can hold with the drawn load.

    Attributes:
        low_above: What is drawn and added to `low`, in the unit of the output.
        preview: Whether the adaptive controller receives the set-points to come.
    """

    low: float = Field(ge=2.0, le=4.0)
    low_above: Annotated[Range, within(0.0, 2.0)] = (0.0, 0.0)
    step: Annotated[Range, within(1e-3, 1.0)]
    period_s: Annotated[Range, within(10.0, 1e4)]
    shapes: list[ShapeName] = Field(min_length=1)
    preview: bool = False


class NoiseRanges(CampaignTable):
    """Measurement noise, as fractions of the step."""

    sigma: Annotated[Range, within(0.0, 1.0)]
    spike_share: Annotated[Range, within(0.0, 1.0)]
    spike_sigma: float = Field(ge=0.0, le=10.0)


class LineRanges(CampaignTable):
    """The ac line."""

    voltage: Annotated[Range, within(0.5, 1.1)]
    frequency_Hz: Annotated[Range, within(55.0, 65.0)]


class DriveWireRanges(CampaignTable):
    """Resolution of what the drive measures and is commanded, apart from the output."""

    voltage_V: Annotated[Range, within(0.0, 10.0)]
    power_W: Annotated[Range, within(0.0, 100.0)]
    scale_S: Annotated[Range, within(0.0, 0.01)]


class WireRanges(DriveWireRanges):
    """The same, with the resolution of the output and the age of its samples."""

    output_delay_ticks: Annotated[WholeRange, within(0, 20)]
    output_V: Annotated[Range, within(0.0, 1.0)]


class Campaign(CampaignFile):
    """A whole file."""

    type: Literal["motor"] = "motor"
    duration_s: float = Field(ge=120.0, le=1e6)
    load: LoadRanges
    reference: ReferenceRanges
    noise: NoiseRanges
    line: LineRanges
    wire: WireRanges
    life: LifeRanges = LifeRanges()

    @model_validator(mode="after")
    def _leave_room(self) -> Self:
        """Make sure that every drawn motor has set-points that V_c can hold."""
        life = self.life
        brake_V = life.torque_V[1] + life.coulomb_V[1]
        for gain in self.load.gain:
            least, most = reach(gain, brake_V, life.drag_V[1])
            if most <= least:
                taken = f"life takes {brake_V:g} V and a drag of {life.drag_V[1]:g} V"
                raise ValueError(f"load.gain = {gain:g}: V_c holds no set-point, {taken}")
        return self


def read_campaign(path: Path) -> Campaign:
    """Read a file of motors.

    Raises:
        ConfigurationError: It cannot be read, or a value is not allowed.
    """
    return read_campaign_of(path, {"motor": Campaign})


def read_campaign_of(path: Path, types: Mapping[str, type[FileOfAnyType]]) -> FileOfAnyType:
    """Read a file; a bare name that is no file is looked up among those that come along.

    Args:
        path: The file.
        types: The contents that its key `type` may name; without the key it is of motors.

    Raises:
        ConfigurationError: It cannot be read, or a value is not allowed.
    """
    shipped = FOLDER / path.name
    found = path if path.exists() or not shipped.exists() else shipped
    try:
        # strict validation takes arrays for tuples from JSON only
        tables = read_tables(read_text(found), path)
        if (named := tables.get("type", "motor")) not in types:
            wanted = f"must be one of {', '.join(types)}"
            raise ConfigurationError.of(path, f"type = {named!r}", wanted)
        return types[named].model_validate_json(json.dumps(tables))
    except ValidationError as problem:
        raise ConfigurationError(path, [_flaw(error) for error in problem.errors()]) from problem


def _flaw(error: ErrorDetails) -> Flaw:
    place = ".".join(str(part) for part in error["loc"]) or "file"
    valued = place != "file" and error["type"] not in {"missing", "extra_forbidden"}
    return Flaw(f"{place} = {error['input']!r}" if valued else place, error["msg"])


# Contents of a campaign's file for baths.

NOMINAL_REACH_K = (5.5, 20.0)
"""Least and largest set-point of the example: 200 and 400 V hold 5.3 and 21 K."""

_BOOST_V = (200.0, 400.0)


def bath_reach(inflows: Iterable[float], resistances: Iterable[float], shift_K: float) -> Range:
    """Return the least and the largest set-point, by the drawn bath and by the model.

    Args:
        inflows: Flows of the run, relative to the model's.
        resistances: Of the heater in the run, relative to the nominal one.
        shift_K: How far inflow and sensor may shift the temperature, up or down.
    """
    baths = [held_K(inflow, one) for inflow in inflows for one in resistances]
    least = (1.0 + _EDGE) * max(low for low, _ in baths) + shift_K
    most = (1.0 - _EDGE) * min(high for _, high in baths) - shift_K
    return max(least, NOMINAL_REACH_K[0]), min(most, NOMINAL_REACH_K[1])


def held_K(inflow: float, resistance: float) -> Range:
    """Return the temperatures at which a bath rests at the lowest and at the highest V_c."""
    bath, stage = Bath(bath_parameters(1.0, inflow, resistance)), CouplingParameters()
    model = bath.model(stage.ratio, stage.droop_Ohm)
    per_V2 = model["resistance_K_per_W"] * model["heater_W_per_V2"]
    return per_V2 * _BOOST_V[0] ** 2, per_V2 * _BOOST_V[1] ** 2


def bath_parameters(volume: float, inflow: float, resistance: float) -> BathParameters:
    """Return the reference bath with everything relative to it.

    Args:
        volume: At the start.
        inflow: At the start.
        resistance: Of the heater at the start.
    """
    nominal = BathParameters()
    return BathParameters(
        heater_Ohm=nominal.heater_Ohm * resistance,
        inflow_L_per_min=nominal.inflow_L_per_min * inflow,
        volume_gal=nominal.volume_gal * volume,
    )


class WaterRanges(CampaignTable):
    """The water; its flow is relative to the settings of the controller.

    Attributes:
        volume_gal: Volume.
        unchanged: Share of runs whose volume never changes.
        fills: How often it changes in the others.
        fill_min: By this factor at least, up or down.
        fill_s: How long each change takes; the same for all of a run.
        inflow: Flow into the bath.
        inflow_changes: How often it moves.
        drift_K_per_h: How fast the temperature of the inflow drifts, up or down.
        turn_s: After which the drift turns.
        quiet_s: Nothing moves for that long after the start and before the end.
    """

    volume_gal: Annotated[Range, within(0.1, 10.0)]
    unchanged: float = Field(ge=0.0, le=1.0)
    fills: Annotated[WholeRange, within(1, 20)]
    fill_min: float = Field(ge=1.0, le=10.0)
    fill_s: Annotated[Range, within(0.0, 1e5)]
    inflow: Annotated[Range, within(0.3, 3.0)]
    inflow_changes: Annotated[WholeRange, within(0, 20)]
    drift_K_per_h: Annotated[Range, within(0.0, 10.0)]
    turn_s: Annotated[Range, within(60.0, 1e6)]
    quiet_s: float = Field(ge=0.0)


class HeaterRanges(CampaignTable):
    """The heater: its resistance, relative to the settings of the controller, and how it ages."""

    resistance: Annotated[Range, within(0.5, 2.0)]
    ageing_per_h: Annotated[Range, within(0.0, 0.5)]


class BathReferenceRanges(CampaignTable):
    """The set-point's waveform; it is moved into what V_c can hold with the drawn bath.

    Attributes:
        low: Least of its low ends, in kelvin above the inflow.
        low_above: What is drawn and added to `low`.
        step: Its height.
        period_s: Its period.
        shapes: Its shapes, drawn with these odds.
        constant: Share of runs whose reference never moves.
    """

    low: float = Field(ge=0.0, le=20.0)
    low_above: Annotated[Range, within(0.0, 20.0)]
    step: Annotated[Range, within(1e-2, 15.0)]
    period_s: Annotated[Range, within(200.0, 1e5)]
    shapes: list[ShapeName] = Field(min_length=1)
    constant: float = Field(ge=0.0, le=1.0)


class SensorRanges(CampaignTable):
    """The sensor of the temperature."""

    sigma_K: Annotated[Range, within(0.0, 5.0)]
    spike_share: Annotated[Range, within(0.0, 1.0)]
    spike_K: float = Field(ge=0.0, le=20.0)
    output_K: Annotated[Range, within(0.0, 2.0)]
    offset_K: Annotated[Range, within(-5.0, 5.0)]
    output_delay_ticks: Annotated[WholeRange, within(0, 20)]


class BathCampaign(CampaignFile):
    """A whole file."""

    type: Literal["bath"]
    duration_s: float = Field(ge=1200.0, le=1e6)
    water: WaterRanges
    heater: HeaterRanges
    reference: BathReferenceRanges
    sensor: SensorRanges
    line: LineRanges
    wire: DriveWireRanges

    @model_validator(mode="after")
    def _leave_room(self) -> Self:
        """Make sure that every drawn bath has set-points that V_c can hold."""
        aged = 1.0 + self.heater.ageing_per_h[1] * self.duration_s / 3600.0
        low, high = self.heater.resistance
        drifted_K = self.water.drift_K_per_h[1] * self.water.turn_s[1] / 3600.0
        shift_K = drifted_K + max(map(abs, self.sensor.offset_K))
        least, most = bath_reach(self.water.inflow, (low, high * aged), shift_K)
        if most <= least:
            taken = f"between {least:.3g} and {most:.3g} K"
            raise ValueError(f"water.inflow = {self.water.inflow}: V_c holds no set-point, {taken}")
        return self
