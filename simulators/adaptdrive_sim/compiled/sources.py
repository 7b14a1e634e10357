"""Modules to compile, and a lazy way to their functions."""

from __future__ import annotations

import pkgutil
from functools import cache
from types import ModuleType

import adaptdrive.control
from adaptdrive_sim.compiled.objects import copies
from adaptdrive_sim.compiled.translate import translate

_PLANT = (
    "adaptdrive_sim.line",
    "adaptdrive_sim.plants.bath",
    "adaptdrive_sim.plants.battery",
    "adaptdrive_sim.plants.boost",
    "adaptdrive_sim.plants.coupling",
    "adaptdrive_sim.plants.motor",
    "adaptdrive_sim.world",
    "adaptdrive_sim.compiled.wire",
)

_BENCH = "adaptdrive_sim.compiled.bench"

_INLINED = {
    f"adaptdrive.control.{name}"
    for name in (
        "discretise",
        "fast_half",
        "lambda_filter",
        "lambda_transform",
        "rounding",
        "screen",
        "signals",
        "vectors",
        "voltage_loop",
    )
}
"""Modules of the controller that run in each tick, or for each of the models of a slow period."""

_OUTSIDE = {
    f"adaptdrive.control.{name}"
    for name in ("columns", "controller", "reach", "reasons", "schedule")
}
"""Texts, enumerations and the order of calls, around what is compiled."""


@cache
def compiled_modules() -> dict[str, ModuleType]:
    """All of the controller, the plant, and the bench that joins them, by original name."""
    package = adaptdrive.control
    found = pkgutil.walk_packages(package.__path__, f"{package.__name__}.")
    names = [module.name for module in found if module.name not in _OUTSIDE]
    modules = translate([*names, *_PLANT, _BENCH], inlined={*_INLINED, *_PLANT})
    copies.add(modules)
    return modules
