"""What all sections share: keys, their limits, and units."""

import ast
import inspect
import itertools
import math
import operator
import re
import sys
import tomllib
import unicodedata
from collections.abc import Callable, Iterator
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    ValidationError,
    ValidationInfo,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError

from adaptdrive.util.clock import check_host
from adaptdrive.util.errors import Flaw

# Base class of all sections of the configuration.

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


Host = Annotated[str, AfterValidator(check_host)]
"""A name or an address."""


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


def misfit(place: str, given: float, relation: str, limit: float, described: str) -> Iterator[Flaw]:
    """Yield that a value is on the wrong side of its limit, by more than rounding.

    Args:
        place: Its place.
        given: The value.
        relation: What it must be: above, below, at least or at most.
        limit: The limit.
        described: What the limit is.
    """
    equal = relation.startswith("at") and math.isclose(given, limit)
    if not equal and not _RELATIONS[relation](given, limit):
        yield Flaw(place, f"{given} must be {relation} {described}")


class Section(BaseModel):
    """One table of the configuration file: immutable, and unknown keys are errors.

    Types are those of TOML: neither `"1883"` nor `true` is a number. The text below a key is its
    meaning in `docs/configuration.md` and in the JSON Schema; it holds for the classes below, too.
    """

    rising: ClassVar[tuple[str, ...]] = ()
    """Keys whose values rise in this order."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False, defer_build=True
    )

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """Add the meaning of each key."""
        schema = handler(core_schema)
        keys, meanings = handler.resolve_ref_schema(schema)["properties"], meanings_of(cls)
        for name in keys.keys() & meanings.keys():
            keys[name]["description"] = meanings[name]
        return schema

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


def meanings_of(section: type[Section]) -> dict[str, str]:
    """Return the meaning of each key of a section by name."""
    found: dict[str, str] = {}
    for base in reversed(section.__mro__):
        if issubclass(base, Section):
            found |= _texts_below_keys(base.__module__).get(base.__name__, {})
    return found


@cache
def _texts_below_keys(module: str) -> dict[str, dict[str, str]]:
    """Return the text below each key of each class; it is read only where somebody asks for it."""
    found: dict[str, dict[str, str]] = {}
    for node in ast.parse(inspect.getsource(sys.modules[module])).body:
        if isinstance(node, ast.ClassDef):
            found[node.name] = {
                ast.unparse(one.target): " ".join(ast.literal_eval(below.value).split())
                for one, below in itertools.pairwise(node.body)
                if isinstance(one, ast.AnnAssign) and isinstance(below, ast.Expr)
            }
    return found


class Range(Section):
    """`[bus.ranges]` and `[bus.registers.NAME.range]`: what a value may be, both ends included.

    That of a CAN signal is in place of the range of the DBC.
    """

    rising: ClassVar = ("low", "high")

    low: FiniteFloat
    """lower end"""
    high: FiniteFloat
    """upper end"""


# Units that a signal may be in, and what they are in SI.

Unit = Literal[
    "V", "A", "W", "K", "rad/s", "mV", "kV", "mA", "kA", "kW", "degC", "degF", "rpm", "Hz"
]

_SI: dict[str, dict[str, tuple[float, float]]] = {
    "V": {"V": (1.0, 0.0), "mV": (1e-3, 0.0), "kV": (1e3, 0.0)},
    "A": {"A": (1.0, 0.0), "mA": (1e-3, 0.0), "kA": (1e3, 0.0)},
    "W": {"W": (1.0, 0.0), "kW": (1e3, 0.0)},
    "K": {"K": (1.0, 0.0), "degC": (1.0, 273.15), "degF": (5.0 / 9.0, 459.67 * 5.0 / 9.0)},
    "rad/s": {"rad/s": (1.0, 0.0), "rpm": (math.pi / 30.0, 0.0), "Hz": (2.0 * math.pi, 0.0)},
}
"""Factor and zero of each unit, by the SI unit that they lead to."""

_IN_SI = {unit: pair for units in _SI.values() for unit, pair in units.items()}
_DIMENSIONS = {"mW": "W", **{unit: si for si, units in _SI.items() for unit in units}}

WANTED = {
    "boost_voltage_V": "V",
    "line_voltage_V": "V",
    "load_power_W": "W",
    "boost_reference_V": "V",
    "current_scale_S": "S",
}
"""Units of the quantities that have the same one for every load."""

_SPELLINGS: dict[str, list[str]] = tomllib.loads(
    (resources.files("adaptdrive.config") / "units.toml").read_text(encoding="utf-8")
)

_MULTIPLE = re.compile(r"(\d*\.?\d+)\s*(?:\*\s*)?(?=[^\d\s/.*])")
"""Factor before a unit, such as 0.1 in 0.1 V."""


def _folded(written: str) -> str:
    return re.sub(r"[\s_]", "", unicodedata.normalize("NFKC", written)).casefold()


_EXACT = {spelling: unit for unit, spellings in _SPELLINGS.items() for spelling in spellings}
_FOLDED = {_folded(spelling): unit for spelling, unit in reversed(_EXACT.items())}
_AMBIGUOUS = frozenset({"s", "mw"})
"""Units of which case decides: second and siemens, milliwatt and megawatt."""


def known_unit(written: str) -> str | None:
    """Return the unit that a description names, None for an unknown one.

    Args:
        written: The unit in any common spelling.
    """
    exact = _EXACT.get(written.strip())
    folded = _folded(written)
    return exact or (None if folded in _AMBIGUOUS else _FOLDED.get(folded))


def same_unit(one: str, other: str) -> bool:
    """Return whether two spellings name the same unit."""
    return one == other or known_unit(one) == (known_unit(other) or other)


def multiple_of(written: str) -> tuple[float, str]:
    """Return the factor that stands before a unit, 1 for none, and the unit."""
    found = _MULTIPLE.match(written.strip())
    if found is None or not float(found[1]):
        return 1.0, written.strip()
    return float(found[1]), written.strip()[found.end() :]


class Converted(Section):
    """Conversion of a value to a quantity; scale and offset lead to `unit`, which leads to SI."""

    scale: Scale = 1.0
    """units per unit of the value"""
    offset: FiniteFloat = 0.0
    """added to the scaled value"""
    unit: Unit | None = None
    """unit after scale and offset, converted to SI (K, rad/s, V, A, W); SI when left out"""

    @model_validator(mode="after")
    def _in_si(self) -> Self:
        """Let scale and offset lead to SI; those of the file lead to its `unit`."""
        factor, zero = _IN_SI.get(self.unit or "", (1.0, 0.0))
        self.__dict__.update(scale=factor * self.scale, offset=factor * self.offset + zero)
        return self


def si_unit(unit: str) -> str | None:
    """Return the SI unit of a quantity in a given unit, None for an unknown unit."""
    return _DIMENSIONS.get(unit)


def from_si(unit: str, si: str) -> tuple[float, float] | None:
    """Return the factor and the zero that lead from an SI unit to another one.

    Args:
        unit: The other unit, in any common spelling.
        si: The SI unit.

    Returns:
        None where one does not lead to the other, or is unknown.
    """
    pair = _SI.get(known_unit(si) or "", {}).get(known_unit(unit) or "")
    return None if pair is None else (1.0 / pair[0], -pair[1] / pair[0])


def unit_problem(source: Converted, found: str, wanted: str) -> str | None:
    """Return why a signal is not in the unit of its quantity, None where it may be.

    Args:
        source: Its conversion; nothing is checked where the file gives a scale or an offset.
        found: Unit that the DBC or the register map names.
        wanted: Unit of the quantity.
    """
    factor, alone = multiple_of(found)
    is_in, to_be = known_unit(alone), known_unit(wanted)
    if source.unit is not None:
        plain = (source.scale, source.offset) == _IN_SI[source.unit]
        denied = plain and is_in not in (None, source.unit)
        problem = f"the signal is in {is_in}, and unit = {source.unit!r} says otherwise"
        return stated_problem(source, wanted) or (problem if denied else None)
    scaled = not source.model_fields_set.isdisjoint({"scale", "offset"})
    if scaled or is_in is None or to_be is None or (is_in == to_be and factor == 1.0):
        return None
    if is_in == to_be:
        return f"the signal is in {found.strip()}: scale = {factor:g} leads to {wanted}"
    problem = f"the signal is in {found.strip()}, the quantity in {wanted}"
    if _DIMENSIONS.get(is_in) != _DIMENSIONS.get(to_be, ""):
        return f"{problem}: name another signal, or the scale that leads from one to the other"
    if is_in in _IN_SI and _DIMENSIONS[is_in] == to_be:
        return f"{problem}: unit = {is_in!r} converts it, scale = 1.0 takes it as it stands"
    return f"{problem}: give its scale"


def unit_caution(source: Converted, found: str) -> str | None:
    """Return that nobody knows the unit of a signal, None where it is known or converted.

    Args:
        source: Its conversion.
        found: Unit that the description names, empty for none.
    """
    stated = source.unit or not source.model_fields_set.isdisjoint({"scale", "offset"})
    if stated or not found.strip() or known_unit(multiple_of(found)[1]):
        return None
    return f"the unit {found.strip()!r} is not known: the value is taken as it stands"


def stated_problem(source: Converted, wanted: str) -> str | None:
    """Return why the `unit` of a source does not lead to its quantity, None where it may.

    Args:
        source: Its conversion, which leads to SI where it has a unit.
        wanted: Unit of the quantity; nothing is checked where it is unknown.
    """
    to_be = known_unit(wanted)
    if source.unit is None or to_be is None or to_be == _DIMENSIONS[source.unit]:
        return None
    leads_to = _DIMENSIONS[source.unit]
    problem = f"unit = {source.unit!r} leads to {leads_to}, the quantity is in {to_be}"
    if _DIMENSIONS.get(to_be) != leads_to:
        return problem
    return f"{problem}: load.output_unit = {leads_to!r}, with set-points and limits in {leads_to}"
