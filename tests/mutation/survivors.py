"""Mutants that no test can notice, each with the reason."""

from __future__ import annotations

_SET_BEFORE_USE = "every way into a state that reads it sets it first"

_COMPARED = "numbers of stops are compared with each other, and never shown"

_MACHINE = "runtime.machine:Machine.__init__: "

_TOGETHER = "a tick sets both, and both are None before the first: the test is for the types"

_LOOP = "runtime.fast_loop:FastLoop."

RUNTIME: dict[str, str] = {
    f"{_LOOP}__init__: self._wanted = SAFE_COMMAND -> pass": _SET_BEFORE_USE,
    f"{_LOOP}__init__: self._deadline_s = math.inf -> pass": _SET_BEFORE_USE,
    f"{_LOOP}_report: if self.measurement is None or self._order is None: -> "
    "if self.measurement is None and self._order is None:": _TOGETHER,
    f"{_MACHINE}self.manual = self._limits.held(limits.floor_V, 0) -> "
    "self.manual = self._limits.held(limits.floor_V, 1)": "a V_c that stays has no beginning",
    f"{_MACHINE}self._coasts = False -> self._coasts = True": _SET_BEFORE_USE,
    f"{_MACHINE}self._since_tick = 0 -> pass": _SET_BEFORE_USE,
    f"{_MACHINE}self._since_tick = 0 -> self._since_tick = 1": _SET_BEFORE_USE,
    f"{_MACHINE}self._precharging = False -> pass": _SET_BEFORE_USE,
    f"{_MACHINE}self._precharging = False -> self._precharging = True": _SET_BEFORE_USE,
    f"{_MACHINE}self._waveform_tick = 0 -> pass": _SET_BEFORE_USE,
    f"{_MACHINE}self._waveform_tick = 0 -> self._waveform_tick = 1": _SET_BEFORE_USE,
}

OPERATION: dict[str, str] = {
    "operation.desk:Desk.__init__: self._stops = 0 -> self._stops = 1": _COMPARED,
    "operation.desk:Desk.receive: self._stops += 1 -> self._stops += 2": _COMPARED,
}

CONTROL: dict[str, str] = {}

REASONS = RUNTIME | OPERATION | CONTROL
