"""The experiment on an unknown load: from samples to the next V_c, without a model.

1. At the lowest V_c the load comes to rest. A battery is raised until a current flows.
2. V_c rises by a small step, which is doubled each time the load has come to rest, until the output
   has moved by a visible share of the movement asked for. An output that moves further takes V_c
   back.
3. A pseudo-random binary sequence switches V_c between rest and the step at which the output moves
   as far as was asked for. Its clock follows from the time that the load took.

A load without overshoot stays within that movement. Time is that of the samples.
"""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import dataclass
from enum import StrEnum
from typing import TypeVar

from adaptdrive.commission.samples import Samples
from adaptdrive.commission.target import Target
from adaptdrive.errors import CommissionError

_FIRST_SHARE = 0.25
"""Share of the movement that the first step brings, if the guess of the gain is right."""

_ENOUGH = 0.4
"""Share of the movement that shows the gain."""

_TOO_FAR = 1.1
"""Share of the movement at which V_c is taken back."""

_BAND = 0.5
"""Distance beyond rest and movement that the test allows, as a share of the movement."""

_NOISE_DEVIATIONS = 6.0
"""Standard deviations of a mean that noise may add to a limit: it is looked at 10,000 times."""

_DRIFTING_BAND = 2.5
"""The same below the current of a battery, which falls while it is charged."""

_DRIFT = 0.1
"""Change of a battery's current that counts as rest, as a share of the movement: its EMF rises."""

_RESTING = 0.05
"""Change over a quarter of the wait, as a share of the response, of a load at rest."""

_VISIBLE = 0.06
"""Standard error of a rest, as a share of the movement, that is waited for."""

_PATIENCES = 60.0
"""Longest wait, in shortest ones."""

_SMOOTH_SHARE = 0.02
"""Length of the means that are compared with limits, as a share of the shortest wait."""

_CLOCKS = (5.0, 15.0)
"""Clocks of the slow and of the fast sequence in the time to rest."""

_LONG = 2.0
"""Length of the last two levels in times to rest."""

_REPEATS = 2
_ACCURACY = 0.005
"""Relative standard deviation of the gain that the length of the test aims at."""

_TAPS = (5, 3)
_LENGTH = 2 ** _TAPS[0] - 1
_LONGEST_CLIMB = 40
_FLOWING = 3.0
_ONSET_SHARE = 0.02
_NOISE_SHARE = 0.05
_SLOWEST_SLEW_V_PER_S = 50.0

Result = TypeVar("Result")
Steps = Generator[bool, None, Result]
"""A phase: it goes on with each sample, and ends with a result."""


class Phase(StrEnum):
    """Part of an experiment."""

    REST = "waiting for rest at the lowest voltage"
    ONSET = "raising the voltage until a current flows"
    CLIMB = "looking for the step that moves the output visibly"
    RETREAT = "taking the voltage back: the output moved too far"
    TEST = "switching the voltage"
    DONE = "done"


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of an experiment.

    Attributes:
        low_V: V_c at rest.
        high_V: V_c of the sequence's other level.
        rest: Output at rest.
        moved: Change of the output by the last step of the climb.
        gain: That change over the change of the load's input.
        settling_s: Time that the load took to come to rest.
        noise: Standard deviation of the noise of one sample.
        began_s: Time from which the samples count.
    """

    low_V: float
    high_V: float
    rest: float
    moved: float
    gain: float
    settling_s: float
    noise: float
    began_s: float


class LoadExperiment:
    """An experiment that is fed with samples and returns V_c.

    Attributes:
        record: All samples.
        phase: Where it is.
        progress: Share of the present phase, 0 to 1, where it is known.
        outcome: The result, None before the end of the climb.
    """

    def __init__(self, target: Target) -> None:
        self.record = Samples()
        self.phase = Phase.REST
        self.progress = 0.0
        self.outcome: Outcome | None = None
        self._target = target
        self._voltage_V = target.low_V
        self._time_s = 0.0
        self._rest = self._moved = math.nan
        self._noise = 0.0
        self._noise_known_s = -math.inf
        self._course = self._run()

    def take(self, time_s: float, boost_voltage_V: float, output: float) -> float:
        """Take a sample and return V_c.

        Args:
            time_s: Its time.
            boost_voltage_V: Boost voltage.
            output: Output.

        Raises:
            CommissionError: The experiment cannot go on; V_c must go to the safe state.
        """
        if not (math.isfinite(boost_voltage_V) and math.isfinite(output)):
            raise CommissionError(f"output = {output}, v_bst = {boost_voltage_V} is not finite")
        self._time_s = time_s
        self.record.append(time_s, boost_voltage_V, output)
        if self.phase is not Phase.DONE and next(self._course, None) is None:
            self.phase = Phase.DONE
        return self._voltage_V

    @property
    def voltage_V(self) -> float:
        """V_c that is asked for now."""
        return self._voltage_V

    @property
    def done(self) -> bool:
        """True when the test is complete."""
        return self.phase is Phase.DONE

    def _run(self) -> Steps[None]:
        """Run all phases, one step for each sample."""
        target = self._target
        base_V = target.low_V
        if target.onset is not None:
            self.phase = Phase.ONSET
            base_V = yield from self._find_onset()
        yield from self._settle(base_V)
        began_s = self._time_s
        rest, found_V, settling_s = yield from self._climb(base_V)
        outcome = self._judge(base_V, rest, found_V, settling_s, began_s)
        self.outcome = outcome
        self.phase = Phase.TEST
        yield from self._test(outcome)

    def _find_onset(self) -> Steps[float]:
        """Raise V_c until a current flows that can be lowered again."""
        target = self._target
        wanted, wait_s = _FLOWING * target.move, _ONSET_SHARE * target.patience_s
        voltage_V = target.low_V
        yield from self._pass(target.patience_s / 4.0)
        while self._recent(wait_s) < wanted:
            if voltage_V >= target.high_V:
                raise CommissionError(
                    f"no current: {target.name} = {self._recent(wait_s):.3g} {target.unit} at "
                    f"{voltage_V:.4g} V, the highest V_c"
                )
            voltage_V = min(voltage_V + target.onset_step_V, target.high_V)
            self._voltage_V = voltage_V
            self.progress = (voltage_V - target.low_V) / (target.high_V - target.low_V)
            self._look_at_terminals(voltage_V, self._recent(wait_s))
            yield from self._pass(wait_s)
        return voltage_V

    def _climb(self, base_V: float) -> Steps[tuple[float, float, float]]:
        """Find a step whose response is visible: the rest, its voltage, and its time to rest."""
        target = self._target
        step = _FIRST_SHARE * target.move / target.first_gain
        factor, rest = 2.0, self._rest
        for _ in range(_LONGEST_CLIMB):
            self.phase = Phase.CLIMB
            raised_V = target.raised_V(base_V, step)
            self._look_at_terminals(raised_V, rest + target.move)
            began_s = self._time_s
            moved = yield from self._respond(raised_V, rest)
            if _ENOUGH * target.move <= moved <= _TOO_FAR * target.move:
                self._moved = moved
                return rest, raised_V, self._time_to_rest(began_s)
            if moved > _TOO_FAR * target.move:
                self.phase = Phase.RETREAT
                peak = yield from self._retreat(base_V, rest, moved)
                step, factor = step * max(0.1, 0.6 * target.move / peak), 1.3
                rest = self._rest
                continue
            if raised_V >= target.high_V:
                raise CommissionError(
                    f"no response: {target.name} moved by {moved:.3g} {target.unit} when V_c rose "
                    f"from {base_V:.4g} V to {raised_V:.4g} V; wanted {target.move:.3g} "
                    f"{target.unit}: look at sensor and load, or ask for a smaller movement"
                )
            step *= factor
        raise CommissionError(f"no step of V_c moves {target.name} by {target.move:.3g}")

    def _respond(self, voltage_V: float, rest: float) -> Steps[float]:
        """Raise V_c and wait for rest; the movement is returned, early where it is too large."""
        target, began_s, before_V = self._target, self._time_s, self._voltage_V
        self._voltage_V = voltage_V
        for _ in self._until_rest():
            moved = self._recent(self._smooth_s) - rest
            if moved > _TOO_FAR * target.move:
                return moved
            if moved < -self._margin(_BAND):
                raise CommissionError(
                    f"{target.name} fell by {-moved:.3g} {target.unit} when V_c rose to "
                    f"{voltage_V:.4g} V: is its sensor reversed?"
                )
            yield True
        moved = self._rest - rest
        if target.onset is None:
            return moved
        ready_s = began_s + abs(voltage_V - before_V) / _SLOWEST_SLEW_V_PER_S
        return max(moved, self.record.mean(ready_s, ready_s + 5.0 * self._smooth_s) - rest)

    def _retreat(self, base_V: float, rest: float, moved: float) -> Steps[float]:
        """Take V_c back and wait for rest; the largest movement is returned."""
        self._voltage_V = base_V
        peak = moved
        for _ in self._until_rest():
            peak = max(peak, self._recent(self._smooth_s) - rest)
            yield True
        return peak

    def _settle(self, voltage_V: float) -> Steps[None]:
        self._voltage_V = voltage_V
        for _ in self._until_rest():
            yield True

    def _until_rest(self) -> Steps[None]:
        """Wait until two quarters of the time since now have the same mean."""
        target, record = self._target, self.record
        began_s, start = self._time_s, self._recent(self._smooth_s)
        next_s = began_s + target.patience_s
        while True:
            yield True
            self._look_at_output()
            if self._time_s < next_s:
                continue
            elapsed_s = self._time_s - began_s
            quarter_s, drift = 0.25 * elapsed_s, 0.0
            if target.onset is not None:
                quarter_s = min(quarter_s, 0.5 * target.patience_s)
                drift = _DRIFT * target.move
            middle = record.mean(self._time_s - 2.0 * quarter_s, self._time_s - quarter_s)
            last = record.mean(self._time_s - quarter_s, self._time_s)
            error = self._standard_error(quarter_s)
            allowed = max(_RESTING * abs(last - start), 3.0 * error, drift)
            if error <= _VISIBLE / 3.0 * target.move and abs(last - middle) <= allowed:
                self._rest = last
                return
            if elapsed_s > _PATIENCES * target.patience_s:
                raise CommissionError(
                    f"{target.name} does not come to rest within {elapsed_s:.0f} s: it moves by "
                    f"{last - middle:.3g} {target.unit} in {quarter_s:.0f} s, and its noise "
                    f"is {record.noise(began_s, self._time_s):.3g} {target.unit}"
                )
            next_s = began_s + 1.1 * elapsed_s

    def _time_to_rest(self, began_s: float) -> float:
        """Return the time after which the output stayed near its rest.

        The current of a battery jumps, and relaxes by less than can be seen in one response.
        """
        record = self.record
        elapsed_s = self._time_s - began_s
        if self._target.onset is not None:
            return elapsed_s
        start = record.mean(began_s - self._smooth_s, began_s)
        allowed = 0.1 * abs(self._rest - start)
        while elapsed_s > 0.02 * self._target.patience_s:
            half_s = 0.5 * elapsed_s
            mean = record.mean(began_s + 0.6 * half_s, began_s + half_s)
            if not abs(mean - self._rest) <= allowed + 2.0 * self._standard_error(0.4 * half_s):
                break
            elapsed_s = half_s
        return elapsed_s

    def _judge(
        self, base_V: float, rest: float, found_V: float, settling_s: float, began_s: float
    ) -> Outcome:
        """Choose the level at which the output moves as far as was asked for."""
        target = self._target
        moved = self._moved
        difference = target.to_input(found_V) - target.to_input(base_V)
        gain = moved / difference
        high_V = target.raised_V(base_V, target.move / gain)
        self._look_at_terminals(high_V, rest + target.move)
        noise = self.record.noise(began_s, self._time_s)
        return Outcome(base_V, high_V, rest, moved, gain, settling_s, noise, began_s)

    def _test(self, outcome: Outcome) -> Steps[None]:
        """Switch between the two levels; the output stays within its band."""
        slow_s, fast_s = (outcome.settling_s / clocks for clocks in _CLOCKS)
        sequence = [(level, clock_s) for clock_s in (slow_s, fast_s) for level in _sequence()]
        duration_s = _LENGTH * (slow_s + fast_s)
        repeats = max(_REPEATS, math.ceil(self._sufficient_s(outcome) / duration_s))
        for number in range(repeats):
            self.progress = number / (repeats + 1)
            for level, clock_s in sequence:
                yield from self._hold(outcome, clock_s, level=level)
        for level in (True, False):
            yield from self._hold(outcome, _LONG * outcome.settling_s, level=level)

    def _hold(self, outcome: Outcome, duration_s: float, *, level: bool) -> Steps[None]:
        """Hold a level of the test, the upper or the lower one, for a time."""
        target = self._target
        share = _BAND if target.onset is None else _DRIFTING_BAND
        low = outcome.rest - self._margin(share)
        high = outcome.rest + target.move + self._margin(_BAND)
        self._voltage_V = outcome.high_V if level else outcome.low_V
        until_s = self._time_s + duration_s
        while self._time_s < until_s:
            yield True
            output = self._recent(self._smooth_s)
            if not low <= output <= high:
                raise CommissionError(
                    f"{target.name} = {output:.4g} {target.unit} left the band "
                    f"{low:.4g}…{high:.4g} {target.unit} of the test: the load has changed"
                )

    def _sufficient_s(self, outcome: Outcome) -> float:
        """Return the time in which the noise lets the gain be known to `_ACCURACY`."""
        record = self.record
        passed_s = self._time_s - outcome.began_s
        sample_s = passed_s / max(1, record.count(outcome.began_s, self._time_s))
        deviation = outcome.noise / (0.5 * _ACCURACY * self._target.move)
        return 2.0 * deviation * deviation * sample_s

    def _pass(self, duration_s: float) -> Steps[None]:
        """Let time pass."""
        until_s = self._time_s + duration_s
        while self._time_s < until_s:
            yield True
            self._look_at_output()

    def _look_at_output(self) -> None:
        target = self._target
        output = self._recent(self._smooth_s)
        if output > target.output_max + self._margin(0.0):
            raise CommissionError(
                f"{target.name} = {output:.4g} {target.unit} at V_c = {self._voltage_V:.4g} V is "
                f"above load.reference_max = {target.output_max:g} {target.unit}"
            )

    def _look_at_terminals(self, voltage_V: float, output: float) -> None:
        onset = self._target.onset
        if onset is None:
            return
        terminal_V = onset.terminal_V(voltage_V, output)
        if terminal_V > onset.terminal_max_V:
            raise CommissionError(
                f"{terminal_V:.4g} V at the terminals would be above load.charge.voltage_max_V = "
                f"{onset.terminal_max_V:g} V: the battery is too full for the experiment"
            )

    def _recent(self, duration_s: float) -> float:
        """Return the mean output over the last time, at least of one sample."""
        record = self.record
        if not record.times_s:
            return math.nan
        mean = record.mean(self._time_s - duration_s, self._time_s)
        return mean if math.isfinite(mean) else record.outputs[-1]

    @property
    def _smooth_s(self) -> float:
        return _SMOOTH_SHARE * self._target.patience_s

    def _margin(self, share: float) -> float:
        """Return a share of the movement, and what noise adds to a mean over `_smooth_s`."""
        return share * self._target.move + _NOISE_DEVIATIONS * self._standard_error(self._smooth_s)

    def _standard_error(self, duration_s: float) -> float:
        """Return the standard error of a mean over the last time."""
        record, patience_s = self.record, self._target.patience_s
        if self._time_s >= self._noise_known_s + _NOISE_SHARE * patience_s:
            self._noise = record.noise(self._time_s - patience_s, self._time_s)
            self._noise_known_s = self._time_s
        count = record.count(self._time_s - duration_s, self._time_s)
        return self._noise / math.sqrt(max(1, count))


def _sequence() -> list[bool]:
    """Return a maximum-length sequence of 31 levels (x⁵ + x³ + 1)."""
    register, levels = [True] * _TAPS[0], []
    for _ in range(_LENGTH):
        levels.append(register[-1])
        register = [register[_TAPS[0] - 1] ^ register[_TAPS[1] - 1], *register[:-1]]
    return levels
