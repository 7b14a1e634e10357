"""The power stage of a drive: capacitor, bridge, its own time-out and its own fault word.

Nothing of adaptdrive or its simulators is imported here: what the daemon and this drive agree on,
they agree on through the DBC, the register map and their manuals alone.
"""

from __future__ import annotations

import json
import math
import random
import signal
import sys
import time

from tests.peers.motor import Motor

LINE_V = 119.3
LINE_Hz = 59.94
CAPACITANCE_F = 1.05e-3
"""Neither of them is what the configuration says."""

HALF_CYCLE_s = 0.5 / LINE_Hz
OVERTEMPERATURE = 2
OVERVOLTAGE = 4
OVERVOLTAGE_V = 460.0
VOLTAGE_LAG_s = 0.03
BLEEDER_W = 6.0
POWER_MAX_W = 1800.0


class Drive:
    """A drive in front of a motor; it switches itself off where nobody commands it."""

    def __init__(self, tachometer_V: float, timeout_s: float) -> None:
        self.motor = Motor.at(tachometer_V)
        self.boost_V = math.sqrt(2.0) * LINE_V
        self.power_W = 0.0
        self.bridge = False
        self.fault = 0
        self.half_cycle = random.randrange(65536)
        self._timeout_s = timeout_s
        self._heard_s = -math.inf
        self._scale_S = self._reference_V = 0.0
        signal.signal(signal.SIGUSR1, lambda *_: self._break(OVERTEMPERATURE))
        signal.signal(signal.SIGUSR2, lambda *_: self._mend())

    def command(self, *, scale_S: float = 0.0, reference_V: float = 0.0, bridge: bool) -> None:
        """Take a valid command."""
        self._heard_s = time.monotonic()
        self._scale_S, self._reference_V = scale_S, reference_V
        self._switch(bridge and not self.fault, "command")

    def live(self) -> None:
        """Live for half a line cycle."""
        if time.monotonic() - self._heard_s > self._timeout_s:
            self._scale_S = self._reference_V = 0.0
            self._switch(False, "timeout")
        self.power_W = self.motor.turn(self.boost_V if self.bridge else 0.0, HALF_CYCLE_s)
        drawn_W = self.power_W + BLEEDER_W
        fed_W = self._fed_W(drawn_W)
        energy = self.boost_V**2 + 2.0 * (fed_W - drawn_W) * HALF_CYCLE_s / CAPACITANCE_F
        self.boost_V = max(math.sqrt(max(energy, 0.0)), math.sqrt(2.0) * LINE_V)
        if self.boost_V > OVERVOLTAGE_V and not self.fault & OVERVOLTAGE:
            self._break(OVERVOLTAGE)
        self.half_cycle = (self.half_cycle + 1) % 65536
        if self.half_cycle % 12 == 0:
            say("state", tachometer_V=self.motor.tachometer_V, boost_V=self.boost_V)

    def _fed_W(self, drawn_W: float) -> float:
        """The power taken from the line: by the command, or as the drive's own loop wants it."""
        if self.fault:
            return 0.0
        wanted_W = self._scale_S * LINE_V**2
        if self._reference_V:
            missing = self._reference_V**2 - self.boost_V**2
            wanted_W = drawn_W + 0.5 * CAPACITANCE_F * missing / VOLTAGE_LAG_s
        return min(max(0.0, wanted_W), POWER_MAX_W)

    def _break(self, bit: int) -> None:
        self.fault |= bit
        self._switch(False, "fault")

    def _mend(self) -> None:
        self.fault = 0

    def _switch(self, on: bool, why: str) -> None:
        if on is not self.bridge:
            self.bridge = on
            say("bridge", on=on, why=why, silent_s=time.monotonic() - self._heard_s)


def say(event: str, **values: object) -> None:
    """Write an event with its monotonic time, and which foreign code this process has loaded."""
    sys.stdout.write(json.dumps({"event": event, "at_s": time.monotonic(), **values}) + "\n")
    sys.stdout.flush()


def say_ready() -> None:
    """Write that the drive is there, and all that it is made of."""
    say("ready", modules=sorted(sys.modules))
