"""The load loop's control law, on a history that every law shares.

    u[k] = - Σ r_i u[k-i] + t0 r'[k] - Σ s_j y[k-j]         t0 = Σ s_j,  1 + Σ r_i = 0
    r'[k] = r[k] + d (r[k] - r[k-1])

(26) with (28) as corrected, and (14), are of this form. The history holds the inputs that were
really applied: limited ones, and measured ones where the drive could not follow. That is the
anti-windup. Because Σ r_i = -1 and t0 = Σ s_j, any gains give the same u at rest with zero error:
that is what makes a change of gains bumpless.

The loop acts d slow periods late. The lead d on a change of the reference makes up for it: the
response is that of the loop without delay, to first order.
"""

from __future__ import annotations

from adaptdrive.control.vectors import Vector


def control_law(gains: Vector, inputs: Vector, outputs: Vector, reference: float) -> float:
    """u[k] before limits.

    Args:
        gains: r_1 ... r_n, s_0 ... s_m.
        inputs: u[k-1] ... u[k-n], as applied.
        outputs: y[k] ... y[k-m].
        reference: r'[k].
    """
    result = 0.0
    for i in range(len(inputs)):
        result -= gains[i] * inputs[i]
    for j in range(len(outputs)):
        result += gains[len(inputs) + j] * (reference - outputs[j])
    return result


def lead_reference(reference: float, last_reference: float, lead: float) -> float:
    """r'[k].

    Args:
        reference: r[k].
        last_reference: r[k-1].
        lead: d, delay of the loop in slow periods; 0 for none.
    """
    return reference + lead * (reference - last_reference)
