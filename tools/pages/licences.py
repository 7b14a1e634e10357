"""Under which licences the libraries come that adaptdrive uses, as their own metadata say.

`python -m tools.pages.licences docs/licences.md` writes the page; a test keeps it true.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

PACKED = frozenset({"canopen"})
OPTIONAL = frozenset({"sim", "cluster", "identify", "analysis", "export"})

_HEAD = """# Licences

For those who pass adaptdrive on: the licence of each library, from its metadata. adaptdrive itself
is under the [MIT licence](../LICENSE). The Debian package holds the full texts in
`/opt/adaptdrive/lib/python3*/site-packages/*.dist-info`, or else in
`/usr/share/doc/adaptdrive/copyright`; each library is unmodified, so that another version can
replace it.
"""
_SECTIONS = (
    ("In the Debian package", PACKED),
    ("For simulation and clusters", OPTIONAL),
)
_CLASSIFIER = "License :: OSI Approved :: "


def page() -> str:
    """The whole page."""
    parts, listed = [_HEAD], {"adaptdrive"}
    for title, extras in _SECTIONS:
        names = sorted(closure("adaptdrive", extras) - listed)
        listed |= set(names)
        rows = [f"| {words} | {libraries} |" for words, libraries in sorted(_grouped(names))]
        parts.append("\n".join([f"## {title}\n", "| licence | libraries |", "|---|---|", *rows]))
    return "\n\n".join(part.strip() for part in parts) + "\n"


def _grouped(names: Iterable[str]) -> Iterator[tuple[str, str]]:
    """Yield each licence with its libraries and their versions."""
    found: dict[str, list[str]] = {}
    for name in names:
        found.setdefault(licence(name), []).append(f"{name}={distribution(name).version}")
    for words, libraries in found.items():
        yield words, ", ".join(libraries)


def closure(name: str, extras: frozenset[str]) -> set[str]:
    """A distribution and everything that it needs, by canonical name.

    Args:
        name: The distribution.
        extras: Optional parts of it that are wanted.
    """
    found: set[str] = set()
    waiting: list[tuple[str, frozenset[str]]] = [(canonicalize_name(name), extras)]
    while waiting:
        name, extras = waiting.pop()
        found.add(name)
        wanted = _needs(distribution(name), extras)
        waiting += [(need, more) for need, more in wanted if need not in found or more]
    return found


def _needs(wanting: Distribution, extras: frozenset[str]) -> Iterator[tuple[str, frozenset[str]]]:
    """What a distribution needs on this machine, as far as it is installed."""
    for text in wanting.requires or ():
        need = Requirement(text)
        marker = need.marker
        if marker and not any(marker.evaluate({"extra": extra}) for extra in ("", *extras)):
            continue
        try:
            distribution(need.name)
        except PackageNotFoundError:
            continue
        yield canonicalize_name(need.name), frozenset(need.extras)


def licence(name: str) -> str:
    """The licence of an installed distribution, in the words of its metadata.

    Raises:
        LookupError: They do not name one.
    """
    metadata = distribution(name).metadata
    if "License-Expression" in metadata:
        return str(metadata["License-Expression"])
    named = [text for text in metadata.get_all("Classifier") or () if text.startswith(_CLASSIFIER)]
    if named:
        return ", ".join(text.removeprefix(_CLASSIFIER) for text in named)
    if "License" in metadata:
        return str(metadata["License"]).strip().partition("\n")[0]
    raise LookupError(f"{name} does not say under which licence it comes")


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(page(), encoding="utf-8")
