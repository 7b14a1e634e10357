"""Set-points that V_c can hold."""

from __future__ import annotations

NOMINAL_REACH = (2.2, 4.4)
"""Outputs that V_c = 200…400 V holds with the gain of the controller's model, in volts."""

NOMINAL_GAIN = 0.011
"""Gain of the controller's model, in tachometer volts per volt of V_c."""

MIDDLE = 3.3
"""Output in the middle of that range: the drag is drawn for it."""

_EDGE = 0.05
"""Least distance from there to a set-point, as a share: torque and noise need some room."""


def reach(gain: float, brake_V: float, drag_V: float) -> tuple[float, float]:
    """Return the least and the largest set-point, by the drawn load and by the model.

    The daemon refuses what the model does not reach, and its output limit lies above that.

    Args:
        gain: Of the tachometer, relative to the model's.
        brake_V: Largest torque and dry friction, in volts of V_c.
        drag_V: Drag in the middle of the range, likewise.
    """
    least = (1.0 + _EDGE) * max(1.0, gain) * NOMINAL_REACH[0]
    most = (1.0 - _EDGE) * min(1.0, gain) * NOMINAL_REACH[1]
    speed = most / gain / MIDDLE
    return least, most - NOMINAL_GAIN * gain * (brake_V + drag_V * speed * speed)
