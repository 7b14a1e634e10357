"""The drive's state machine: standby, starting, running, stopping, and a trip from anywhere.

It holds what the operator asked for and answers requests; it never talks to anything. Nothing
but `enable` energises the drive, only a confirmed stop ends in standby, and only `reset` leaves a
trip, once its cause is gone.

Below what V_c can hold an enabled drive coasts: its bridge is off until a set-point within reach
starts it. `enable` itself moves nothing, and a set-point of 0 or less lets the load coast.
"""

import math
from dataclasses import replace
from typing import Final

from adaptdrive.control.signals import Mode, MovingReference, Order, Stage, Waveform
from adaptdrive.runtime import requests
from adaptdrive.runtime.reports import State
from adaptdrive.runtime.settings import (
    AskedReference,
    MachineLimits,
    coasts_at,
    on_the_way,
    require_positive,
)
from adaptdrive.safety.trips import Trip
from adaptdrive.util.errors import RefusedError

# compiled code finds a constant of its module at once, and a member of an enumeration in 0.1 us
_STARTING: Final[State] = State.STARTING
_RUNNING: Final[State] = State.RUNNING
_OFF: Final[Stage] = Stage.OFF
_PRECHARGE: Final[Stage] = Stage.PRECHARGE
_RUN: Final[Stage] = Stage.RUN
_MANUAL: Final[Mode] = Mode.MANUAL


class Machine:
    """State and requests of one drive.

    Attributes:
        state: Where the machine is.
        mode: Controller asked for, or manual.
        manual: V_c as the operator sets it.
        asked: Set-point, and the way there.
        pole: Closed-loop pole asked for.
        trip: Cause of the latched trip.
        stopped: Whether the drive has confirmed that it is off.
        reach: What V_c can hold, by the model in force.
    """

    def __init__(self, limits: MachineLimits) -> None:
        self._limits, self._given = limits, limits.drive.given
        self.state = State.STANDBY
        self.mode = Mode.FIXED
        self.manual = self._limits.held(limits.rest_V, 0)
        self.asked = AskedReference(limits.load.reference_min)
        self.pole = limits.load.pole
        self.trip: Trip | None = None
        self.stopped = False
        self.reach = limits.reach
        self._coasts = False
        self._since_tick = 0
        self._precharging = False
        self._awaited_s = math.inf
        self._order: Order | None = None
        self._parts: tuple[object, ...] | None = None

    @property
    def energised(self) -> bool:
        """True if the drive may be energised."""
        return self.state is _RUNNING or self.state is _STARTING

    @property
    def coasting(self) -> bool:
        """True while an enabled drive is commanded off, asked for nothing that V_c can hold."""
        return self._coasts and self.state is _RUNNING

    @property
    def commanded_off(self) -> bool:
        """True while the drive is commanded off, and has to confirm that it is."""
        return self.coasting or not self.energised

    @property
    def obstacle(self) -> str:
        """Return the reason why V_c cannot hold the set-point, empty where it can."""
        if not self.energised:
            return ""
        reach, display = self.reach, self._limits.load.display
        given = self._given
        within = display.range_text(reach.low, reach.high)
        if self.coasting:
            known = f" within {within}" if reach.is_known else ""
            awaited = given.by_hand if self.mode is Mode.MANUAL else f"set-point{known}"
            return f"coasting with the bridge off until a {awaited}"
        if self.mode is Mode.MANUAL or self.asked.is_within(reach):
            return ""
        if self.asked.waveform is not None:
            return ""
        outside = f"set-point {display.text(self.asked.setpoint)} is outside {within}"
        return f"{outside}, which {given.symbol} can hold"

    @property
    def stage(self) -> Stage:
        """Degree to which the controller may energise the drive."""
        if self.state is _RUNNING:
            return _OFF if self._coasts else _RUN
        return _PRECHARGE if self.state is _STARTING and self._precharging else _OFF

    @property
    def steady(self) -> bool:
        """True while the set-point is constant and a controller follows it."""
        return self.asked.moving is None and self.mode is not _MANUAL

    def reference(self, tick: int) -> float:
        """The set-point at a tick."""
        return self.asked.value(tick, self._limits.drive.half_cycle_s)

    def manual_V(self, tick: int) -> float:
        """V_c asked for at a tick in mode manual, 0 in every other."""
        return self.manual.value(tick) if self.mode is _MANUAL else 0.0

    def order(self, tick: int) -> Order:
        """The order to the controller at a tick; a new object only when something changed."""
        reference, manual_V = self.reference(tick), self.manual_V(tick)
        known = self.asked.moving if self.asked.previews else None
        parts = (self.stage, reference, self.mode, self.pole, manual_V, self.steady, known)
        if self._order is None or parts != self._parts:
            self._parts, self._order = parts, Order(*parts)
        return self._order

    def carry_out(
        self,
        request: requests.Request,
        tick: int,
        output: float,
        cause: Trip | None,
        voltage_V: float = math.nan,
    ) -> None:
        """Carry out an operator's request.

        Args:
            request: What is asked.
            tick: Present tick.
            output: Present output, NaN while unknown.
            cause: Interlock that is active now, None for none.
            voltage_V: V_c in force, NaN while unknown.

        Raises:
            RefusedError: It cannot be done; nothing was changed.
        """
        match request:
            case requests.SetSetpoint(value, slope):
                self._set_setpoint(value, slope, tick, output)
            case requests.SetWaveform(waveform, preview):
                self._set_waveform(waveform, tick, preview=preview)
            case requests.SetMode(mode):
                self._set_mode(mode, tick, output, voltage_V)
            case requests.SetVoltage(value, hold_s):
                self._set_voltage(value, hold_s, tick)
            case requests.SetPole(value):
                self._limits.require_pole(value)
                self.pole = value
            case requests.Enable():
                self.enable(output, cause, tick)
            case requests.Disable():
                self.disable()
            case requests.Reset():
                self.reset(cause)
            case requests.Reload() if self.state is not State.STANDBY:
                raise RefusedError(f"reload needs standby; state is {self.state}")

    def _set_mode(self, mode: Mode, tick: int, output: float, voltage_V: float) -> None:
        """Change the mode without a bump: V_c stays into manual, the output stays out of it.

        An output that is still on its way into reach goes to its edge.
        """
        if mode is self.mode:
            return
        if Mode.MANUAL in (mode, self.mode):
            self._hold(self.asked.setpoint)
        if mode is Mode.MANUAL:
            self.manual = self._limits.held(voltage_V, tick)
        elif self.mode is Mode.MANUAL and self.energised:
            held = self._limits.nearest_reference(output)
            self._hold(held if self._coasts else self.reach.nearest(held))
        self.mode = mode

    def _set_voltage(self, value: float, hold_s: float | None, tick: int) -> None:
        """Set V_c in mode manual, until the next one or for so long at most."""
        if self.mode is not Mode.MANUAL:
            raise RefusedError(f"voltage needs mode manual; mode is {self.mode}")
        if self.state is not State.RUNNING:
            raise RefusedError(f"voltage needs a running drive; state is {self.state}")
        self._limits.require_voltage(value, hold_s)
        self.manual = replace(
            self.manual,
            start_V=self.manual.value(tick),
            target_V=value + 0.0,
            since_tick=tick,
            hold_s=hold_s,
            hold_ticks=0 if hold_s is None else math.ceil(hold_s / self._limits.drive.half_cycle_s),
        )
        if self.coasting:
            self._start()

    def _set_setpoint(self, value: float, slope: float | None, tick: int, output: float) -> None:
        """Go to a constant set-point; stop a waveform. A drive that coasts begins at its output."""
        self.require_loop("setpoint")
        self._limits.require_setpoint("setpoint", value, self.reach)
        require_positive("slope", slope)
        coasts = coasts_at(value, self.reach)
        slope = math.inf if coasts and self.coasting else self._limits.slope(slope)
        start = self.reach.nearest(output) if self.coasting else self.reference(tick)
        self.asked = on_the_way(start, value, slope, tick)
        if coasts and self.asked.ramp is None:
            self.coast()
        elif self.coasting:
            self._start()

    def progress(self, tick: int) -> bool:
        """End a ramp whose end is reached, between two ticks; return whether it has ended.

        One that lets the load coast ends where V_c cannot hold it any more.

        Args:
            tick: Present tick.
        """
        ramp = self.asked.ramp
        if ramp is None or self.state is not _RUNNING:
            return False
        reference, coasts = self.reference(tick), coasts_at(ramp.end, self.reach)
        if reference != ramp.end and not (coasts and reference < self.reach.low):
            return False
        self._hold(ramp.end)
        if coasts:
            self.coast()
        return True

    def _set_waveform(self, waveform: Waveform | None, tick: int, *, preview: bool) -> None:
        """Follow a waveform from a tick on; None holds the present set-point."""
        self.require_loop("waveform")
        if waveform is None:
            self._hold(self.reference(tick))
        else:
            self._limits.require_waveform("waveform", waveform, self.reach)
            moving = MovingReference(waveform, tick)
            self.asked = AskedReference(self.asked.setpoint, moving, preview)
            if self.coasting:
                self._start()

    def enable(self, output: float, cause: Trip | None, tick: int) -> None:
        """Start the drive, with the present output as set-point; no effect while it is energised.

        In mode manual it coasts until a voltage is asked for: a program that dies before that
        leaves nothing energised. So does a load of which it is unknown what V_c does to it, until a
        set-point is asked for.

        Args:
            output: Present output, NaN while unknown.
            cause: Interlock that is active now, None for none.
            tick: Present tick.

        Raises:
            RefusedError: The drive is tripped or has not stopped, or an interlock is active.
        """
        if self.trip is not None:
            raise RefusedError(f"tripped ({self.trip}); reset first", self.trip.kind)
        if self.energised:
            return
        if self.state is State.STOPPING:
            why, kind = ("", "") if cause is None else (f" ({cause})", cause.kind)
            text = f"the drive has not confirmed its stop{why}; enable it in standby"
            raise RefusedError(text, kind)
        if cause is not None:
            raise RefusedError(cause.text, cause.kind)
        limits, known = self._limits, self.reach.is_known
        self.manual = limits.held(limits.rest_V, tick)
        below = known and output < max(limits.load.reference_min, self.reach.low)
        at_rest = max(output, min(limits.load.reference_min, 0.0))
        self._hold(at_rest if below else limits.nearest_reference(output))
        if below or self.mode is Mode.MANUAL or not known:
            self.coast()
        else:
            self._start()

    def disable(self) -> None:
        """Stop the drive, in every state."""
        self._hold(self.asked.setpoint)
        if self.energised:
            self.state = State.STOPPING

    def reset(self, cause: Trip | None) -> None:
        """Leave a trip; no effect in other states.

        Args:
            cause: Interlock that is active now, None for none.

        Raises:
            RefusedError: The cause is still there.
        """
        if self.state is not State.TRIPPED:
            return
        if cause is not None:
            raise RefusedError(f"cause is still there: {cause}", cause.kind)
        self.trip = None
        self.state = State.STANDBY if self.stopped else State.STOPPING

    def advance(
        self,
        tick: int,
        boost_voltage_V: float,
        *,
        unknown_rate: Trip | None = None,
        now_s: float = 0.0,
    ) -> None:
        """Move from `starting` to `running` at the floor of the boost voltage, and watch the hand.

        The first tick is always one of `starting`: it makes a controller that ran until just
        before begin anew.

        Args:
            tick: Present tick.
            boost_voltage_V: Boost voltage.
            unknown_rate: Why the drive's rate is not known, None once it is: then the precharge
                begins.
            now_s: Monotonic time, by which an unknown rate is awaited.
        """
        if self.state is _RUNNING and self.mode is _MANUAL:
            cause = self.manual.find_cause(tick)
            if cause is not None:
                self.latch(cause)
        if self.state is not _STARTING:
            return
        if not self._precharging:
            self._precharging, self._since_tick = unknown_rate is None, tick
            if unknown_rate is not None:
                self._await_rate(unknown_rate, now_s)
        elif self._limits.is_reached(boost_voltage_V):
            self.state = State.RUNNING
            self.manual = replace(self.manual, since_tick=tick)  # nobody could renew it meanwhile
            self.asked = self.asked.begun(tick)
        elif tick - self._since_tick > self._limits.starting_ticks:
            self.latch(self._limits.precharge_cause(boost_voltage_V))

    def _await_rate(self, unknown_rate: Trip, now_s: float) -> None:
        """Trip once the rate has been unknown for too long, or its operator may be lost."""
        self._awaited_s = min(self._awaited_s, now_s)
        waited_s, limit_s = now_s - self._awaited_s, self._limits.rate_s
        if self.mode is _MANUAL and self.manual.hold_s is not None:
            limit_s = min(limit_s, self.manual.hold_s)
        if waited_s > limit_s:
            text = f"frame rate: not known {waited_s:.3g} s after the start: {unknown_rate}"
            self.latch(Trip(unknown_rate.kind, text))

    def forget_reach(self) -> None:
        """Go by the nominal model again: what a run found may not hold in the next one."""
        self.reach = self._limits.reach

    def confirm_stop(self) -> None:
        """Note that the drive is off: a stop is complete."""
        self.stopped = not self.energised
        if self.state is State.STOPPING:
            self.state = State.STANDBY

    def withdraw_stop(self) -> None:
        """Note that the drive is not off: it is to be stopped."""
        self.stopped = False
        if self.state is State.STANDBY:
            self.state = State.STOPPING

    def latch(self, cause: Trip) -> None:
        """Trip; the first cause stays."""
        if self.state is not State.TRIPPED:
            self.state = State.TRIPPED
            self.trip = cause

    def _hold(self, setpoint: float) -> None:
        """Ask for a constant set-point, at once."""
        self.asked = AskedReference(setpoint)

    def _start(self) -> None:
        """Energise the drive, from the precharge on."""
        self.state, self.stopped = State.STARTING, False
        self._precharging = self._coasts = False
        self._awaited_s = math.inf

    def coast(self) -> None:
        """Hold the drive off until a set-point within reach."""
        self.state, self.stopped = State.RUNNING, False
        self._coasts = True

    def require_loop(self, what: str) -> None:
        """Refuse a set-point that nothing follows; `what` is its name in the refusal."""
        if not self.energised:
            raise RefusedError(f"{what} needs an enabled drive; state is {self.state}")
        if self.mode is Mode.MANUAL:
            raise RefusedError(f"{what} needs mode fixed or adaptive; mode is manual")
