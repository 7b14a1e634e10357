"""The values that enter and leave the controller.

Everything the controller knows arrives in a `Measurement` and an `Order`; everything it wants
leaves in a `Command`. A recording of the first two reproduces the third bit for bit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum


class Mode(StrEnum):
    """Which load controller the operator asks for."""

    FIXED = "fixed"
    ADAPTIVE = "adaptive"


class Stage(StrEnum):
    """How far the drive may be energised at a tick."""

    OFF = "off"
    PRECHARGE = "precharge"
    RUN = "run"


@dataclass(frozen=True, slots=True)
class Measurement:
    """What drive and sensors said at one fast tick.

    Attributes:
        tick: Half-cycle counter of the drive, unwrapped.
        tick_period_s: Measured length of one half line cycle.
        boost_voltage_V: Voltage of the boost capacitor, v_bst.
        line_voltage_V: Line voltage, rms.
        load_power_W: Power drawn from the boost capacitor by the load.
        output: The regulated quantity in its own unit (tachometer volts, kelvin, ampere).
        fresh: False where a stand-in tick holds the values of an earlier one.
    """

    tick: int
    tick_period_s: float
    boost_voltage_V: float
    line_voltage_V: float
    load_power_W: float
    output: float
    fresh: bool = True


@dataclass(frozen=True, slots=True)
class Order:
    """What is asked of the controller at one fast tick.

    Attributes:
        stage: How far the drive may be energised.
        reference: Set-point in the unit of the output.
        mode: Fixed or adaptive load controller.
        pole: Closed-loop pole of the load loop, in the z-plane of the slow rate.
    """

    stage: Stage
    reference: float
    mode: Mode
    pole: float


@dataclass(frozen=True, slots=True)
class Command:
    """What the drive is told at one fast tick.

    Attributes:
        current_scale_S: Line-current scale k: line current over line voltage.
        boost_reference_V: V_c, for drives that hold their own boost voltage.
        bridge: True when the dc/dc bridge may feed the load.
    """

    current_scale_S: float
    boost_reference_V: float
    bridge: bool


SAFE_COMMAND = Command(current_scale_S=0.0, boost_reference_V=0.0, bridge=False)


@dataclass(frozen=True, slots=True)
class Snapshot:
    """What the fast half hands to the slow half at tick n = kQ.

    Attributes:
        k: Slow index.
        tick: Fast index at which the snapshot was taken.
        period_s: Slow period T_k = Q times the measured tick period.
        order: What was asked at this tick.
        output: Decimated output.
        output_filtered: The λ chain of the output, `[λy, λ²y, ...]`, decimated like the output.
        input_filtered: The λ chain of the load's input, `[u, λu, λ²u, ...]`, decimated likewise.
        applied_V: Mean boost voltage over the elapsed slow period.
        followed: False where a limit kept the boost voltage from following V_c.
        held_ticks: Stand-in ticks in the elapsed slow period.
    """

    k: int
    tick: int
    period_s: float
    order: Order
    output: float
    output_filtered: tuple[float, ...]
    input_filtered: tuple[float, ...]
    applied_V: float
    followed: bool
    held_ticks: int


@dataclass(frozen=True, slots=True)
class Estimate:
    """One estimated parameter and its standard deviation (NaN while unknown)."""

    value: float
    std: float


@dataclass(frozen=True, slots=True)
class Decision:
    """What the slow half made of one snapshot.

    Attributes:
        k: Slow index of the snapshot.
        boost_reference_V: V_c after limits.
        controller: The controller in force (`fixed` until the estimates are trusted).
        accepted: True when the estimates of this step reached the adaptive gains.
        reason: Why the controller in force is in force, or why the estimates were kept out.
        estimates: Estimated load parameters by name.
        gains: The gains in force, `[r1.., s0.., t0]`.
        innovation: One-step prediction error of the estimator.
        excitation: rᵀPr of the step: how much it could teach.
        handover_step_V: Law not in force minus law in force, on the same history.
        pole: Closed-loop pole in force; slower than asked for while the actuator cannot follow.
        fault: Why the drive must be tripped, empty for no reason to.
        complete: True when there is nothing left to do, such as a full battery.
    """

    k: int
    boost_reference_V: float
    controller: Mode
    accepted: bool
    reason: str
    estimates: dict[str, Estimate]
    gains: tuple[float, ...]
    innovation: float
    excitation: float
    handover_step_V: float
    pole: float = math.nan
    fault: str = ""
    complete: bool = False
