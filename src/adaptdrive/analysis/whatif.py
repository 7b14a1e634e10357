"""A recorded session again in closed loop, with other settings: run, table, values and figure."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from adaptdrive.analysis import closed_loop, curves, excerpts, figures
from adaptdrive.analysis.curves import Array, Response, response_of
from adaptdrive.analysis.record import identify_session
from adaptdrive.analysis.replay import acts, reconfigured
from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings
from adaptdrive.config import Configuration
from adaptdrive.config.load import AnyLoad
from adaptdrive.control.signals import Mode
from adaptdrive.recording.reader import Session, read_session
from adaptdrive.util.errors import ConfigurationError, IdentificationError
from adaptdrive.util.quantity import Display

# A recorded session again in closed loop, with other settings.


@dataclass(frozen=True, slots=True)
class Comparison:
    """A recorded session and the same with other settings.

    Attributes:
        session: The session.
        recorded: What was recorded.
        repeated: Simulated with the recorded settings: as good as the model is.
        changed: Simulated with the other settings.
        idle: Settings without an effect on the loop.
    """

    session: Session
    recorded: Response
    repeated: Response
    changed: Response
    idle: tuple[str, ...]

    @property
    def responses(self) -> dict[str, Response]:
        """The three responses by their names in table, values and figure."""
        return {"recorded": self.recorded, "simulated": self.repeated, "changed": self.changed}


def what_if(
    path: Path, settings: Sequence[str], begin_s: float | None = None, end_s: float | None = None
) -> Comparison:
    """Run a session again in closed loop against the load that it shows.

    The set-points, the mode and the disturbances are those of the record: whatever its output has
    in addition to the response of the identified load to the recorded voltage.

    Args:
        path: Directory of the session.
        settings: `KEY=VALUE` pairs that replace keys of the recorded configuration.
        begin_s: First second used, from the first tick on; None for the first.
        end_s: Last second used, None for the last.

    Raises:
        AdaptdriveError: The session does not show its load, no controller was in force in it, or a
            setting is not valid.
    """
    session, source = read_session(path), path / "config.toml"
    own, changed = (reconfigured(session.config_text, source, one) for one in ((), settings))
    if changed.load.type != own.load.type:
        raise ConfigurationError.of(source, "load.type", f"the session shows a {own.load.type}")
    found, stretches = identify_session(session, begin_s, end_s)
    part = max(stretches, key=_controlled)
    if not _controlled(part)[0]:
        raise IdentificationError(f"{path}: V_c was set by hand: no controller was in force then")
    # From its enabling on: what the controller has learnt at the first second used is unknown.
    runs, _ = excerpts.read_stretches(session, None, end_s)
    run = [one for one in runs if one.begin_s <= part.begin_s][-1]
    prior, section = _trusted(session, own, tuple(found.nominal), run), own.load

    def simulated(configuration: Configuration) -> Response:
        plant = excerpts.disturbed_plant(found.load, build_load(own), run)
        pole, volts = configuration.load.pole, float(run.columns["boost_voltage_V"][0])
        orders = run.orders(pole if pole != section.pole else None)
        made = closed_loop.simulate(configuration, plant, orders, volts, prior)
        return _response(section, run, made.columns, part.begin_s, made.fault)

    text = session.config_text
    return Comparison(
        session=session,
        recorded=_response(section, run, run.columns, part.begin_s),
        repeated=simulated(own),
        changed=simulated(changed),
        idle=tuple(one for one in settings if not acts(text, source, one, _acting)),
    )


def _controlled(stretch: excerpts.Stretch) -> tuple[int, int]:
    """Return how many samples a controller determined, and how many there are."""
    by_hand = np.count_nonzero(stretch.modes == tuple(Mode).index(Mode.MANUAL))
    return len(stretch.modes) - int(by_hand), len(stretch.modes)


def _acting(configuration: Configuration) -> tuple[object, ...]:
    """Return what of a configuration acts on the loop."""
    drives = configuration.drive.line_voltage_V, configuration.bus.ticks_per_reading
    settings = controller_settings(configuration)
    return settings, build_load(configuration), configuration.load.pole, *drives


def _trusted(
    session: Session, own: Configuration, names: tuple[str, ...], stretch: excerpts.Stretch
) -> tuple[float, ...] | None:
    """Return the parameters that the daemon had trusted by the start of a run of the drive."""
    if stretch.begin_s > own.load.period_s:
        shown = curves.read_curves(session, curves.find_window(session, None, stretch.begin_s))
        accepted = np.flatnonzero(shown.slow.get("accepted", ()))
        if len(accepted):
            return tuple(float(shown.estimates[name][0][accepted[-1]]) for name in names)
    return session.info.prior


def _response(
    section: AnyLoad,
    stretch: excerpts.Stretch,
    ticks: dict[str, Array],
    begin_s: float,
    fault: str = "",
) -> Response:
    """Return the response from `begin_s` on; all of it where a fault ended the run before."""
    samples = stretch.samples_per_period
    ends = np.arange(1.0, len(ticks["output"]) // samples + 1.0)
    ends_s = stretch.begin_s + samples * stretch.period_s * ends
    first = int(np.argmax(ends_s > begin_s))
    return response_of(ticks, samples, ends_s[first:], section, fault)


# A session and the same with other settings, as a table, as values, and as a figure.

_ROWS = (
    ("overshoot, median", "overshoot", 100.0, "%"),
    ("settling to 5 %, median", "settling_s", 1.0, "s"),
    ("steps not settled", "unsettled", 1.0, ""),
    ("rms error", "error", 1.0, "y"),
    ("rms change of {}", "effort_V", 1.0, "v"),
    ("highest {}", "highest_V", 1.0, "v"),
)


def as_text(comparison: Comparison) -> str:
    """Return the comparison as a table."""
    info = comparison.session.info
    units = {"y": info.output_unit, "v": info.manipulated.unit}
    responses = comparison.responses
    rows = [f"{'':<28}" + "".join(f"{name:>12}" for name in responses)]
    for name, key, factor, quantity in _ROWS:
        values = (factor * getattr(one.quality, key) for one in responses.values())
        texts = ("-" if math.isnan(value) else f"{value:.4g}" for value in values)
        named = name.format(info.manipulated.name)
        label = f"{named} {units.get(quantity, quantity)}".rstrip()
        rows.append(f"{label:<28}" + "".join(f"{text:>12}" for text in texts))
    time_s = comparison.recorded.time_s
    rows.append(
        f"{comparison.recorded.quality.steps} steps of the set-point, between "
        f"{time_s[0]:.0f} s and {time_s[-1]:.0f} s of the session, its longest part without a gap"
    )
    if comparison.changed.fault:
        rows.append(f"the changed loop trips: {comparison.changed.fault}")
    return "\n".join(rows)


def as_json(comparison: Comparison) -> dict[str, Any]:
    """Return the comparison for JSON."""
    responses = comparison.responses.items()
    return {name: asdict(one.quality) | {"fault": one.fault} for name, one in responses}


def draw_comparison(comparison: Comparison, settings: tuple[str, ...]) -> bytes:
    """Draw output and boost voltage of a session, as recorded and with other settings.

    Args:
        comparison: What to draw.
        settings: The settings, for the title.

    Returns:
        A PNG.
    """
    with figures.journal():
        figure = Figure(figsize=(figures.WIDTH_in, 4.6), layout="constrained")
        output, volts = figure.subplots(2, 1, sharex=True, height_ratios=(1.4, 1.0))
        info = comparison.session.info
        display = info.shown
        _draw(output, comparison, "output", display)
        output.plot(
            comparison.recorded.time_s,
            display.scale * comparison.recorded.reference + display.offset,
            drawstyle="steps-post",
            label="set-point",
            **figures.TRUTH,
        )
        _draw(volts, comparison, "boost_voltage_V")
        given = info.manipulated
        output.set_ylabel(figures.labelled("output", display.unit))
        output.set_title(", ".join(settings) or "recorded settings")
        volts.set_title(f"{given.name}, means over slow periods")
        volts.set_ylabel(given.axis)
        volts.set_xlabel("time since the first tick (s)")
        figures.legend_above(output, columns=4)
        figure.align_ylabels([output, volts])
        return figures.as_png(figure)


_PLAIN = Display()


def _draw(axes: Axes, comparison: Comparison, name: str, display: Display = _PLAIN) -> None:
    looks = (figures.REFERENCE, figures.FIXED, figures.ADAPTIVE)
    for (label, one), look in zip(comparison.responses.items(), looks, strict=True):
        values = display.scale * getattr(one, name) + display.offset
        axes.plot(one.time_s, values, label=label, **look)
