"""`adaptdrive explain`: what the kinds of trips mean, and what ends each."""

from dataclasses import asdict

from adaptdrive.cli.options import Json, print_each, print_json
from adaptdrive.safety.trips import ADVICES, Advice, TripKind, kind_of
from adaptdrive.util.errors import ConfigurationError, nearest

_WIDTH = max(len(kind) for kind in TripKind)


def explain(kind: str | None = None, /, *, as_json: Json = False) -> int:
    """Explain a kind of trip: its cause, a text of it, and what ends it.

    Args:
        kind: The word in brackets behind a trip; all kinds are listed when left out.
        as_json: Print JSON, for programs.

    Raises:
        ConfigurationError: There is no such kind.
    """
    if kind is None:
        known = ADVICES.items()
        rows = ((f"{one:<{_WIDTH}}  {_plain(it.cause)}", _content(one, it)) for one, it in known)
        print_each(rows, as_json)
        return 0
    found = kind_of(kind)
    if found is None:
        hint = nearest(kind, [one.value for one in TripKind]) or "; `adaptdrive explain` lists all"
        raise ConfigurationError.of("explain", kind, f"no trip is of this kind{hint}")
    content = _content(found, ADVICES[found])
    if as_json:
        print_json(content)
    else:
        print("\n".join(f"{name:<8} {text}" for name, text in content.items()))
    return 0


def with_kind(text: str, kind: object) -> str:
    """Return a text about a trip with its kind behind it, which `adaptdrive explain` takes.

    Args:
        text: The trip, or its remedy.
        kind: Its kind; nothing is added where it is not known.
    """
    return f"{text}  [{kind}]" if kind else text


def _content(kind: TripKind, advice: Advice) -> dict[str, str]:
    """Return the kind and its advice, in the order in which they are printed."""
    order = ("cause", "example", "remedy", "page")
    texts = asdict(advice)
    return {"kind": kind.value} | {name: _plain(texts[name]) for name in order}


def _plain(text: str) -> str:
    return text.replace("`", "")
