"""A healthy report of v_bst is never frozen, however long the daemon and its frames stood still."""

from __future__ import annotations

from hypothesis import example, given
from hypothesis import strategies as st

from adaptdrive.config.root import DriveLimits, DriveSection
from adaptdrive.control.signals import Command
from adaptdrive.safety.facts import Reading
from adaptdrive.safety.guard import CapacitorBalance

HALF_CYCLE_s = 1.0 / 120.0
LINE_V = 120.0
CAPACITANCE_F = 1.0e-3
LIMIT_V = 430.0


class Capacitor:
    """The closed form of a capacitor between a line and a load that is a conductance."""

    def __init__(self, voltage_V: float, load_W: float) -> None:
        self.voltage_V, self._conductance_S, self._now_s = voltage_V, load_W / voltage_V**2, 0.0

    def step(self, current_scale_S: float) -> Reading:
        """Pass one half cycle."""
        load_W = self._conductance_S * self.voltage_V**2
        gained_J = HALF_CYCLE_s * (current_scale_S * LINE_V**2 - load_W)
        self.voltage_V = max(self.voltage_V**2 + 2.0 * gained_J / CAPACITANCE_F, 1.0) ** 0.5
        self._now_s += HALF_CYCLE_s
        return Reading(
            arrival_s=self._now_s,
            oldest_s=self._now_s,
            boost_voltage_V=self.voltage_V,
            line_voltage_V=LINE_V,
            load_power_W=load_W,
            output=1.0,
            counter=0,
            fault=0,
            bridge=True,
        )


@given(
    voltage_V=st.floats(200.0, 425.0),
    load_W=st.floats(20.0, 1500.0),
    share=st.floats(0.0, 1.0),
    half_cycles=st.integers(1, 20),
)
@example(voltage_V=420.0, load_W=1500.0, share=0.3, half_cycles=14)
@example(voltage_V=420.0, load_W=1500.0, share=0.0, half_cycles=8)
def test_a_halt_is_no_frozen_report(
    voltage_V: float, load_W: float, share: float, half_cycles: int
) -> None:
    limits = DriveLimits(current_scale_slew_S=0.15, boost_reference_min_V=200.0)
    drive = DriveSection(
        name="halted", kind="unidirectional", boost_capacitance_F=CAPACITANCE_F, limits=limits
    )
    balance, capacitor = CapacitorBalance(drive, LIMIT_V), Capacitor(voltage_V, load_W)
    current_scale_S = share * load_W / LINE_V**2
    ticks = 1
    for tick in range(100):
        for _ in range(ticks):
            reading = capacitor.step(current_scale_S)
        assert balance.find_cause(reading, ticks, HALF_CYCLE_s, running=True) is None
        if tick > 1:
            wanted = Command(0.15, 400.0, bridge=True)
            current_scale_S = balance.bound(wanted).current_scale_S
        balance.sent(current_scale_S)
        ticks = half_cycles if tick == 1 else 1
