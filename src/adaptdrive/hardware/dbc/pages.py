"""The pages of a multiplexed message: which frames it is sent in, and what each of them carries.

A page is a choice of values of the multiplexers. A DBC may give a signal several of them
(`SG_MUL_VAL_`), and a page may have its own multiplexer, whose pages carry what it carries.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping

from cantools.database.can.message import Message
from cantools.database.can.signal import Signal

from adaptdrive.hardware.dbc.database import SignalCatalogue, is_word
from adaptdrive.hardware.link.layout import initial_value

Page = tuple[tuple[str, float], ...]
"""The multiplexers of a frame, outermost first, and their values."""


def page_of(catalogue: SignalCatalogue, message: Message, signal: Signal, place: str) -> Page:
    """Return the first page with a signal, empty if all frames have it.

    Args:
        catalogue: Takes the errors.
        message: The message.
        signal: One of its signals.
        place: Where the signal stands in the configuration.
    """
    return tuple(_selectors(catalogue, message, signal, place))


def sent_pages(pages: Iterable[Page]) -> list[Page]:
    """Return the pages that are sent: those of which no other is a part, a single one if all are.

    Args:
        pages: The pages that carry something; each occurs once.
    """
    known = [page for page in pages if page]
    return [page for page in known if not any(map(_is_part(page), known))] or [()]


def carried_signals(message: Message, chosen: Mapping[str, float]) -> frozenset[str]:
    """Return the names of the signals in a frame.

    Args:
        message: The message of the frame.
        chosen: Values of its multiplexers; the others have their initial value.
    """
    return frozenset(
        signal.name for signal in message.signals if _is_carried(message, signal, chosen)
    )


def absent_pages(message: Message, chosen: Mapping[str, float]) -> Iterator[tuple[str, float]]:
    """Yield the multiplexers in a frame whose value selects none of their pages, with that value.

    Args:
        message: The message of the frame.
        chosen: Values of its multiplexers; the others have their initial value.
    """
    for selector in message.signals:
        if selector.is_multiplexer and _is_carried(message, selector, chosen):
            value = _selected(selector, chosen)
            paged = [one for one in message.signals if one.multiplexer_signal == selector.name]
            if not any(value in (one.multiplexer_ids or ()) for one in paged):
                yield selector.name, value


def _is_part(page: Page) -> Callable[[Page], bool]:
    return lambda other: len(other) > len(page) and other[: len(page)] == page


def _is_carried(message: Message, signal: Signal, chosen: Mapping[str, float]) -> bool:
    if not signal.multiplexer_ids or signal.multiplexer_signal is None:
        return True
    selector = message.get_signal_by_name(signal.multiplexer_signal)
    value = _selected(selector, chosen)
    return value in signal.multiplexer_ids and _is_carried(message, selector, chosen)


def _selected(selector: Signal, chosen: Mapping[str, float]) -> float:
    return chosen.get(selector.name, initial_value(selector) or 0)


def _selectors(
    catalogue: SignalCatalogue, message: Message, signal: Signal, place: str
) -> Iterator[tuple[str, float]]:
    if not signal.multiplexer_ids or signal.multiplexer_signal is None:
        return
    selector = message.get_signal_by_name(signal.multiplexer_signal)
    yield from _selectors(catalogue, message, selector, place)
    if not is_word(selector):
        problem = f"its multiplexer {selector.name!r} has a factor or an offset"
        catalogue.note(place, problem)
    yield selector.name, float(signal.multiplexer_ids[0])
