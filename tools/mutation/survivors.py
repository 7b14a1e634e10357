"""Mutants that no test can notice, each with the reason."""

from __future__ import annotations

_SET_BEFORE_USE = "every way into a state that reads it sets it first"

_COMPARED = "numbers of stops are compared with each other, and never shown"

_NOT_READ = "the entry beyond the last one is never read"

_RETURNED = "a distance of 0 has returned before"

_TOGETHER = "a tick sets both, and both are None before the first: the test is for the types"

_DIFFERENCES = "only the differences of these counts are used"

_NEGATIVE = "only its sign is read before the first frame"

_BOUND = "a share of half cycles that equals the bound to the last digit may be judged either way"

_BEYOND = "any number beyond 32,768 us, where the last bin begins"

_SLACK = "a bridge whose grace ends at just the slack for rounding may be judged either way"

_DOUBT_BOUND = "a deviation that equals the bound to the last digit may be judged either way"

_UNLIMITED = "the time of a voltage without `hold_s` is never compared"

_TIME_BOUND = "a time that equals the bound to the last digit may be judged either way"

_FALSE = "None is as false as False, and nobody sees which"

_VOLTAGE = (
    "start_V=self.manual.value(tick), target_V=value + 0.0, since_tick=tick, hold_s=hold_s, "
    "hold_ticks="
)
_HOLD = " if hold_s is None else math.ceil(hold_s / self._limits.drive.half_cycle_s))"
_MACHINE = "runtime.state_machine:Machine.__init__: "
_LOOP = "runtime.fast_loop:FastLoop."
_CYCLES = "runtime.timebase:HalfCycles."
_RATE = "safety.frames:"
_COUNTER = "safety.frames:CounterWatch."
_MONITOR = "safety.monitor:Monitor."

RUNTIME: dict[str, str] = {
    "runtime.settings:ManualVoltage.value: if abs(distance_V) <= way_V: -> "
    "if abs(distance_V) < way_V:": "a way of just the distance ends at the target too",
    "runtime.settings:ManualVoltage.value: return self.start_V + (way_V if distance_V > 0.0 else "
    "-way_V) -> return self.start_V + (way_V if distance_V >= 0.0 else -way_V)": _RETURNED,
    f"{_MACHINE}self.manual = self._limits.held(limits.rest_V, 0) -> "
    "self.manual = self._limits.held(limits.rest_V, 1)": "a V_c that stays has no beginning",
    f"{_MACHINE}self._coasts = False -> self._coasts = True": _SET_BEFORE_USE,
    f"{_MACHINE}self._since_tick = 0 -> pass": _SET_BEFORE_USE,
    f"{_MACHINE}self._since_tick = 0 -> self._since_tick = 1": _SET_BEFORE_USE,
    f"{_MACHINE}self._precharging = False -> pass": _SET_BEFORE_USE,
    f"{_MACHINE}self._precharging = False -> self._precharging = True": _SET_BEFORE_USE,
    "runtime.state_machine:Machine._set_voltage: self.manual = replace(self.manual, "
    f"{_VOLTAGE}0{_HOLD} -> self.manual = replace(self.manual, {_VOLTAGE}1{_HOLD}": _UNLIMITED,
    f"{_LOOP}__init__: self._wanted = signals.SAFE_COMMAND -> pass": _SET_BEFORE_USE,
    f"{_LOOP}__init__: self._deadline_s = math.inf -> pass": _SET_BEFORE_USE,
    f"{_CYCLES}__init__: self._arrival_s = 0.0 -> pass": _SET_BEFORE_USE,
    f"{_CYCLES}__init__: self._arrival_s = 0.0 -> self._arrival_s = 1.0": _SET_BEFORE_USE,
    f"{_CYCLES}__init__: self._grid_s = 0.0 -> pass": _SET_BEFORE_USE,
    f"{_CYCLES}__init__: self._grid_s = 0.0 -> self._grid_s = 1.0": _SET_BEFORE_USE,
    f"{_CYCLES}__init__: self._frame_tick = -1 -> self._frame_tick = -2": _NEGATIVE,
    f"{_CYCLES}_measure: if abs(period_s / self._nominal_s - 1.0) <= _PERIOD_TOLERANCE: -> "
    "if abs(period_s / self._nominal_s - 1.0) < _PERIOD_TOLERANCE:": _BOUND,
    f"{_RATE}_fits: return abs(late[0] - early[0]) <= _TOLERANCE * (late[1] - early[1]) + "
    "_JITTER_TICKS -> return abs(late[0] - early[0]) < _TOLERANCE * (late[1] - early[1]) + "
    "_JITTER_TICKS": _BOUND,
    f"{_RATE}FrameRate.add: passed = (arrival_s - self._began_s) / self._tick_s -> "
    "passed = (arrival_s + self._began_s) / self._tick_s": _DIFFERENCES,
    f"{_COUNTER}__init__: self._tick_s = tick_s -> pass": _SET_BEFORE_USE,
    f"{_COUNTER}__init__: self._seen_s = -math.inf -> self._seen_s = math.inf": _SET_BEFORE_USE,
    f"{_COUNTER}__init__: self._newest: _Count = (0, -math.inf) -> "
    "self._newest: _Count = (1, -math.inf)": _SET_BEFORE_USE,
    f"{_COUNTER}__init__: self._newest: _Count = (0, -math.inf) -> "
    "self._newest: _Count = (0, math.inf)": _SET_BEFORE_USE,
    f"{_COUNTER}_judge: if self._off(accepted, count) <= SLACK_TICKS: -> "
    "if self._off(accepted, count) < SLACK_TICKS:": _DOUBT_BOUND,
    f"{_COUNTER}_judge: if suspect is not None and self._off(suspect, count) <= _PACE_TICKS: -> "
    "if suspect is not None and self._off(suspect, count) < _PACE_TICKS:": _DOUBT_BOUND,
    f"{_COUNTER}_judge: if self._passed(suspect, count) >= _SURE_TICKS: -> "
    "if self._passed(suspect, count) > _SURE_TICKS:": _TIME_BOUND,
    f"{_COUNTER}_judge: if count[0] <= self._passed(accepted, count) + _BEGUN_TICKS: -> "
    "if count[0] < self._passed(accepted, count) + _BEGUN_TICKS:": _DOUBT_BOUND,
    f"{_COUNTER}_judge: if stray is not None and self._off(stray, count) <= _PACE_TICKS: -> "
    "if stray is not None and self._off(stray, count) < _PACE_TICKS:": _DOUBT_BOUND,
    f"{_COUNTER}_judge: if self._passed(stray, count) >= sure_ticks: -> "
    "if self._passed(stray, count) > sure_ticks:": _TIME_BOUND,
    f"{_MONITOR}_is_overdue: return False -> return None": _FALSE,
    f"{_MONITOR}_note_passed: if unwatched_s > self._asleep_s: -> "
    "if unwatched_s >= self._asleep_s:": _TIME_BOUND,
    f"{_MONITOR}_is_overdue: return self._off_s - self._first_off_s > self._switched_on_s "
    "+ _SLACK_S -> return self._off_s - self._first_off_s >= self._switched_on_s "
    "+ _SLACK_S": _SLACK,
    "runtime.reports:: _LARGEST_US = 1000000000.0 -> _LARGEST_US = 1000000001.0": _BEYOND,
    "runtime.reports:: _LARGEST_US = 1000000000.0 -> _LARGEST_US = 2000000000.0": _BEYOND,
}

MQTT: dict[str, str] = {
    "mqtt.desk:Desk.receive: self._stops += 1 -> self._stops += 2": _COMPARED,
}

CONTROL: dict[str, str] = {
    "control.controller:Controller.__init__: self._fast = fast.FastState(tick=0, "
    "boost_reference_V=0.0, error_sum=0.0) -> pass": _SET_BEFORE_USE,
    "control.controller:Controller.__init__: self._bank = self._new_bank("
    "settings.rates.nominal_tick_s, 0.0, 0.0) -> self._bank = self._new_bank("
    "settings.rates.nominal_tick_s, 0.0, 1.0)": _SET_BEFORE_USE,
    "control.controller:Controller._estimates: if math.isfinite(state.values[0]): -> "
    "if math.isfinite(state.values[1]):": "all values of an estimate are set together",
    "control.estimation.regression:to_lambda: sign = -1.0 if (j - i) % 2 else 1.0 -> "
    "sign = -1.0 if (j + i) % 2 else 1.0": "sum and difference of two numbers are odd together",
    "control.estimation.filters:: _SERIES_TERMS = 40 -> "
    "_SERIES_TERMS = 80": "the terms that are left out are below the rounding of a double",
    "control.design.noise:impulse_norm: a, b = (list(denominator), [0.0] * (degree + 1)) -> "
    "a, b = (list(denominator), [0.0] * (degree + 2))": _NOT_READ,
}

REASONS = RUNTIME | MQTT | CONTROL
