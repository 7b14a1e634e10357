"""Controllers that a user would otherwise choose, in their textbook forms.

Each decides the input u of the load once in a slow period, from the mean of the output in the
averaging window. All know the nominal model of the load, the delays of the drive and the limits.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are, toeplitz
from scipy.optimize import lsq_linear
from scipy.signal import lfilter, lfiltic

from adaptdrive.control.design.pole_placement import Plant, desired_polynomial
from adaptdrive.control.loads.discretise import held_model
from adaptdrive.control.loads.load import Load

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Task:
    """What a controller may know of its task.

    Attributes:
        nominal: Model of the load before the run.
        lags_s: Its time constants, and those that a step response would show beside them.
        truth: Model of the true load in slow period k, for a controller that knows it.
        pole: Closed-loop pole asked for.
        period_s: Slow period.
        delay_s: From the slow instant to the effect of u.
        window_s: Length of the averaging window.
        low: Least u.
        high: Largest u.
        output: Output at the start, at rest.
        rest: u that holds it.
        noise: Standard deviation of the output in a slow sample.
        references: Set-point of every slow period, for a controller that knows the waveform.
    """

    nominal: Load
    lags_s: tuple[float, ...]
    truth: Callable[[int], Load]
    pole: float
    period_s: float
    delay_s: float
    window_s: float
    low: float
    high: float
    output: float
    rest: float
    noise: float
    references: Array

    def model(self, load: Load) -> tuple[Array, Array]:
        """A and B of a load with all delays."""
        shape = list(load.numerator), list(load.denominator)
        a, b = held_model(*shape, self.period_s, self.delay_s, self.window_s)
        return np.array(a), np.array(b)

    @property
    def led(self) -> Array:
        """The set-points, extrapolated over the delay of u."""
        moved = np.diff(self.references, prepend=self.references[:1])
        return self.references + self.delay_s / self.period_s * moved

    def limited(self, wanted: float) -> float:
        """The nearest u between the limits."""
        return min(max(wanted, self.low), self.high)


class Rival(Protocol):
    """A controller."""

    def decide(self, k: int, output: float) -> float:
        """Return u from slow instant k on, within its limits."""


class Pid:
    """PID with the derivative of the output and an integral that is held within the limits."""

    def __init__(self, task: Task, gain: float, integral_s: float, derivative_s: float) -> None:
        self.task, self.gain, self.derivative_s = task, gain, derivative_s
        self.rise = gain * task.period_s / integral_s
        self.sum, self.before = task.rest, task.output

    def decide(self, k: int, output: float) -> float:
        """PID."""
        error = float(self.task.references[k]) - output
        slope = (output - self.before) / self.task.period_s
        self.sum, self.before = self.task.limited(self.sum + self.rise * error), output
        return self.task.limited(self.sum + self.gain * (error - self.derivative_s * slope))


def simc_pi(task: Task) -> Pid:
    """PI by the SIMC rules with the closed-loop time constant τ_c = θ (Skogestad 2003)."""
    load = task.nominal
    gain = load.numerator[-1] / load.denominator[-1]
    lags_s = sorted(task.lags_s, reverse=True)
    if load.numerator[0] != 0.0:  # most of the response comes at once: a gain and dead time
        gain, lags_s = load.numerator[0], [0.0]
    half_s = 0.5 * sum(lags_s[1:2])
    dead_s = task.delay_s + 0.5 * (task.window_s + task.period_s) + half_s + sum(lags_s[2:])
    lag_s = max(lags_s[0] + half_s, 1e-6 * dead_s)
    return Pid(task, lag_s / (gain * 2.0 * dead_s), min(lag_s, 8.0 * dead_s), 0.0)


def relay_pid(task: Task) -> Pid:
    """PID by the Ziegler-Nichols rules from a relay experiment on the nominal load.

    The ultimate gain follows from the swing as 4d/(π√(a² - ε²)) (Åström and Hägglund 1984).
    """
    a, b = task.model(task.nominal)
    noise = task.noise * np.random.default_rng(1).standard_normal(4000)
    height, hysteresis = 0.2 * (task.high - task.low), 3.0 * task.noise
    inputs, outputs, switched = [height] + [0.0] * (len(b) - 1), [0.0] * len(a), [0]
    for k in range(1, 4000):
        outputs = [float(b[1:] @ inputs[: len(b) - 1] - a[1:] @ outputs[: len(a) - 1]), *outputs]
        shown = outputs[0] + float(noise[k])
        up = shown < -hysteresis or (inputs[0] > 0.0 and shown <= hysteresis)
        switched += [k] if up != (inputs[0] > 0.0) else []
        inputs = [height if up else -height, *inputs]
    cycles = [late - early for early, late in pairwise(switched[9::2])]
    period_s = task.period_s * float(np.mean(cycles))
    swing = 0.5 * float(np.ptp(outputs[: 4000 - switched[9]]))
    ultimate = 4.0 * height / (math.pi * math.sqrt(max(swing**2 - hysteresis**2, 1e-12)))
    return Pid(task, 0.6 * ultimate, 0.5 * period_s, 0.125 * period_s)


class LeastSquares:
    """Recursive least squares on the samples and pole placement in each slow period.

    The textbook's self-tuning regulator (Åström and Wittenmark, Adaptive Control, chapter 3): an
    ARX model with a constant, forgetting, and a bound of P. Nothing judges the estimate.
    """

    forgetting, wait, most = 0.98, 90, 1e3

    def __init__(self, task: Task) -> None:
        self.task, self.led = task, task.led
        a, b = task.model(task.nominal)
        self.order = len(a) - 1
        rest = (sum(a) * task.output - sum(b) * task.rest) / task.output
        self.theta = np.array([*-a[1:], *b[1:] * task.rest / task.output, rest])
        self.spread = np.eye(len(self.theta))
        self.inputs, self.outputs = [task.rest] * 8, [task.output] * 8
        self.b, self.aim = list(b), task.output
        self.r, self.s = Plant(list(a), self.b).place(self.desired)

    @property
    def desired(self) -> list[float]:
        """A_m."""
        return desired_polynomial(self.task.pole, 2 * self.order)

    def decide(self, k: int, output: float) -> float:
        """Learn, design and control."""
        self.learn(output)
        if k > self.wait:
            self.design()
        self.outputs = [output, *self.outputs[:7]]
        past = float(np.dot(self.r[1:], self.inputs[: len(self.r) - 1]))
        fed_back = float(np.dot(self.s, self.outputs[: len(self.s)]))
        wanted = sum(self.s) * self.aimed(k) - past - fed_back
        self.inputs = [self.task.limited(wanted), *self.inputs[:7]]
        return self.inputs[0]

    def aimed(self, k: int) -> float:
        """Set-point, without the zero of a load that responds at once."""
        if self.task.nominal.numerator[0] == 0.0:
            return float(self.led[k])
        pole, references = self.task.pole, self.task.references
        moved = float(references[k] - pole * references[max(0, k - 1)])
        scale = (1.0 - pole) / (sum(self.s) * self.b[1])
        self.aim = scale * moved - self.b[2] / self.b[1] * self.aim
        return self.aim

    def learn(self, output: float) -> None:
        """One step of recursive least squares, on values over those at the start."""
        taps = len(self.theta) - self.order - 1
        outputs = np.array([output, *self.outputs]) / self.task.output
        inputs = np.array(self.inputs[:taps]) / self.task.rest
        phi = np.array([*outputs[1 : self.order + 1], *inputs, 1.0])
        gain = self.spread @ phi / (self.forgetting + phi @ self.spread @ phi)
        self.theta = self.theta + gain * (outputs[0] - phi @ self.theta)
        self.spread = (self.spread - np.outer(gain, phi @ self.spread)) / self.forgetting
        self.spread *= min(1.0, self.most / np.trace(self.spread))

    def design(self) -> None:
        """Pole placement for the estimate; a design that is not finite is not used."""
        a = [1.0, *-self.theta[: self.order]]
        b = [0.0, *self.theta[self.order : -1] * self.task.output / self.task.rest]
        r, s = Plant(a, b).place(self.desired)
        if np.all(np.isfinite([*r, *s])):
            self.r, self.s, self.b = r, s, b


class Predictive:
    """Model predictive control that knows the true load, and the waveform where it may.

    It follows the course asked for with the least squares of its error and of the moves beyond
    those that the course needs, within the limits. An observer finds output and disturbance.
    """

    horizon, weight, unrest = 30, 1e-3, 0.01

    def __init__(self, task: Task, *, preview: bool) -> None:
        self.task, self.led, self.preview = task, task.led, preview
        self.load: Load | None = None
        self.x: Array = np.zeros(0)
        self.desired = np.array(desired_polynomial(task.pole, 2 * task.nominal.order))
        self.course = [task.output] * 12
        self.inputs, self.outputs = [task.rest] * 12, [task.output] * 12

    def retune(self, load: Load) -> None:
        """Observer and prediction for a load."""
        self.load = load
        self.a, self.b = a, b = self.task.model(load)
        if load.numerator[0] != 0.0:  # a single pole is asked for: the load's zero is cancelled
            self.desired = np.convolve(b[1:] / b[1], [1.0, -self.task.pole])
        n, horizon = max(len(a), len(b)) - 1, self.horizon
        disturbance = self.task.output * sum(a) / sum(b) - self.task.rest
        if self.x.size:
            disturbance = self.x[-1]
        self.f = np.zeros((n + 1, n + 1))
        self.f[: len(a) - 1, 0], self.f[: n - 1, 1:n] = -a[1:], np.eye(n - 1)
        self.g = np.zeros(n + 1)
        self.g[: len(b) - 1] = b[1:]
        self.f[:n, n], self.f[n, n] = self.g[:n], 1.0
        self.x = np.array([*self._remembered(n, disturbance), disturbance])
        unrest = self.unrest * (self.task.high - self.task.low)
        moved = np.outer(self.g, self.g) * unrest**2 + 1e-14 * np.eye(n + 1)
        moved[n, n] += unrest**2
        c = np.eye(1, n + 1)
        noise = np.array([[max(self.task.noise, 1e-5 * abs(self.task.output)) ** 2]])
        p = solve_discrete_are(self.f.T, c.T, moved, noise)
        self.correction = (p @ c.T / (c @ p @ c.T + noise))[:, 0]
        rows = [c[0]]
        for _ in range(horizon):
            rows.append(rows[-1] @ self.f)
        self.free = np.array(rows[1:])
        answer = np.array([row @ self.g for row in rows[:-1]])
        weight = math.sqrt(self.weight) * sum(b) / sum(a)
        self.moves = weight * (np.eye(horizon) - np.eye(horizon, k=-1))
        self.matrix = np.vstack([toeplitz(answer, np.zeros(horizon)), self.moves])
        self.inverse = np.linalg.pinv(self.matrix)

    def _remembered(self, n: int, disturbance: float) -> list[float]:
        """State of the model after the inputs and outputs so far."""
        a, b = np.zeros(n), np.zeros(n)
        a[: len(self.a) - 1], b[: len(self.b) - 1] = self.a[1:], self.b[1:]
        past = np.array(self.inputs[:n]) + disturbance
        return [float(b[i:] @ past[: n - i] - a[i:] @ self.outputs[: n - i]) for i in range(n)]

    def decide(self, k: int, output: float) -> float:
        """Correct the observer, and take the first of the best moves."""
        if (load := self.task.truth(k)) != self.load:
            self.retune(load)
        self.x = self.x + self.correction * (output - self.x[0])
        self.outputs = [float(self.x[0]), *self.outputs[:11]]
        wanted, needed = self._ahead(k)
        aim = np.concatenate([wanted - self.free @ self.x, self.moves @ needed[1:]])
        aim[self.horizon] += self.moves[0, 0] * (self.inputs[0] - needed[0])
        inputs = self.inverse @ aim
        low, high = self.task.low, self.task.high
        if inputs.min() < low or inputs.max() > high:
            inputs = lsq_linear(self.matrix, aim, (low, high), method="bvls").x
        self.inputs = [self.task.limited(float(inputs[0])), *self.inputs[:11]]
        self.x = self.f @ self.x + self.g * self.inputs[0]
        return self.inputs[0]

    def _ahead(self, k: int) -> tuple[Array, Array]:
        """The course of the output, and the u that it needs, from one period before now on."""
        places = np.arange(k, k + self.horizon + 1)
        future = self.led[np.minimum(places, len(self.led) - 1)]
        if not self.preview:
            future[1:] = self.task.references[k]
        start = lfiltic([sum(self.desired)], self.desired, self.course)
        course, _ = lfilter([sum(self.desired)], self.desired, future, zi=start)
        whole = np.array([*reversed(self.course), *course])
        self.course = [float(course[0]), *self.course[:11]]
        first, end = len(self.course), len(whole)
        wanted = np.convolve(whole, self.b / sum(self.b))[first + 1 : end]
        needed = np.convolve(whole, self.a / sum(self.b))[first - 1 : end - 1]
        return wanted, needed - float(self.x[-1])


RIVALS: dict[str, Callable[[Task], Rival]] = {
    "SIMC PI": simc_pi,
    "relay PID": relay_pid,
    "RLS": LeastSquares,
    "MPC": lambda task: Predictive(task, preview=False),
    "MPC, preview": lambda task: Predictive(task, preview=True),
}
