"""Contents of a campaign's file."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import Field, ValidationError, model_validator
from pydantic_core import ErrorDetails

from adaptdrive.errors import AdaptdriveError, reason_of
from adaptdrive_sim.campaign.life_settings import LifeRanges
from adaptdrive_sim.campaign.ranges import CampaignTable, Range, WholeRange, within
from adaptdrive_sim.campaign.reach import reach

MOST_RUNS = 10_000_000
FOLDER = Path(__file__).resolve().parent


class CampaignError(AdaptdriveError):
    """A campaign's file cannot be used."""

    def __init__(self, path: Path, problems: list[str]) -> None:
        self.path = path
        self.problems = problems
        super().__init__("\n".join(f"{path}: {problem}" for problem in problems))


class CampaignFile(CampaignTable):
    """Keys that the files of all loads have."""

    runs: int = Field(ge=1, le=MOST_RUNS)
    seed: int = Field(ge=0)


FileOfAnyType = TypeVar("FileOfAnyType", bound=CampaignFile)

ShapeName = Literal["square", "triangle", "sine"]


class LoadRanges(CampaignTable):
    """The motor: inertia in disks, the rest relative to the settings of the controller."""

    inertia: Annotated[Range, within(0.2, 10.0)]
    gain: Annotated[Range, within(0.56, 1.8)]
    filter: Annotated[Range, within(0.3, 3.0)]
    unchanged: float = Field(ge=0.0, le=1.0)
    changes: Annotated[WholeRange, within(1, 20)]
    change_min: float = Field(ge=1.0, le=10.0)
    quiet_s: float = Field(ge=0.0)


class ReferenceRanges(CampaignTable):
    """The set-point's waveform; it is moved into what V_c can hold with the drawn load.

    Attributes:
        low_above: What is drawn and added to `low`, in the unit of the output.
    """

    low: float = Field(ge=2.0, le=4.0)
    low_above: Annotated[Range, within(0.0, 2.0)] = (0.0, 0.0)
    step: Annotated[Range, within(1e-3, 1.0)]
    period_s: Annotated[Range, within(10.0, 1e4)]
    shapes: list[ShapeName] = Field(min_length=1)


class NoiseRanges(CampaignTable):
    """Measurement noise, as fractions of the step."""

    sigma: Annotated[Range, within(0.0, 1.0)]
    spike_share: Annotated[Range, within(0.0, 1.0)]
    spike_sigma: float = Field(ge=0.0, le=10.0)


class LineRanges(CampaignTable):
    """The ac line."""

    voltage: Annotated[Range, within(0.5, 1.1)]
    frequency_Hz: Annotated[Range, within(55.0, 65.0)]


class WireRanges(CampaignTable):
    """Resolution of what is measured and commanded, and the age of the output's samples."""

    output_delay_ticks: Annotated[WholeRange, within(0, 20)]
    output_V: Annotated[Range, within(0.0, 1.0)]
    voltage_V: Annotated[Range, within(0.0, 10.0)]
    power_W: Annotated[Range, within(0.0, 100.0)]
    scale_S: Annotated[Range, within(0.0, 0.01)]


class Campaign(CampaignFile):
    """A whole file."""

    type: Literal["motor"] = "motor"
    duration_s: float = Field(ge=120.0, le=1e6)
    load: LoadRanges
    reference: ReferenceRanges
    noise: NoiseRanges
    line: LineRanges
    wire: WireRanges
    life: LifeRanges = LifeRanges()

    @model_validator(mode="after")
    def _leave_room(self) -> Self:
        """Make sure that every drawn motor has set-points that V_c can hold."""
        life = self.life
        brake_V = life.torque_V[1] + life.coulomb_V[1]
        for gain in self.load.gain:
            least, most = reach(gain, brake_V, life.drag_V[1])
            if most <= least:
                taken = f"life takes {brake_V:g} V and a drag of {life.drag_V[1]:g} V"
                raise ValueError(f"load.gain = {gain:g}: V_c holds no set-point, {taken}")
        return self


def read_campaign(path: Path) -> Campaign:
    """Read a file of motors.

    Raises:
        CampaignError: It cannot be read, or a value is not allowed.
    """
    return read_campaign_of(path, {"motor": Campaign})


def read_campaign_of(path: Path, types: Mapping[str, type[FileOfAnyType]]) -> FileOfAnyType:
    """Read a file; a bare name that is no file is looked up among those that come along.

    Args:
        path: The file.
        types: The contents that its key `type` may name; without the key it is of motors.

    Raises:
        CampaignError: It cannot be read, or a value is not allowed.
    """
    shipped = FOLDER / path.name
    found = path if path.exists() or not shipped.exists() else shipped
    try:
        # strict validation takes arrays for tuples from JSON only
        tables = tomllib.loads(found.read_text(encoding="utf-8"))
        return _kind(path, tables, types).model_validate_json(json.dumps(tables))
    except OSError as problem:
        raise CampaignError(path, [reason_of(problem)]) from problem
    except UnicodeDecodeError as problem:
        reason = f"is not UTF-8 text: {problem.reason} at byte {problem.start}"
        raise CampaignError(path, [reason]) from problem
    except tomllib.TOMLDecodeError as problem:
        raise CampaignError(path, [str(problem)]) from problem
    except ValidationError as problem:
        raise CampaignError(path, [_described(error) for error in problem.errors()]) from problem


def _kind(
    path: Path, tables: dict[str, Any], types: Mapping[str, type[FileOfAnyType]]
) -> type[FileOfAnyType]:
    named = tables.get("type", "motor")
    if named not in types:
        raise CampaignError(path, [f"type = {named!r}: must be one of {', '.join(types)}"])
    return types[named]


def _described(error: ErrorDetails) -> str:
    place = ".".join(str(part) for part in error["loc"])
    if not place:
        return error["msg"]
    if error["type"] in {"missing", "extra_forbidden"}:
        return f"{place}: {error['msg']}"
    return f"{place} = {error['input']!r}: {error['msg']}"
