"""Plays a story: its clock, its scenes, and the way back after a trip or a pause."""

from collections.abc import Callable

import msgspec

from adaptdrive.control.signals import Waveform
from adaptdrive.mqtt import commands
from adaptdrive.tui.terminal import KeyCommand
from adaptdrive.util.errors import AdaptdriveError
from adaptdrive_sim.demo.stage import Stage
from adaptdrive_sim.demo.story import Scene

RUNNING_s = 30.0
NEAR_s = 60.0
SEEN_s = 3.0
"""Time until the state shows what was asked for."""

_NEAR = 0.15
"""Distance from the set-point, in steps of the wave, at which the wave may begin."""

_ATTEMPTS = 5
"""Attempts in a row to bring the drive to a scene."""

_LOOK_s = 0.1


class DemoError(AdaptdriveError):
    """The demonstration cannot continue; the message gives the reason."""


class Player:
    """Plays one story.

    Whoever else operates the drive takes precedence: once it is stopped, or follows another
    waveform, the story pauses.

    Attributes:
        say: What to look at.
        at_s: Time of the story.
        number: The present scene, counted from 0.
        duration_s: Time of the story at which it ends.
        paused: Whether the story is held.
        stage: Where it is played.
        help: Whether the viewer has asked for help.
    """

    def __init__(self, stage: Stage, duration_s: float | None) -> None:
        self.say = "The drive starts: its capacitor is charged."
        self.at_s = 0.0
        self.number = 0
        self.duration_s = stage.story.duration_s if duration_s is None else duration_s
        self.paused = False
        self.stage, self.help = stage, False
        self._story, self._record = stage.story, stage.record
        self._ready = False
        self._wave: Waveform | None = None
        self._wave_s = self._asked_s = 0.0
        self._drops = 0
        self._failures = 0
        self._repeated = -1
        self._farthest = 0.0

    @property
    def over(self) -> bool:
        """True once the story has ended."""
        return self.at_s >= self.duration_s or self._record.completed

    @property
    def position(self) -> str:
        """Present scene and time of the story."""
        scenes = len(self._story.scenes)
        held = " · paused" if self.paused else ""
        time = f"{_clock(self.at_s)} of {_clock(self.duration_s)}"
        return f"{time} · scene {self.number + 1} of {scenes}{held}"

    async def run(self) -> None:
        """Play until the story is over.

        Raises:
            DemoError: The drive cannot be brought to a scene.
        """
        while not self.over:
            if self._ready and self._record.trip:
                self._begin_again()
            if self.paused or self._ready:
                await self._pass_time()
            else:
                await self._try_to_prepare()
        self.say = self._story.complete if self._record.completed else self.say

    def toggle(self) -> None:
        """Pause the story, or continue it."""
        self.paused = not self.paused
        if self.paused:
            self.say = "The story is paused; the drive runs on. Space continues it."
        else:
            self._ready = self._ready and self._other_operator() == ""
            self.say = self._scene.say
            self._align(0.0)

    def hold(self, why: str) -> None:
        """Pause the story because somebody else operates the drive."""
        self.paused, self.say = True, f"{why} The story is paused; space continues it."

    def takes(self, key: str) -> KeyCommand | bool:
        """Act on a key of the story; return its disturbance, or whether it was such a key."""
        match key:
            case " ":
                self.toggle()
            case "?":
                self.help = not self.help
            case "d":
                return self.dropped() or True
            case "s" | "S":
                self.hold("The drive was stopped.")
                return False
        return key in " ?"

    def dropped(self) -> KeyCommand | None:
        """Return the next disturbance of the key `d`, which changes the load."""
        for _ in self._story.drop:
            self._drops += 1
            request = self._story.drop[self._drops % len(self._story.drop)]
            if (command := self._disturbance(request)) is not None:
                return command
        return None

    @property
    def _scene(self) -> Scene:
        return self._story.scenes[self.number]

    @property
    def _next_s(self) -> float:
        """Time until the story's next scene, or its end."""
        later = [scene.at_s for scene in self._story.scenes[self.number + 1 :]]
        return min([self.duration_s, *later]) - self.at_s

    async def _pass_time(self) -> None:
        before_s = self.stage.time_s
        await self.stage.wait(_LOOK_s if self.paused else self._next_s)
        if self.paused or not self._ready:
            return
        self.at_s += self.stage.time_s - before_s
        if why := self._other_operator():
            self.hold(why)
            return
        if self._next_s <= 0.0 and not self.over:
            self.number += 1
            self.say = self._scene.say
            await self._perform(self._scene)

    def _other_operator(self) -> str:
        """Return what somebody else has done to the drive, empty for nothing."""
        state = self._record.state
        if self.stage.time_s - self._asked_s < SEEN_s or self._record.completed:
            return ""
        if state.get("state") in {"standby", "stopping"}:
            return "The drive was stopped."
        wave = state.get("waveform") or {}
        ours = {} if self._wave is None else msgspec.to_builtins(self._wave)
        return "" if wave == ours else "Somebody else operates the drive."

    async def _perform(self, scene: Scene) -> None:
        """Do what a scene asks for; where that fails, its conditions are brought about later."""
        try:
            if scene.disturb is not None:
                await self._disturb(scene.disturb)
            await self._carry_out(scene)
        except DemoError:
            self._ready = not self._record.running

    def _begin_again(self) -> None:
        """Go back to the begin of the scene in which the drive has tripped, once for each."""
        self._ready = False
        cause = self._record.trip.partition(":")[0]
        self.say = f"The drive tripped ({cause}). It is reset, and the scene begins again."
        self._farthest = float("inf") if self._repeated == self.number else 0.5
        if self._repeated != self.number:
            self.at_s, self._repeated = self._scene.at_s, self.number

    async def _try_to_prepare(self) -> None:
        try:
            await self._prepare()
        except DemoError:
            self._failures += 1
            if self._failures == _ATTEMPTS:
                raise
            await self.stage.wait(_LOOK_s)
        else:
            self._ready, self._failures = True, 0

    async def _prepare(self) -> None:
        """Bring the drive to the conditions of the present scene, from whatever state it is in."""
        record = self._record
        held, disturbances = self._story.conditions(self.number)
        if record.trip:
            await self._until_reset()
        if not record.running:
            await self._order("enable")
            await self._until(lambda: record.running, RUNNING_s, "the drive does not run")
        if held.waveform is not None:
            await self._order("setpoint", held.waveform.low)
            await self._come_near(held.waveform)
        await self._carry_out(held)
        for request in disturbances:
            await self._disturb(request)
        self.say = self._scene.say

    async def _until_reset(self) -> None:
        """Reset as soon as the cause is gone and the drive has confirmed its stop."""
        end_s = self.stage.time_s + RUNNING_s
        while not (await self.stage.ask(KeyCommand("reset"))).accepted:
            await self._pause_a_moment(end_s, "the trip cannot be reset")
        await self._until(lambda: not self._record.trip, RUNNING_s, "the trip stays")

    async def _come_near(self, wave: Waveform) -> None:
        """Wait until the output is near the wave, or for so long that it never will be."""
        end_s = self.stage.time_s + NEAR_s
        room = _NEAR * (wave.high - wave.low)
        while abs(commands.number(self._record.fast.get("output")) - wave.low) > room:
            if self.stage.time_s > end_s:
                return
            await self._pause_a_moment(float("inf"), "")

    async def _disturb(self, request: dict[str, float]) -> None:
        if (command := self._disturbance(request)) is not None:
            await self._accepted(command)

    async def _carry_out(self, scene: Scene) -> None:
        if scene.mode is not None:
            await self._order("mode", scene.mode)
        if scene.setpoint is not None:
            await self._order("setpoint", scene.setpoint)
            self._wave = None
        if (wave := scene.waveform) is not None:
            await self._order("waveform", msgspec.to_builtins(wave))
            self._wave, self._wave_s = wave, self.stage.time_s
            self._record.halves.begin(wave.low)
            self._align(self._farthest)

    def _disturbance(self, request: dict[str, float]) -> KeyCommand | None:
        """Return a disturbance; of disks, how many are to be added to those on the shaft."""
        if "disks" in request:
            request = {"disks": int(request["disks"] - self._record.truth.get("disks", 1))}
            if not request["disks"]:
                return None
        text = ", ".join(f"{name} {value:g}" for name, value in request.items())
        return KeyCommand(text, disturbance=request)

    async def _order(self, verb: str, value: object = None) -> None:
        await self._accepted(KeyCommand(verb, value))
        self._asked_s = self.stage.time_s

    async def _accepted(self, command: KeyCommand) -> None:
        reply = await self.stage.ask(command)
        if not reply.accepted:
            raise DemoError(f"{command.text} was refused: {reply.reason}")

    def _align(self, farthest: float) -> None:
        """Set the clock to a time of the story at which the wave stands as it does now.

        Args:
            farthest: Periods by which the clock may be set forward, where it need not go back.
        """
        if self._wave is None:
            return
        period_s = self._wave.period_s
        began_s = next(s.at_s for s in self._story.scenes if s.waveform == self._wave)
        ahead_s = (self.at_s - began_s - (self.stage.time_s - self._wave_s)) % period_s
        forward_s = (period_s - ahead_s) % period_s
        forward = forward_s < farthest * period_s or self.at_s - ahead_s < began_s
        self.at_s += forward_s if forward else -ahead_s

    async def _until(self, condition: Callable[[], bool], longest_s: float, problem: str) -> None:
        end_s = self.stage.time_s + longest_s
        while not condition():
            await self._pause_a_moment(end_s, f"{problem} within {longest_s:g} s")

    async def _pause_a_moment(self, end_s: float, problem: str) -> None:
        if self.paused:
            raise DemoError("the story is paused")
        if self.stage.time_s > end_s:
            raise DemoError(problem)
        await self.stage.wait(_LOOK_s)


def _clock(time_s: float) -> str:
    minutes, seconds = divmod(int(time_s), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{seconds:02d}" if hours else f"{minutes}:{seconds:02d}"
