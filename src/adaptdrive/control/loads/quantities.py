"""Quantities of a load that follow from its estimated parameters, and from nothing else."""

from collections.abc import Collection, Mapping

OFFSET = "input_offset"

Powers = dict[str, int]
"""Powers of estimates whose product is a quantity."""

_RESISTANCE = "resistance_K_per_W"

_DERIVED: dict[str, list[tuple[str, Powers]]] = {
    "motor": [("inertia", {"tau_product_s2": 1, "gain": -1}), ("damping", {"gain": -1})],
    "bath": [
        ("heat_capacity", {"tau_s": 1, _RESISTANCE: -1}),
        ("heat_capacity", {"tau_product_s2": 1, _RESISTANCE: -1}),
        ("conductance", {_RESISTANCE: -1}),
    ],
    "battery": [("series_resistance", {"direct_S": -1}), ("resistance", {"gain_S": -1})],
}
"""Quantities that grow in proportion to a product of estimates.

A motor's inertia is τ_m times its damping R f + K², and its gain falls with that. Where its filter
keeps its τ_f, the product of both time constants does for τ_m, as with a bath whose sensor lags."""

LOSSES = {"motor": "friction", "bath": "heat_loss", "battery": "emf"}
"""What acts against the input, as so much of it: the offset with the opposite sign."""


def powers_of(load: str, names: Collection[str]) -> dict[str, Powers]:
    """Return the products that follow from estimates, by name of the quantity.

    Args:
        load: Kind of load.
        names: Names of the estimates.
    """
    return {name: powers for name, powers in _DERIVED.get(load, ()) if set(powers) <= set(names)}


def derived(load: str, estimates: Mapping[str, float]) -> dict[str, float]:
    """Return the quantities that follow from estimates.

    Args:
        load: Kind of load.
        estimates: Their values by name; one that is 0 has no inverse.
    """
    usable = [name for name, value in estimates.items() if value]
    found = {}
    for name, powers in powers_of(load, usable).items():
        found[name] = 1.0
        for one, power in powers.items():
            found[name] *= estimates[one] ** power
    if load in LOSSES and OFFSET in estimates:
        found[LOSSES[load]] = -estimates[OFFSET]
    return found
