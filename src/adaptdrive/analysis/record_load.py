"""The load that a record shows, a CSV file, a table, a simulation or a session; and its report."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from adaptdrive.analysis import closed_loop, style
from adaptdrive.analysis.columns import Columns, columns_of_file, columns_of_table
from adaptdrive.analysis.curves import find_window, read_curves
from adaptdrive.analysis.excerpts import Stretch, block_samples, divided, read_stretches
from adaptdrive.analysis.figure import as_png
from adaptdrive.analysis.record import RecordView, read_record
from adaptdrive.app.loads import build_load, candidate_loads
from adaptdrive.config import Configuration, load_configuration
from adaptdrive.control.loads import motor
from adaptdrive.control.loads.bath import bath_load
from adaptdrive.control.loads.load import Load
from adaptdrive.control.signals import Estimate
from adaptdrive.identification import excerpt, identify
from adaptdrive.identification.result import IdentifiedLoad
from adaptdrive.recording.reader import Session, read_session
from adaptdrive.recording.replay import reconfigured
from adaptdrive.util.errors import IdentificationError

# The load that any record shows; that of a recorded session with the on-line estimates, too.

_MOST_BLOCKS = 4000

Part = tuple[float, excerpt.Excerpt]
"""Time in s at which an uninterrupted part of a record begins, and its samples."""


@dataclass(frozen=True, slots=True)
class RecordLoad:
    """The load of a record.

    Attributes:
        name: Of the record.
        unit: Of the output; empty where it is not known.
        ends_s: Time at the end of the last block of each part of the record.
        load: The identified load.
        online: Last estimates of the daemon; empty where there are none.
        nominal: Parameters of the configured model; empty where there is none.
        model: Keys of `[load.model]`; gain and time constants without a configuration.
        left_out: Parts of the record that have too few samples.
    """

    name: str
    unit: str
    ends_s: tuple[float, ...]
    load: IdentifiedLoad
    online: dict[str, Estimate]
    nominal: dict[str, float]
    model: dict[str, Estimate]
    left_out: int


def _used(parts: list[Part], load: IdentifiedLoad, block: int) -> tuple[tuple[float, ...], int]:
    """Return the time at the end of each part that a fit used, and how many it left out."""
    used = [parts[place] for place in load.used]
    ends_s = (begin_s + len(one.output) // block * block * one.period_s for begin_s, one in used)
    return tuple(ends_s), len(parts) - len(used)


def _of_drive(name: str, parts: list[Part], block: int, configuration: Configuration) -> RecordLoad:
    """Return the load between the boost voltage and the output of a drive."""
    structure, excerpts = build_load(configuration), [one for _, one in parts]
    load = identify.identify_any(excerpts, candidate_loads(configuration), block=block)
    ends_s, left_out = _used(parts, load, block)
    nominal = structure.physical(list(structure.numerator), list(structure.denominator))
    return RecordLoad(
        name=name,
        unit=configuration.load.output_unit,
        ends_s=ends_s,
        load=load,
        online={},
        nominal=dict(zip(structure.names, nominal, strict=True)),
        model=identify.proposed_model(load, configuration.load),
        left_out=left_out,
    )


def plain_load(lags: int) -> Load:
    """Return the structure of a load whose input is measured.

    Raises:
        IdentificationError: It is of no order that can be identified.
    """
    if lags == 1:
        bath = bath_load(1.0, 1.0, 1.0, 0.0, 1.0)
        return replace(bath, input_gain=1.0, input_exponent=1, names=("gain", "tau_s"))
    if lags != 2:
        raise IdentificationError(f"{lags} lags: a load has one or two")
    return motor.motor_load(1.0, 1.0, 1.0)


@dataclass(frozen=True, slots=True)
class SessionLoad(RecordLoad):
    """The load of a recorded session.

    Attributes:
        session: The session.
        configuration: The one that it ran with.
        stretches: Parts of it that were used.
    """

    session: Session
    configuration: Configuration
    stretches: list[Stretch]


def identify_session(
    path: Path, begin_s: float | None = None, end_s: float | None = None
) -> SessionLoad:
    """Identify the load of a recorded session.

    Args:
        path: Directory of the session.
        begin_s: First second used, from the first tick on; None for the first.
        end_s: Last second used, None for the last.

    Raises:
        AdaptdriveError: The session cannot be read, or does not show its load.
    """
    session = read_session(path)
    configuration = reconfigured(session.config_text, path / "config.toml", ())
    stretches = read_stretches(session, begin_s, end_s)
    parts = [(one.begin_s, one.excerpt) for one in stretches]
    found = _of_drive(session.path.name, parts, block_samples(stretches), configuration)
    known = {one.name: getattr(found, one.name) for one in fields(found)}
    known["online"] = _online(session, tuple(found.nominal), end_s)
    known["left_out"] += divided(session, begin_s, end_s).count(None)
    used = [stretches[place] for place in found.load.used]
    return SessionLoad(**known, session=session, configuration=configuration, stretches=used)


def _online(session: Session, names: tuple[str, ...], end_s: float | None) -> dict[str, Estimate]:
    """Return the last on-line estimates before a time."""
    curves = read_curves(session, find_window(session, None, end_s))
    found = {}
    for name in names:
        known = [
            Estimate(float(value), float(std))
            for value, std in zip(*curves.estimates.get(name, ((), ())), strict=True)
            if math.isfinite(value)
        ]
        found[name] = known[-1] if known else Estimate(math.nan, math.nan)
    return found


# The load of whatever contains a record: a CSV file, a table, a simulation or a session.

_MEASURED = RecordView("boost_voltage_V", "output", "time_s", held=False)
"""Columns of a simulation, which are taken at once."""


def identify_source(
    source: Any,  # noqa: ANN401 - a table of any library too
    view: RecordView,
) -> RecordLoad:
    """Identify the load of a record.

    Args:
        source: A session's folder, a CSV file, a simulation, or a table.
        view: Which columns and which part of it.

    Raises:
        AdaptdriveError: The record cannot be read, or does not show its load.
    """
    if isinstance(source, str | Path):
        path = Path(source)
        if path.is_file():
            return _identify(columns_of_file(path), path.name, view)
        _refuse_columns(view, "a session")
        return identify_session(path, view.begin_s, view.end_s)
    if isinstance(source, closed_loop.Simulation):
        _refuse_columns(view, "a simulation")
        measured = replace(_MEASURED, begin_s=view.begin_s, end_s=view.end_s)
        measured = replace(measured, config=source.configuration)
        return _identify(columns_of_table(source.ticks), "simulation", measured)
    return _identify(columns_of_table(source), "table", view)


def _identify(columns: Columns, name: str, view: RecordView) -> RecordLoad:
    config = view.config
    if isinstance(config, str | Path):
        config = load_configuration(Path(config))
    parts = read_record(columns, replace(view, config=config))
    block = math.ceil(sum(len(one.output) for _, one in parts) / _MOST_BLOCKS)
    if config is None:
        return _of_any(name, parts, block, view.lags)
    if view.lags is not None:
        raise IdentificationError("lags and a configuration were given: it says how many there are")
    return _of_drive(name, parts, block, config)


def _of_any(name: str, parts: list[Part], block: int, lags: int | None) -> RecordLoad:
    """Return the load between any input and output, with the lags that the record shows."""
    structures = [plain_load(count) for count in ((1, 2) if lags is None else (lags,))]
    load = identify.identify_any([one for _, one in parts], structures, block=block)
    ends_s, left_out = _used(parts, load, block)
    return RecordLoad(name, "", ends_s, load, {}, {}, identify.time_constants(load), left_out)


def _refuse_columns(view: RecordView, kind: str) -> None:
    """Refuse what a record without a choice of columns does not take."""
    if view != RecordView(begin_s=view.begin_s, end_s=view.end_s):
        raise IdentificationError(
            f"{kind} has its columns, its times and its configuration: leave out all but the times "
            "at which the used part begins and ends"
        )


# The load of a record as a table, as values for JSON, and as a figure.

Array = NDArray[np.float64]

_LAGS = 40
_WHITE_BAND = 1.96
_NOT_WHITE = 0.01
"""Probability of white residuals below which they count as coloured."""

_UNKNOWN = Estimate(math.nan, math.nan)


def as_text(found: RecordLoad) -> str:
    """Return the result as a table, the checks, and the proposed values."""
    load = found.load
    rows = [f"{'parameter':<20}{'record':>24}{'simulation':>24}{'on-line':>24}{'[load.model]':>14}"]
    for name, value in load.parameters.items():
        pairs = (value, load.simulated_parameters[name], found.online.get(name, _UNKNOWN))
        nominal = f"{found.nominal[name]:.5g}" if name in found.nominal else "-"
        rows.append(f"{name:<20}{''.join(f'{_pm(one):>24}' for one in pairs)}{nominal:>14}")
    rows += ["", *checks(load, found.unit, found.left_out), *warnings(load), ""]
    rows += ["[load.model]  # proposed"] if found.nominal else []
    rows += [f"{name} = {one.value:.5g}  # ± {one.std:.2g}" for name, one in found.model.items()]
    return "\n".join(rows)


def checks(load: IdentifiedLoad, unit: str, left_out: int = 0) -> Iterator[str]:
    """Yield what judges a fit.

    Args:
        load: The fit.
        unit: Of the output.
        left_out: Parts of the record that have too few samples.
    """
    means = f"means of {load.block_s:.4g} s"
    means += f", {left_out} parts of too few samples left out" if left_out else ""
    used_s = sum(len(part) for part in load.residuals) * load.block_s
    white = "white"
    if load.whiteness < _NOT_WHITE:
        white = "not white: the deviations are wider for it, and may still be too small"
    noise = f"{load.noise_std:.3g} {unit}".rstrip()
    rows = {
        "data": f"{used_s:.6g} s in {len(load.residuals)} parts, {means}",
        "fit": _percent(load.fit),
        "cross-check": f"{_percent(load.cross_fit)} of the last 30 % from the first 70 %",
        "residuals": f"{noise}, {white} (p = {load.whiteness:.2g})",
        "noise model": f"order {len(load.noise) - 1}",
        "dead time": f"{load.delay_s:.3g} ± {load.delay_std_s:.2g} s",
        "input offset": _pm(load.input_offset),
    }
    for name, text in rows.items():
        yield f"{name:<16}{text}"


def warnings(load: IdentifiedLoad) -> Iterator[str]:
    """Yield a line for each parameter of which both fits differ by more than chance."""
    for name in load.disputed:
        one, other = load.parameters[name], load.simulated_parameters[name]
        yield (
            f"{'warning':<16}{name} is {_pm(one)} by prediction errors and {_pm(other)} by "
            "simulation: the record has slower movements than the load, or a controller moved the "
            "input by its noise; what the model is for decides"
        )


def as_json(found: RecordLoad) -> dict[str, Any]:
    """Return the result as values for JSON; unknown numbers are null."""
    load = found.load
    return {
        "record": found.name,
        "parameters": _values(load.parameters),
        "simulated": _values(load.simulated_parameters),
        "disputed": list(load.disputed),
        "online": _values(found.online),
        "nominal": found.nominal,
        "model": _values(found.model),
        "input_offset": _values({"offset": load.input_offset})["offset"],
        "delay_s": load.delay_s,
        "delay_std_s": load.delay_std_s,
        "noise": list(load.noise),
        "noise_std": load.noise_std,
        "whiteness": load.whiteness,
        "fit": _known(load.fit),
        "cross_fit": _known(load.cross_fit),
        "block_s": load.block_s,
        "parts": len(load.residuals),
        "left_out": found.left_out,
    }


def _values(estimates: Mapping[str, Estimate]) -> dict[str, dict[str, float | None]]:
    return {
        name: {"value": _known(one.value), "std": _known(one.std)}
        for name, one in estimates.items()
    }


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _pm(estimate: Estimate) -> str:
    if math.isnan(estimate.value):
        return "-"
    return f"{estimate.value:.5g} ± {estimate.std:.2g}"


def _percent(share: float) -> str:
    return "-" if math.isnan(share) else f"{100.0 * share:.1f} %"


def draw_load(found: RecordLoad) -> bytes:
    """Draw the identified load of a record.

    Args:
        found: The load.

    Returns:
        A PNG.
    """
    with style.journal():
        figure = Figure(figsize=(style.WIDTH_in, 5.6), layout="constrained")
        output, residual, correlation = figure.subplots(3, 1, height_ratios=(1.6, 1.0, 1.0))
        residual.sharex(output)
        unit = found.unit
        _draw_output(output, found, f"output ({unit})" if unit else "output")
        _draw_residuals(residual, found, f"residual ({unit})" if unit else "residual")
        _draw_correlation(correlation, found.load)
        figure.align_ylabels([output, residual, correlation])
        return as_png(figure)


def _times_s(found: RecordLoad) -> list[Array]:
    """Return the middle of each block."""
    block_s = found.load.block_s
    return [
        end_s - block_s * (np.arange(len(part), dtype=np.float64)[::-1] + 0.5)
        for end_s, part in zip(found.ends_s, found.load.residuals, strict=True)
    ]


def _draw_output(axes: Axes, found: RecordLoad, label: str) -> None:
    parts = zip(_times_s(found), found.load.simulated, found.load.residuals, strict=True)
    for number, (time_s, simulated, residual) in enumerate(parts):
        names = ("measured", "simulated") if number == 0 else ("", "")
        axes.plot(time_s, simulated + residual, label=names[0], **style.REFERENCE)
        axes.plot(time_s, simulated, label=names[1], **style.ADAPTIVE)
    fit = f", fit {100.0 * found.load.fit:.1f} %" if math.isfinite(found.load.fit) else ""
    axes.set_title(f"{found.name}: measured and simulated output{fit}")
    axes.set_ylabel(label)
    style.legend_above(axes, columns=2)


def _draw_residuals(axes: Axes, found: RecordLoad, label: str) -> None:
    for time_s, residual in zip(_times_s(found), found.load.residuals, strict=True):
        axes.plot(time_s, residual, **(style.FIXED | {"linewidth": 0.5}))
    axes.axhline(0.0, **style.TRUTH)
    axes.set_title("Measured less simulated")
    axes.set_xlabel("time since the start of the record (s)")
    axes.set_ylabel(label)


def _draw_correlation(axes: Axes, load: IdentifiedLoad) -> None:
    errors = max(load.errors, key=len)
    lags = np.arange(1, min(_LAGS, len(errors) // 4) + 1)
    power = float(errors @ errors) or 1.0
    axes.bar(lags, [float(errors[lag:] @ errors[:-lag]) / power for lag in lags], color="0.4")
    band = _WHITE_BAND / math.sqrt(len(errors))
    axes.axhspan(-band, band, color=style.ADAPTIVE["color"], alpha=0.15, linewidth=0)
    axes.set_title(f"Autocorrelation of the prediction errors, p = {load.whiteness:.2g}")
    axes.set_xlabel(f"lag (blocks of {load.block_s:.4g} s)")
    axes.set_ylabel("correlation")
