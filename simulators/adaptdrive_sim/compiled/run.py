"""An experiment on compiled code, from the same objects as the interpreted one."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptdrive.control.controller import Controller
from adaptdrive.control.load import Load, to_input
from adaptdrive.control.preview import AHEAD
from adaptdrive.control.settings import ControllerSettings
from adaptdrive.control.signals import Measurement, Mode
from adaptdrive.control.slow_state import SlowSample
from adaptdrive_sim.compiled import bench
from adaptdrive_sim.compiled.objects import Memory
from adaptdrive_sim.compiled.sources import compiled_modules
from adaptdrive_sim.compiled.wire import Wire, perfect_wire
from adaptdrive_sim.course import Course
from adaptdrive_sim.site import Site

Array = NDArray[np.float64]


def run_compiled(site: Site, course: Course, trace: Array) -> int:
    """Run a controller that was started on a plant at rest.

    Args:
        site: The controller and the plant.
        course: What happens.
        trace: What happened, a row of `bench` columns for each slow period, overwritten.

    Returns:
        The interlock that ended it, or 0.
    """
    settings, load, *states = _parts(site.controller)
    measurement = Measurement(0, 0.0, 0.0, 0.0, 0.0, 0.0)
    sample = _sample(settings, load, course)
    changing = (*states, site.world, _wire(site, course), measurement, sample)
    objects = [_constant(settings), _constant(load), *map(Memory, changing)]
    function: Any = compiled_modules()[bench.__name__].run
    trips = course.interlocks
    cause = function(
        *objects,
        course.references,
        course.disturbances,
        course.sizes,
        course.over_s,
        course.burdens,
        trips.boost_voltage_max_V,
        trips.output_max,
        trace,
    )
    return int(cause)


def run_held(site: Site, course: Course, decide: Callable[[int, float, float], float]) -> Array:
    """Run the fast half of a controller, from rest; V_c is given.

    Args:
        site: The controller, whose slow half does not run, and the plant.
        course: What happens.
        decide: V_c in V from k, the mean of the output in its window and the mean applied V_c.

    Returns:
        The first columns of `bench` for each slow period, up to the applied V_c.
    """
    site.rest(course)
    settings, load, state, bank, _ = _parts(site.controller)
    measurement = Measurement(0, 0.0, 0.0, 0.0, 0.0, 0.0)
    changing = map(Memory, (state, bank, site.world, _wire(site, course), measurement))
    objects = [_constant(settings), _constant(load), *changing]
    given = course.disturbances, course.sizes, course.over_s, course.burdens
    hold: Any = compiled_modules()[bench.__name__].hold
    found, trace = np.zeros(3), np.full((len(course.references), bench.ADAPTIVE), np.nan)
    hold(*objects, *given, -1, 0.0, found)
    for k in range(len(trace)):
        output, measured, applied_V = found.tolist()
        decided_V = decide(k, measured, applied_V)
        trace[k] = output, measured, decided_V, applied_V
        hold(*objects, *given, k, decided_V, found)
    return trace


def _wire(site: Site, course: Course) -> Wire:
    return site.wire or perfect_wire(float(course.references[0]))


@cache
def _constant(instance: Any) -> Memory:
    """Return the data that no run changes, copied once."""
    return Memory(instance)


def _parts(controller: Controller) -> tuple[Any, ...]:
    """Return the parts of the deployed controller, once it has been started."""
    own = controller
    return own._settings, own._load, own._fast, own._bank, own._slow  # noqa: SLF001


def _sample(settings: ControllerSettings, load: Load, course: Course) -> SlowSample:
    stage, gain, exponent = settings.stage, load.input_gain, load.input_exponent
    return SlowSample(
        period_s=0.0,
        output=0.0,
        output_filtered=[0.0] * load.order,
        input_filtered=[0.0] * (load.order + 1),
        applied=0.0,
        followed=True,
        held_share=0.0,
        reference=0.0,
        adaptive=course.mode is Mode.ADAPTIVE,
        pole=course.pole,
        low=to_input(stage.boost_reference_min_V, gain, exponent),
        high=to_input(stage.boost_reference_max_V, gain, exponent),
        steady=course.steady,
        upcoming=[0.0] * (AHEAD - 1 if course.preview else 0),
    )
