"""Table `[life]` of a campaign's file: what happens to a motor while it runs."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from adaptdrive_sim.campaign.ranges import CampaignTable, Range, WholeRange, within


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
        offset: What the sensor shows beside the output, in the unit of the output.
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
