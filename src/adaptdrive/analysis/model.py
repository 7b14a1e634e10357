"""The model of a load and of its loop, in the forms of the field, with margins and their spread.

All of the loop is discrete, at the slow period T, in q^-1 (`design/pole_placement.py`): the load
A y = B u as the design models it, for `exact` with every delay, and the controller
R u = t0 r - S y. Cut open at the input u the loop is

    L = B S / (A R)         (Astrom and Wittenmark, Computer-Controlled Systems, chapter 5)

Margins are taken on the unit circle: the factor of the gain to the nearest crossing of the negative
real axis (at half the sampling rate L is real, and may lie on it), the least distance in phase of a
point of size 1 from -1, and the least such distance over its frequency, a dead time that comes on
top of those that are in B.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.signal import TransferFunction, freqz

from adaptdrive.analysis.curves import Array, find_window, rows_within
from adaptdrive.analysis.record import identify_session
from adaptdrive.analysis.replay import reconfigured
from adaptdrive.app.loads import build_load, candidate_loads
from adaptdrive.app.settings import controller_settings
from adaptdrive.config import Configuration
from adaptdrive.control.design.pole_placement import Plant, discrete_model, is_stable
from adaptdrive.control.loads.load import Load
from adaptdrive.control.settings import ControllerSettings
from adaptdrive.control.signals import Estimate
from adaptdrive.recording.reader import read_session
from adaptdrive.recording.session import TableName
from adaptdrive.util.errors import IdentificationError, RecordingError

# Margins of an open loop.

_FREQUENCIES = 4000


@dataclass(frozen=True, slots=True)
class LoopMargins:
    """Distances of a loop from instability; infinite, with NaN for its place, where none ends it.

    Attributes:
        gain: Factor of the gain at which the loop becomes unstable.
        gain_rad_per_s: Frequency of that crossing.
        phase_deg: Lag of phase at which it becomes unstable.
        phase_rad_per_s: Frequency of that crossing.
        delay_s: Additional dead time at which it becomes unstable.
    """

    gain: float
    gain_rad_per_s: float
    phase_deg: float
    phase_rad_per_s: float
    delay_s: float


def loop_margins(numerator: Array, denominator: Array, period_s: float) -> LoopMargins:
    """Return the margins of a discrete open loop.

    Args:
        numerator: In q^-1.
        denominator: In q^-1.
        period_s: Sampling period, in s.
    """
    omega = np.linspace(math.pi / _FREQUENCIES, math.pi, _FREQUENCIES)

    def loop(angle: Array | float) -> Any:  # noqa: ANN401 - complex, as many as there are angles
        return freqz(numerator, denominator, np.atleast_1d(angle))[1]

    real_axis = [*_zeros(lambda angle: loop(angle).imag, omega[:-1]), math.pi]
    crossings = {angle: complex(loop(angle)[0]) for angle in real_axis}
    sizes = {abs(at): angle for angle, at in crossings.items() if at.real < 0.0}
    inside = max((size for size in sizes if size < 1.0), default=0.0)
    circle = _zeros(lambda angle: np.abs(loop(angle)) - 1.0, omega)
    lags = {float((np.angle(loop(one)[0]) + math.pi) % (2.0 * math.pi)): one for one in circle}
    lag = min(lags, default=math.inf)
    return LoopMargins(
        gain=1.0 / inside if inside else math.inf,
        gain_rad_per_s=sizes.get(inside, math.nan) / period_s,
        phase_deg=math.degrees(lag),
        phase_rad_per_s=lags.get(lag, math.nan) / period_s,
        delay_s=min((one / angle for one, angle in lags.items()), default=math.inf) * period_s,
    )


def _zeros(function: Callable[[Any], Array], omega: Array) -> list[float]:
    """Return where a function of the frequency changes its sign."""
    places = np.flatnonzero(np.diff(np.sign(function(omega))) != 0)
    return [brentq(lambda one: function(one)[0], omega[i], omega[i + 1]) for i in places]


# The model, and the loads that are as possible.

_DRAWN = 200
"""Loads that are drawn: the ends of 95 % are then known to a tenth of their distance."""

_LEAST_SHARE = 0.05
"""Least share of a parameter that is drawn: physical parameters are positive."""

Part = Literal["load", "sampled", "controller", "loop"]


@dataclass(frozen=True, slots=True)
class Model:
    """A load, and the loop that a controller closes around it, in SI.

    Attributes:
        name: What it is the model of.
        parameters: Physical parameters of the load.
        covariance: Of these, in their order; zeros where it is not known.
        load: H(s), its dead time and its input map, u = `input_gain` · v^`input_exponent`.
        settings: Of the controller: design and delays.
        period_s: T.
        a: A.
        b: B.
        r: R.
        s: S.
    """

    name: str
    parameters: dict[str, Estimate]
    covariance: Array
    load: Load
    settings: ControllerSettings
    period_s: float
    a: Array
    b: Array
    r: Array
    s: Array

    @property
    def open_loop(self) -> tuple[Array, Array]:
        """B S and A R, in q^-1."""
        return np.convolve(self.b, self.s), np.convolve(self.a, self.r)

    def polynomials(self, part: Part) -> tuple[Array, Array]:
        """Return numerator and denominator, the highest power of s, or of z, first.

        Args:
            part: `load` for H(s) from u to the output, without its dead time; discrete with T:
                `sampled` for B/A, `controller` for S/R, `loop` for L.
        """
        above, below = {
            "load": (np.array(self.load.numerator), np.array(self.load.denominator)),
            "sampled": (self.b, self.a),
            "controller": (self.s, self.r),
            "loop": self.open_loop,
        }[part]
        size = max(len(above), len(below))
        above, below = (np.pad(one, (0, size - len(one))) for one in (above, below))
        return np.trim_zeros(above, "f"), below  # libraries warn of leading zeros

    def scipy(self, part: Part) -> Any:  # noqa: ANN401 - published without types
        """Return a part as `scipy.signal.TransferFunction`; arguments as of `polynomials`."""
        step = {} if part == "load" else {"dt": self.period_s}
        return TransferFunction(*self.polynomials(part), **step)

    def control(self, part: Part) -> Any:  # noqa: ANN401 - an extra
        """Return a part as `control.TransferFunction`; arguments as of `polynomials`.

        Raises:
            ModuleNotFoundError: python-control is not installed: `adaptdrive[control]`.
        """
        from control import tf  # noqa: PLC0415 - an extra

        return tf(*self.polynomials(part), 0 if part == "load" else self.period_s)

    @property
    def margins(self) -> LoopMargins:
        """Margins of the loop: a factor of 1 and no lag where it is not stable."""
        if not self.is_stable:
            return LoopMargins(1.0, math.nan, 0.0, math.nan, 0.0)
        return loop_margins(*self.open_loop, self.period_s)

    @property
    def closed_loop(self) -> Array:
        """A R + B S, in q^-1: its roots are the poles of the closed loop."""
        above, below = self.open_loop
        return above + below

    @property
    def is_stable(self) -> bool:
        """True if the loop is stable when it is closed, with the margin of a possible load."""
        return is_stable(self.closed_loop.tolist())

    def response(self, rad_per_s: Array) -> NDArray[np.complex128]:
        """Return L at some frequencies."""
        found: NDArray[np.complex128] = freqz(*self.open_loop, rad_per_s * self.period_s)[1]
        return found

    def around(self, values: Array) -> Model:
        """Return the loop of the same controller around a load with other parameters."""
        load, a, b = _sampled(self.settings, self.load, values, self.period_s)
        return replace(self, load=load, a=a, b=b)

    def drawn(self) -> Iterator[Model]:
        """Yield models whose loads are drawn from the normal distribution of the parameters.

        The controller stays; each call yields the same ones, and none without a covariance.
        """
        if np.isfinite(self.covariance).all() and self.covariance.any():
            mean = np.array([one.value for one in self.parameters.values()])
            draws = np.random.default_rng(0).multivariate_normal(mean, self.covariance, _DRAWN)
            yield from map(self.around, np.maximum(draws, _LEAST_SHARE * mean))


def _sampled(
    settings: ControllerSettings, load: Load, values: Array, period_s: float
) -> tuple[Load, Array, Array]:
    """Return a load with physical parameters, and the A and B that the design works with."""
    numerator, denominator = load.realise(values.tolist())
    a, b = discrete_model(settings, load, numerator, denominator, period_s)
    load = replace(load, numerator=tuple(numerator), denominator=tuple(denominator))
    return load, np.array(a), np.array(b)


# Models of a configuration, of a session, and of what a running drive has published.


def model_of_configuration(configuration: Configuration) -> Model:
    """Return the configured load, and the loop of the fixed controller."""
    load = build_load(configuration)
    values = load.physical(list(load.numerator), list(load.denominator))
    known = {name: Estimate(one, 0.0) for name, one in zip(load.names, values, strict=True)}
    return _model(configuration, load, known)


def model_of_session(path: Path, begin_s: float | None = None, end_s: float | None = None) -> Model:
    """Return the load that is identified from a session, and the loop of its last recorded gains.

    Of an adaptive controller the law is recorded that answers set-points; the one that corrects
    disturbances may be faster, within the margins of `design/noise.py`.

    Args:
        path: Directory of the session.
        begin_s: First second used, from the first tick on; None for the first.
        end_s: Last second used, None for the last.

    Raises:
        AdaptdriveError: The session cannot be read, or does not show its load.
    """
    session = read_session(path)
    found = identify_session(session, begin_s, end_s)[0].load
    window, gains = find_window(session, begin_s, end_s), None
    for _, batch in rows_within(session, TableName.SLOW, ("gains",), window):
        gains = batch.column("gains")[-1].as_py()
    if not gains:
        raise RecordingError(session.path, "it holds no gains: no slow period has passed")
    configuration = reconfigured(session.config_text, path / "config.toml", ())
    names = tuple(found.parameters)
    load = next(one for one in candidate_loads(configuration) if one.names == names)
    load = replace(load, delay_s=found.delay_s)
    model = _model(configuration, load, found.parameters, gains[:-1])
    return replace(model, name=session.path.name, covariance=found.covariance)


def model_of_estimates(
    configuration: Configuration, estimates: Mapping[str, Estimate], gains: Sequence[float]
) -> Model:
    """Return the load of published estimates, and the loop of published gains.

    Only the deviations are published: the parameters are taken to be independent of each other.

    Args:
        configuration: The drive's.
        estimates: Parameters of the load by name, among others.
        gains: r_1 ... r_n, s_0 ... s_m and t_0.

    Raises:
        IdentificationError: The estimates are not those of the configured load.
    """
    load = build_load(configuration)
    if missing := [name for name in load.names if name not in estimates]:
        raise IdentificationError(f"the drive estimates no {missing[0]}: another configuration?")
    known = {name: estimates[name] for name in load.names}
    return _model(configuration, load, known, gains[:-1])


def _model(
    configuration: Configuration,
    load: Load,
    known: dict[str, Estimate],
    gains: Sequence[float] = (),
) -> Model:
    """Return the loop of some gains; that of the fixed controller without any."""
    settings, section = controller_settings(configuration), configuration.load
    values = np.array([one.value for one in known.values()])
    load, a, b = _sampled(settings, load, values, section.period_s)
    if not gains:
        plant = Plant(a.tolist(), b.tolist())
        gains = plant.gains(plant.asked(section.pole))
    taps = len(gains) - build_load(configuration).order - 1
    deviations = np.array([one.std for one in known.values()])
    loop = np.array([1.0, *gains[:taps]]), np.array(gains[taps:])
    name, covariance = configuration.drive.name, np.diag(deviations**2)
    return Model(name, known, covariance, load, settings, section.period_s, a, b, *loop)


# The text of a model for MATLAB and its Control System Toolbox.

_SYMBOLS: dict[Part, str] = {"load": "H", "sampled": "G", "controller": "C", "loop": "L"}
_LEGEND = """% H: load, from its input u to the output; G: at the slow period, with every delay
% C: feedback S/R, from the error to u; L: open loop G C"""


def as_matlab(model: Model) -> str:
    """Return a script that makes each part of a model as `tf`, and as `ss`: `L` and `L_ss`."""
    load = model.load
    entry = f"u = {load.input_gain:.9g} * v^{load.input_exponent}, v what the drive gives"
    rows = [f"% {model.name}, in SI units; {entry}"]
    for name, one in model.parameters.items():
        rows.append(f"% {name} = {one.value:.9g}, deviation {one.std:.3g}")
    rows.append(_LEGEND)
    for part, symbol in _SYMBOLS.items():
        above, below = (" ".join(map(repr, one.tolist())) for one in model.polynomials(part))
        time = f"'InputDelay', {load.delay_s!r}" if part == "load" else f"{model.period_s!r}"
        rows.append(f"{symbol} = tf([{above}], [{below}], {time});\n{symbol}_ss = ss({symbol});")
    return "\n".join(rows) + "\n"
