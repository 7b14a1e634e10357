"""The last look at a command before the wire: finite, in range, and safe for the capacitor.

The energy balance of the boost capacitor, for a voltage loop in the daemon.

With x = v_bst² each half line cycle of length T adds the energy that the line gives and takes what
the load takes:

    x[n+1] = x[n] + (2 T / C) (k V_rms² - p)

A command that was computed from frame n acts from frame n+1 to n+2. Three rules follow:

- **No fresh report, no charge.** While v_bst is older than its usual cycle, k feeds no more than
  the load takes, and not so much that a load which takes nothing any more would let the capacitor
  pass its limit.
- **The prediction trips.** Without a fresh report the predicted v_bst stands for the measured one.
- **Energy must show.** The energy that was commanded and is seen neither in the load nor in v_bst
  is summed (a CUSUM test: E. S. Page, Biometrika 41, 1954, doi:10.1093/biomet/41.1-2.100). A drive
  loses a share of it. More than that asks the report, and so does all of it where the report has
  stood still until the capacitor could be at its limit: the capacitor gets less than the load
  takes, and a report that does not move when it has to fall, or within 1 s, is frozen. It trips a
  drive that runs. At the peak of the line v_bst cannot fall, and a drive that starts may not charge
  yet: there a small share of the energy up to the limit in each half cycle asks the report, until
  it rises, 1 s has passed, or the time to start is over.
"""

import math
from dataclasses import replace
from typing import Final

from adaptdrive.config.root import DriveSection
from adaptdrive.control.signals import SAFE_COMMAND, Command
from adaptdrive.safety.facts import Reading
from adaptdrive.safety.trips import Trip, TripKind

_LOST_SHARE: Final = 0.05
"""Share of the commanded power that a drive may lose without being asked."""

_LOST_OF_MAXIMUM: Final = 0.02
"""The same as a share of the largest power: at rest, and for errors of the power's sensor."""

_UNSEEN_SHARE: Final = 0.1
"""Unseen rise of v_bst that asks its report, as a share of its limit."""

_ASKED_TICKS: Final = 12
"""Half cycles in which a report that is asked has to move: 0.1 s."""

_FED_SHARE: Final = 0.8
"""Share of the load's power that feeds the capacitor meanwhile, so that v_bst has to fall."""

_MOVED_SHARE: Final = 0.25
"""Share of that fall which shows that the report is not frozen."""

_VISIBLE_SHARE: Final = 0.02
"""Fall that a report which is asked has to show, as a share of the limit."""

_PATIENCE_TICKS: Final = 120
"""Half cycles for a report that is asked while the load takes too little for that fall."""

_AT_PEAK: Final = 2.0 * 1.02**2
"""v_bst² over V_rms² up to which the rectifier may hold it at the peak of the line."""

_TRICKLE_SHARE: Final = 0.005
"""Share of the energy up to the limit that a drive gets when it is asked for a rise."""

_CYCLE_TICKS: Final = 3
"""Longest cycle of a report of v_bst; a slower one cannot close the voltage loop."""


class CapacitorBalance:
    """Predicts v_bst from the commanded energy, and holds k to what a fresh report allows."""

    def __init__(self, drive: DriveSection, highest_V: float) -> None:
        """Begin without a report.

        Args:
            drive: Its capacitor.
            highest_V: Voltage that trips.
        """
        self._capacitance_F = drive.boost_capacitance_F
        self._largest_W = drive.largest_W
        self._highest_V = highest_V
        self.forget()

    def forget(self) -> None:
        """Begin anew: the drive is commanded off, and nothing charges the capacitor."""
        self._predicted_V2 = math.nan
        self._worst_V2 = self._reported_V2 = 0.0
        self._unseen_V2 = self._fall_V2 = self._stood_V2 = 0.0
        self._runs = False
        self._taken_s = -math.inf
        self._silent_ticks, self._cycle_ticks = 0, 1
        self._next_S = self._last_S = 0.0
        self._asked_V2, self._asked_ticks = math.nan, 0
        self._per_W = self._line_V2 = self._load_W = 0.0

    def sent(self, current_scale_S: float) -> None:
        """Note the command of this tick.

        Args:
            current_scale_S: k, as it was sent.
        """
        self._last_S = current_scale_S

    def find_cause(
        self, reading: Reading, ticks: int, tick_s: float, *, running: bool
    ) -> Trip | None:
        """Advance the prediction to this tick; return why it trips, None for no reason.

        Args:
            reading: The newest.
            ticks: Half line cycles since the last call.
            tick_s: Length of one.
            running: Whether the drive runs; while it starts, it may not charge yet.
        """
        self._runs = running
        self._per_W = 2.0 * tick_s / self._capacitance_F
        self._line_V2 = reading.line_voltage_V * reading.line_voltage_V
        self._load_W = reading.load_power_W
        late_S, self._next_S = self._next_S, self._last_S
        acting_W = (late_S + (ticks - 1) * self._last_S) / ticks * self._line_V2
        if math.isnan(self._predicted_V2):
            self._confirm(reading)
            return None
        gained_V2 = ticks * self._per_W * (acting_W - self._load_W)
        self._predicted_V2 += gained_V2
        self._stood_V2 = max(0.0, self._stood_V2 + gained_V2)
        self._worst_V2 += ticks * self._per_W * (acting_W - min(self._load_W, 0.0))
        self._unseen_V2 += ticks * self._per_W * self._unexplained_W(acting_W)
        if _voltage_s(reading) > self._taken_s:
            self._compare(reading)
            cause = self._frozen_cause(ticks)
            self._ask()  # last: a silence that has passed is no time to answer in
            return cause
        self._silent_ticks += ticks
        return self._exceeded()

    def bound(self, command: Command) -> Command:
        """Return the command with no more current than the newest report of v_bst allows.

        No command leads beyond the limit while the load takes what it took last; without a fresh
        report, not even when it takes nothing.
        """
        if not self._line_V2 > 0.0:
            return command
        is_asked = not math.isnan(self._asked_V2)
        is_confirmed = self._silent_ticks < self._cycle_ticks and not is_asked
        base_V2 = self._predicted_V2 if is_confirmed else self._worst_V2
        room_W = (self._highest_V**2 - base_V2) / self._per_W - self._next_S * self._line_V2
        fed_W = self._asked_W() if is_asked else self._load_W
        highest_W = room_W + 2.0 * self._load_W if is_confirmed else min(fed_W, room_W)
        highest_S = max(0.0, highest_W) / self._line_V2
        if not command.current_scale_S > highest_S:  # the guard refuses one that is NaN
            return command
        return replace(command, current_scale_S=highest_S)

    def _asked_W(self) -> float:
        """Return the power that feeds the capacitor while the report is asked."""
        if self._has_to_fall():
            return _FED_SHARE * self._load_W
        return self._load_W + _TRICKLE_SHARE * self._standing_room_V2() / self._per_W

    def _has_to_fall(self) -> bool:
        """Return whether v_bst falls where the capacitor gets less than the load takes."""
        return self._runs and self._reported_V2 > _AT_PEAK * self._line_V2

    def _standing_room_V2(self) -> float:
        """Return the rise up to the limit that is left if the report stands still wrongly."""
        gone_V2 = self._reported_V2 + self._stood_V2 + self._coming_V2()
        return max(0.0, self._highest_V**2 - gone_V2)

    def _coming_V2(self) -> float:
        """Return the rise by the command on its way."""
        return self._per_W * (self._next_S * self._line_V2 - self._load_W)

    def _confirm(self, reading: Reading) -> None:
        """Take a report: what was predicted so far is known now."""
        self._predicted_V2 = self._worst_V2 = self._reported_V2 = reading.boost_voltage_V**2
        self._taken_s = _voltage_s(reading)
        self._cycle_ticks = min(max(self._silent_ticks + 1, 1), _CYCLE_TICKS)
        self._silent_ticks = 0

    def _unexplained_W(self, acting_W: float) -> float:
        """Return the power that must raise v_bst, losses of the drive left out."""
        lost_W = _LOST_SHARE * abs(acting_W) + _LOST_OF_MAXIMUM * self._largest_W
        return acting_W - self._load_W - lost_W

    def _compare(self, reading: Reading) -> None:
        """Compare a report with the energy since the last one."""
        before_V2 = self._reported_V2
        self._confirm(reading)
        self._unseen_V2 = max(0.0, self._unseen_V2 - (self._reported_V2 - before_V2))
        if self._reported_V2 != before_V2:
            self._stood_V2 = 0.0

    def _ask(self) -> None:
        """Begin to ask a report that does not show the energy."""
        unseen_V = math.sqrt(self._reported_V2 + self._unseen_V2) - math.sqrt(self._reported_V2)
        asks = unseen_V > _UNSEEN_SHARE * self._highest_V or not self._standing_room_V2()
        if asks and math.isnan(self._asked_V2):
            self._asked_V2, self._asked_ticks, self._fall_V2 = self._reported_V2, 0, 0.0

    def _frozen_cause(self, ticks: int) -> Trip | None:
        """Return the cause of a trip where a report that is asked does not move."""
        if math.isnan(self._asked_V2):
            return None
        self._asked_ticks = self._asked_ticks + ticks if self._runs else 0
        if self._has_to_fall():
            self._fall_V2 += ticks * self._per_W * (1.0 - _FED_SHARE) * max(self._load_W, 0.0)
            moved = abs(self._asked_V2 - self._reported_V2) > _MOVED_SHARE * self._fall_V2
        else:
            moved = self._reported_V2 > self._asked_V2
            self._asked_V2 = self._reported_V2
        visible_V2 = 2.0 * _VISIBLE_SHARE * self._highest_V * math.sqrt(self._asked_V2)
        patience = _ASKED_TICKS if self._fall_V2 > visible_V2 else _PATIENCE_TICKS
        if moved:
            self._asked_V2, self._unseen_V2 = math.nan, 0.0
        elif self._asked_ticks >= patience:
            return Trip(
                TripKind.VOLTAGE_FROZEN,
                f"v_bst: the report stands at {math.sqrt(self._reported_V2):.1f} V, whatever "
                "energy is commanded: it is frozen, or its scale, that of the load power, that of "
                "k or drive.boost_capacitance_F is wrong",
            )
        return None

    def _exceeded(self) -> Trip | None:
        """Return the cause of a trip where the command on its way leads beyond the limit."""
        coming_V = math.sqrt(max(0.0, self._predicted_V2 + self._coming_V2()))
        if coming_V <= self._highest_V:
            return None
        return Trip(
            TripKind.OVER_VOLTAGE_PREDICTED,
            f"over-voltage: v_bst is predicted to reach {coming_V:.1f} V, limit "
            f"{self._highest_V:g} V: it was not reported for {self._silent_ticks} half "
            "cycles while the capacitor was charged",
        )


def _voltage_s(reading: Reading) -> float:
    """Return when v_bst was taken."""
    return reading.oldest_s if reading.voltage_s is None else reading.voltage_s


# Limits of each value of a command.


class Guard:
    """Holds every command to its limits and counts what it had to change.

    Attributes:
        limited: Commands that were held to a limit.
    """

    def __init__(self, drive: DriveSection) -> None:
        self._limits, self._given = drive.limits, drive.given
        self._lowest_S = drive.current_scale_min_S
        self._last_scale_S = 0.0
        self.limited = 0

    def check(self, command: Command) -> Command:
        """Return the command to send: the given one wherever it is within limits.

        Raises:
            ValueError: A value is not finite.
        """
        scale_S, reference_V = command.current_scale_S, command.boost_reference_V
        if not (math.isfinite(scale_S) and math.isfinite(reference_V)):
            given = self._given
            raise ValueError(
                f"the controller gave k = {scale_S:g} S, {given.symbol} = "
                f"{given.text(reference_V, 'g')}, which is not finite; keep the session "
                "for a report, then reset"
            )
        if not (command.bridge or scale_S or reference_V):
            self._last_scale_S = 0.0
            return SAFE_COMMAND
        limits, last_S = self._limits, self._last_scale_S
        low_S = max(self._lowest_S, last_S - limits.current_scale_slew_S)
        high_S = min(limits.current_scale_max_S, last_S + limits.current_scale_slew_S)
        self._last_scale_S = min(max(scale_S, low_S), high_S)
        lowest_V = min(limits.boost_reference_min_V, 0.0)
        limited_V = min(max(reference_V, lowest_V), limits.boost_reference_max_V)
        if self._last_scale_S == scale_S and limited_V == reference_V:
            return command
        self.limited += 1
        return Command(self._last_scale_S, limited_V, command.bridge)
