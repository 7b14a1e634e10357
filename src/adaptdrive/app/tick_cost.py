"""Whether this machine is fast enough for a daemon, measured by the ticks of its controller."""

import math
import time
from collections.abc import Callable, Iterator
from typing import Final

from adaptdrive import build_name
from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings
from adaptdrive.config import Configuration
from adaptdrive.control.controller import Controller
from adaptdrive.control.signals import Measurement, Mode, Order, Stage
from adaptdrive.safety.timing import timing_of
from adaptdrive.util.errors import Flaw

_LARGEST_SHARE: Final = 1.0 / 3.0
"""Of a half cycle, that a daemon may take."""

_TICKS_IN_ALL: Final = {"compiled": 230.0}.get(build_name(), 100.0)
"""Processor time of a daemon in a half cycle, in ticks of its controller with warm caches: 633 us
over 2.8 us compiled, 740 us over 7.4 us of the sources."""

_ROUNDS, _TICKS = 8, 50
"""Rounds, of which the fastest counts, and ticks of each."""


def shortage(
    configuration: Configuration, clock: Callable[[], float] = time.thread_time
) -> Iterator[Flaw]:
    """Find that a daemon has too little time on this machine; takes some milliseconds.

    Args:
        configuration: The drive and its load.
        clock: Processor time of this thread, in s.
    """
    cycle_s = timing_of(configuration).reading_s
    daemon_s = _TICKS_IN_ALL * _tick_s(configuration, clock)
    if daemon_s > _LARGEST_SHARE * cycle_s:
        text = (
            f"a daemon takes about {daemon_s * 1e3:.2g} ms of each {cycle_s * 1e3:.3g} ms on this "
        )
        yield Flaw("drive", f"{text}machine: ticks will be late or missed (docs/proof/realtime.md)")


def _tick_s(configuration: Configuration, clock: Callable[[], float]) -> float:
    """Return the processor time of a tick of the controller, with its share of the slow steps."""
    drive, load = configuration.drive, configuration.load
    controller = Controller(controller_settings(configuration), build_load(configuration))
    output = 0.5 * (load.reference_min + load.reference_max)
    order = Order(Stage.RUN, output, Mode.ADAPTIVE, load.pole)
    known = drive.half_cycle_s, drive.limits.boost_reference_min_V, drive.line_voltage_V, 0.0
    fastest_s = math.inf
    for first in range(0, _ROUNDS * _TICKS, _TICKS):
        began_s = clock()
        for tick in range(first, first + _TICKS):
            controller.tick(Measurement(tick, *known, output), order)
            if snapshot := controller.take_snapshot():
                controller.apply(controller.decide(snapshot))
        fastest_s = min(fastest_s, clock() - began_s)
    return fastest_s / _TICKS
