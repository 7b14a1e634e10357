"""A course of v_bst after which the impulse-invariant model (24) holds.

An impulse of area T·V_c at each slow instant is out of reach: within one half line cycle it would
be 120 V_c. The sampled output depends on less: a load with time constants far above T takes from
the course of its input only the area and the first moments. So V_c is held, and each change of it,
ΔV, is exaggerated for a while: by c_1 ΔV, then by c_2 ΔV, each for a share of the period. With S_d
the response to a step that acts d after the slow instant, the numerator of the sampled load is

    B = B_d + c_1 (B_d - B_(d+w)) + c_2 (B_(d+w) - B_(d+2w))

and c_1, c_2 are chosen so that only its first coefficient is left, as in (24).
"""

from __future__ import annotations

from adaptdrive.control.discretise import held_model
from adaptdrive.control.load import Load
from adaptdrive.control.vectors import Vector

KICK_SHARE = 0.25
"""Length of each of the two parts over the period: the shorter, the larger are the voltages."""


def kick_factors(
    load: Load, period_s: float, delay_s: float, width_s: float
) -> tuple[float, float]:
    """Return c_1 and c_2.

    Args:
        load: Of second order.
        period_s: T.
        delay_s: From the slow sample to the effect of V_c, above 0.
        width_s: w.
    """
    starts_s = (delay_s, delay_s + width_s, delay_s + 2.0 * width_s)
    held, later, latest = (_numerator(load, period_s, one) for one in starts_s)
    first = [held[i] - later[i] for i in range(len(held))]
    second = [later[i] - latest[i] for i in range(len(held))]
    determinant = first[2] * second[3] - first[3] * second[2]
    c1 = (held[3] * second[2] - held[2] * second[3]) / determinant
    c2 = (held[2] * first[3] - held[3] * first[2]) / determinant
    return c1, c2


def _numerator(load: Load, period_s: float, delay_s: float) -> Vector:
    return held_model(list(load.numerator), list(load.denominator), period_s, delay_s, 0.0)[1]
