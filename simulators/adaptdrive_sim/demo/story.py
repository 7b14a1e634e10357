"""Stories as data, one file each, and the settings of a demonstration."""

import math
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from cyclopts import Parameter

from adaptdrive.cli.options import Integer
from adaptdrive.control.signals import Waveform
from adaptdrive.util.errors import AdaptdriveError, RefusedError
from adaptdrive_sim.parameters import example_tables

# Stories as data: one file each, which names what happens when, and the sentence about it.

FOLDER = Path(__file__).parent / "stories"


class Scene(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One turn of a story.

    Attributes:
        at_s: When it comes, since the story began.
        say: What to look at.
        mode: Controller to ask for; the one of before when left out.
        setpoint: A constant set-point; as above.
        waveform: A waveform instead of it.
        disturb: Request to the simulated device; `disks` is how many are to be on the shaft.
    """

    at_s: float
    say: str
    mode: str | None = None
    setpoint: float | None = None
    waveform: Waveform | None = None
    disturb: dict[str, float] | None = None


class Overshoot(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Sizes of the load by which the overshoots are shown.

    Attributes:
        of: The size in the truth of the simulator.
        sizes: Its values.
        names: A name for each.
        adaptive_at_most: Largest share of a step by which the adaptive controller may overshoot.
    """

    of: str
    sizes: list[float]
    names: list[str]
    adaptive_at_most: float = 1.0

    def index(self, size: object) -> int | None:
        """Return which of the sizes the load has, None for none of them."""
        if not isinstance(size, int | float):
            return None
        near = (k for k, one in enumerate(self.sizes) if abs(size - one) < 0.005 * one)
        return next(near, None)


class Value(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A value of the truth that is shown.

    Attributes:
        name: Its name for the viewer.
        of: Its name in the truth of the simulator.
        keep: The last value, the highest one, or the energy in J of a power while it was negative.
        unit: Unit, after the scale.
        scale: Factor.
        at_most: Largest value for which control has worked.
        at_least: Smallest one.
        from_s: Time of the story from which on these count.
    """

    name: str
    of: str
    keep: Literal["last", "highest", "returned"] = "last"
    unit: str = ""
    scale: float = 1.0
    at_most: float = math.inf
    at_least: float = -math.inf
    from_s: float = 0.0

    def fits(self, value: float) -> bool:
        """Return whether control has worked, as far as this value shows it."""
        return self.at_least <= value <= self.at_most


class Story(
    msgspec.Struct,
    frozen=True,
    forbid_unknown_fields=True,
    rename={"scenes": "scene", "values": "value"},
):
    """A load, and what happens to it.

    Attributes:
        about: What is seen, in one line.
        configuration: The example configuration that daemon and simulated drive read.
        noise: Standard deviation of each sample of the output.
        duration_s: How long it takes.
        window_s: Longest time that the plot shows.
        scenes: The first one begins it.
        speed: Times real time, None for real time with a process for each part.
        initial_voltage_V: Boost voltage at which the load rests at the begin, None for standstill.
        changes: Values that replace those of the configuration.
        drop: Disturbances that the key `d` sends, in turn.
        overshoot: Sizes for the table of overshoots.
        values: Values for the table in its place.
        complete: What to say when the load has what it needs.
        name: Name of the file.
    """

    about: str
    configuration: str
    noise: float
    duration_s: float
    window_s: float
    scenes: list[Scene]
    speed: float | None = None
    initial_voltage_V: float | None = None
    changes: dict[str, dict[str, Any]] = {}
    drop: list[dict[str, float]] = []
    overshoot: Overshoot | None = None
    values: list[Value] = []
    complete: str = ""
    name: str = ""

    def conditions(self, number: int) -> tuple[Scene, list[dict[str, float]]]:
        """Return what the scenes up to one have asked for, and how the load is then disturbed."""
        held, disturbances = self.scenes[number], dict[str, dict[str, float]]()
        for scene in self.scenes[: number + 1]:
            if scene.disturb is not None:
                disturbances[next(iter(scene.disturb))] = scene.disturb
        for scene in reversed(self.scenes[:number]):
            held = msgspec.structs.replace(held, mode=held.mode or scene.mode)
            if held.setpoint is None and held.waveform is None:
                wave, constant = scene.waveform, scene.setpoint
                held = msgspec.structs.replace(held, waveform=wave, setpoint=constant)
        return held, list(disturbances.values())

    def document(self) -> dict[str, Any]:
        """Return the configuration of the daemon, with the changes of this story."""
        found = example_tables(self.configuration)
        _change(found, self.changes)
        return found


def _change(tables: dict[str, Any], changes: dict[str, Any]) -> None:
    for name, value in changes.items():
        if isinstance(value, dict):
            _change(tables.setdefault(name, {}), value)
        else:
            tables[name] = value


def story_names() -> list[str]:
    """Return the names of all stories."""
    return sorted(path.stem for path in FOLDER.glob("*.toml"))


def read_story(name: str) -> Story:
    """Read a story.

    Raises:
        RefusedError: There is none of that name.
    """
    if name not in story_names():
        raise RefusedError(f"{name!r} is no story; there are {', '.join(story_names())}")
    document = tomllib.loads((FOLDER / f"{name}.toml").read_text(encoding="utf-8"))
    return msgspec.convert(document | {"name": name}, Story)


# Command-line settings of a demonstration.

SPEED_MAX = 1e6
"""Times real time: more than any machine reaches."""


class DemoError(AdaptdriveError):
    """The demonstration cannot continue; the message gives the reason."""


@Parameter(name="*")
@dataclass(frozen=True, slots=True)
class DemoSettings:
    """The options of `adaptdrive-sim demo`.

    Attributes:
        duration_s: Seconds of the story; the whole story when left out. The last scene of a story
            lasts until then.
        headless: Show nothing; print one line of JSON at the end.
        noise: Standard deviation of each sample of the output, in its unit; the story's own when
            left out.
        seed: Seed of the noise.
        directory: Folder for configuration, logs and sessions; a new one in build/demo when left
            out.
        speed: Times real time, for a story in virtual time.
    """

    duration_s: Annotated[float | None, Parameter(name="--duration")] = None
    headless: Annotated[bool, Parameter(negative=())] = False
    noise: float | None = None
    seed: Integer = 0
    directory: Path | None = None
    speed: float | None = None

    def check(self, *, virtual: bool) -> None:
        """Refuse what cannot be done.

        Args:
            virtual: Whether the story passes in virtual time.

        Raises:
            RefusedError: Which option, and why.
        """
        if self.duration_s is not None and not 1.0 <= self.duration_s < math.inf:
            raise RefusedError(f"--duration {self.duration_s:g} must be at least 1 second")
        if self.speed is not None and not 0.0 < self.speed <= SPEED_MAX:
            raise RefusedError(f"--speed {self.speed:g} must lie above 0, and up to 1e6")
        if self.noise is not None and not 0.0 <= self.noise <= 1.0:
            raise RefusedError(f"--noise {self.noise:g} must lie in 0…1")
        unused = "directory" if virtual else "speed"
        if getattr(self, unused) is not None:
            time = "virtual time, without processes" if virtual else "real time"
            raise RefusedError(f"--{unused}: this story passes in {time}")
