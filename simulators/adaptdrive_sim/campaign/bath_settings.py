"""Contents of a campaign's file for baths."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from adaptdrive_sim.campaign.settings import (
    CampaignFile,
    CampaignTable,
    DriveWireRanges,
    LineRanges,
    Range,
    ShapeName,
    WholeRange,
    within,
)
from adaptdrive_sim.plants.bath import Bath, BathParameters
from adaptdrive_sim.plants.coupling import CouplingParameters

NOMINAL_REACH_K = (5.5, 20.0)
"""Least and largest set-point of the example: 200 and 400 V hold 5.3 and 21 K."""

_BOOST_V = (200.0, 400.0)

_EDGE = 0.05
"""Least distance from what V_c holds to a set-point, as a share: noise needs some room."""


def bath_reach(
    inflows: Iterable[float], resistances: Iterable[float], shift_K: float
) -> tuple[float, float]:
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


def held_K(inflow: float, resistance: float) -> tuple[float, float]:
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
