"""Plays the demonstration: commands to the daemon, disks for the simulated shaft."""

from __future__ import annotations

import asyncio
import functools
from collections.abc import Callable
from contextlib import suppress

from adaptdrive.config.services import Mqtt
from adaptdrive.control.waveform import Shape, Waveform
from adaptdrive.operation.conversation import NoAnswerError
from adaptdrive.operation.sender import send_command
from adaptdrive_sim.demo.record import DemoRecord
from adaptdrive_sim.demo.script import BEGINNING, Act, acts
from adaptdrive_sim.demo.settings import DRIVE, HIGH_V, LOW_V, DemoError, DemoSettings
from adaptdrive_sim.request_client import ask

START_s = 30.0
RUNNING_s = 10.0
NEAR_V = 0.03
NEAR_REPORTS = 20
NEAR_s = 60.0
LEAD_s = 3.0
"""Time of an act before the next step of the reference."""

_LOOK_s = 0.1
_ANSWER_s = 5.0


class Director:
    """Plays one demonstration until cancelled.

    Commands of other clients take precedence: once the mode or the wave is not the director's, it
    commands no more.

    Attributes:
        started: Set when the drive is under control.
    """

    def __init__(self, settings: DemoSettings, broker: Mqtt, record: DemoRecord) -> None:
        """Prepare the play.

        Args:
            settings: What to play.
            broker: Where drive and simulator are reached.
            record: What is heard of them; captions are written into it.
        """
        self.started = asyncio.Event()
        self._settings = settings
        self._broker = broker
        self._record = record
        self._mode = "fixed"
        self._wave: Waveform | None = None
        self._first_edge = 0
        self._wave_began_s = 0.0

    async def run(self) -> None:
        """Start the drive and play.

        Raises:
            DemoError: The drive does not start.
            NoAnswerError: The daemon does not answer at the start.
        """
        await self._start()
        await self._order("setpoint", LOW_V)
        if self._settings.mode == "adaptive":
            await self._order("mode", "adaptive")
            self._mode = "adaptive"
        await self._approach()
        await self._begin_wave()
        await self._play()

    async def _start(self) -> None:
        record = self._record
        record.caption = "Daemon and simulated drive are starting."
        await _until_late(lambda: record.online, START_s, "the daemon did not come online")
        await _until_late(
            lambda: record.drive_seen, START_s, "the daemon received no frame of the drive"
        )
        record.caption = "The drive is enabled and precharges its boost capacitor."
        await self._order("enable", None)
        await _until_late(
            lambda: record.first is not None, RUNNING_s, "the drive did not reach running"
        )
        self.started.set()

    async def _approach(self) -> None:
        """Wait until the speed is near its set-point, or for so long that it never will be."""
        self._record.caption = f"The motor is brought to {LOW_V:g} tachometer volts."
        with suppress(DemoError):
            await _until_late(self._near, NEAR_s, "")

    def _near(self) -> bool:
        trace = self._record.trace
        latest = (trace[-1 - i] for i in range(min(NEAR_REPORTS, len(trace))))
        return len(trace) >= NEAR_REPORTS and all(
            abs(point.output - LOW_V) < NEAR_V for point in latest
        )

    async def _begin_wave(self) -> None:
        self._first_edge = self._record.halves.edges
        self._wave_began_s = self._record.clock()
        if not self._settings.steady:
            wave = Waveform(Shape.SQUARE, LOW_V, HIGH_V, self._settings.period_s)
            value = {"shape": "square", "low": LOW_V, "high": HIGH_V, "period_s": wave.period_s}
            await self._order("waveform", value)
            self._wave = wave
        self._record.caption = BEGINNING if self._mode == "fixed" else "One disk turns."

    async def _play(self) -> None:
        for act in acts(self._settings.mode, disks=self._settings.disks):
            await _until(functools.partial(self._due, act))
            await self._perform(act)
        await asyncio.Event().wait()

    def _due(self, act: Act) -> bool:
        half, elapsed_s = self._position()
        near_end = elapsed_s >= 0.5 * self._settings.period_s - LEAD_s
        return half > act.half or (half == act.half and near_end)

    def _position(self) -> tuple[int, float]:
        """The present half wave, counted from 0, and the time since it began."""
        record = self._record
        if self._settings.steady:
            half_s = 0.5 * self._settings.period_s
            half, elapsed_s = divmod(record.clock() - self._wave_began_s, half_s)
            return int(half), elapsed_s
        return record.halves.edges - self._first_edge - 1, float(record.halves.periods)

    async def _perform(self, act: Act) -> None:
        """Carry out an act, unless another client operates the drive."""
        state = self._record.state
        if state is None or not self._record.running or state.waveform != self._wave:
            self._record.caption = "Another client operates the drive: the demonstration has ended."
            return
        with suppress(NoAnswerError):
            await self._set_disks(act.disks)
            if act.mode is not None and state.mode == self._mode:
                await self._order("mode", act.mode)
                self._mode = act.mode
            self._record.caption = act.caption

    async def _set_disks(self, disks: int) -> None:
        truth = self._record.truth
        if truth is not None and truth.disks != disks:
            await ask(self._broker, DRIVE, {"disks": disks - truth.disks})

    async def _order(self, verb: str, value: object) -> None:
        reply = await send_command(self._broker, DRIVE, verb, value, _ANSWER_s)
        if not reply.accepted:
            raise DemoError(f"the drive refused {verb}: {reply.reason}")


async def _until(condition: Callable[[], bool]) -> None:
    while not condition():  # noqa: ASYNC110 - what is heard comes ten times a second anyway
        await asyncio.sleep(_LOOK_s)


async def _until_late(condition: Callable[[], bool], timeout_s: float, problem: str) -> None:
    try:
        async with asyncio.timeout(timeout_s):
            await _until(condition)
    except TimeoutError as late:
        raise DemoError(f"{problem} within {timeout_s:g} s") from late
