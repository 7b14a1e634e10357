"""Base class of all sections of the configuration."""

from __future__ import annotations

import itertools
import math
import operator
import tomllib
from collections import ChainMap
from collections.abc import Callable, Iterator
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    model_validator,
)
from pydantic_core import InitErrorDetails, PydanticCustomError

from adaptdrive.util.errors import Flaw

PositiveFloat = Annotated[float, Field(gt=0, allow_inf_nan=False)]
FiniteFloat = Annotated[float, Field(allow_inf_nan=False)]
NonNegativeFloat = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Duration = Annotated[float, Field(ge=0, le=86_400.0, allow_inf_nan=False)]
"""A time of supervision: what lasts longer than a day would be as good as never, which is 0."""
Fraction = Annotated[float, Field(gt=0, lt=1)]


def _scaling(factor: float) -> float:
    if factor == 0.0:
        raise ValueError("must not be 0")
    return factor


Scale = Annotated[FiniteFloat, AfterValidator(_scaling)]
"""A factor; 0 would make all values equal."""


def _named(path: object) -> object:
    if path == "":  # it would be taken for a folder, that of the configuration
        raise ValueError("must not be empty")
    return path


def _anchored(path: Path, info: ValidationInfo) -> Path:
    return path if info.context is None else info.context / path


FilePath = Annotated[  # TOML has no paths, only strings
    Path,
    Field(strict=False),
    BeforeValidator(_named, json_schema_input_type=Path),
    AfterValidator(_anchored),
]
"""A path from the folder of the configuration, which is the context of the validation."""


def read_table(name: str) -> dict[str, Any]:
    """Return a table of this package.

    Args:
        name: Name of its file.
    """
    text = (resources.files("adaptdrive.config") / name).read_text(encoding="utf-8")
    return tomllib.loads(text)


_MEANINGS: dict[str, dict[str, str]] = read_table("keys.toml")
"""Meaning of each key by the class of its section; that of a base class holds for all below."""


def key(default: Any, **rules: Any) -> Any:  # noqa: ANN401 - as pydantic's own
    """Return a key that may be left out.

    Args:
        default: Its value then.
        rules: As pydantic's `Field` takes them; `span` has the lowest and the highest value.
    """
    if "span" in rules:
        rules["ge"], rules["le"] = rules.pop("span")
    return Field(default=default, **rules)


_RELATIONS: dict[str, Callable[[float, float], bool]] = {
    "above": operator.gt,
    "below": operator.lt,
    "at least": operator.ge,
    "at most": operator.le,
}


def misfit(place: str, given: float, relation: str, limit: float, told: str) -> Iterator[Flaw]:
    """Yield that a value is on the wrong side of its limit, by more than rounding.

    Args:
        place: Its place.
        given: The value.
        relation: What it must be: above, below, at least or at most.
        limit: The limit.
        told: What the limit is.
    """
    equal = relation.startswith("at") and math.isclose(given, limit)
    if not equal and not _RELATIONS[relation](given, limit):
        yield Flaw(place, f"{given} must be {relation} {told}")


class Section(BaseModel):
    """One table of the configuration file: immutable, and unknown keys are errors.

    Types are those of TOML: neither `"1883"` nor `true` is a number. `keys.toml` describes the
    keys.
    """

    rising: ClassVar[tuple[str, ...]] = ()
    """Keys whose values rise in this order."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False, defer_build=True
    )

    @classmethod
    def __pydantic_init_subclass__(cls, **_: object) -> None:
        """Give each key its meaning."""
        meanings = ChainMap(*(_MEANINGS.get(base.__name__, {}) for base in cls.__mro__))
        for name, field in cls.model_fields.items():
            field.description = meanings.get(name)

    def flaws(self) -> Iterator[Flaw]:
        """Yield contradictions of keys that are valid one by one; places are relative."""
        for low, high in itertools.pairwise(self.rising):
            below, above = getattr(self, low), getattr(self, high)
            if below >= above:
                yield Flaw("", f"{low} = {below} must be below {high} = {above}")

    @model_validator(mode="after")
    def _is_consistent(self) -> Self:
        details = [
            InitErrorDetails(
                type=PydanticCustomError("inconsistent", "{message}", {"message": flaw.message}),
                loc=tuple(flaw.place.split(".")) if flaw.place else (),
                input=None,
            )
            for flaw in self.flaws()
        ]
        if details:
            raise ValidationError.from_exception_data("configuration", details)
        return self


class Range(Section):
    """A closed interval."""

    rising: ClassVar = ("low", "high")

    low: FiniteFloat
    high: FiniteFloat
