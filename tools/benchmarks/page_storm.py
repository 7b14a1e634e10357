"""Hostile payloads for the panel: 100,000 on the topics that it reads, in a real browser."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.support import MosquittoLauncher, free_port, stop_process
from tests.system.panel.browser import Panel, browser_of, open_panel, web_listener
from tools.benchmarks.rows import Extent, Row
from tools.benchmarks.storm import (
    EVIL,
    Storm,
    log_in,
    longest_block_ms,
    require_unhurt,
    show,
    storm,
)

SEEDS = range(40, 60)
EACH = 5000
PLACES = (EVIL, "", EVIL, "", EVIL)
"""The page of the drive and the list, in turn."""


def rows(extent: Extent) -> Iterator[Row]:
    """All rows of this file."""
    each, seeds = extent.pick((EACH, SEEDS), (100, SEEDS), (5, SEEDS[:2]))
    with browser_of("/usr/bin/chromium") as browser, _broker() as (address, port):
        blocks = []
        for seed in seeds:
            panel = open_panel(browser)
            log_in(panel, address)
            with storm(panel, port, seed) as blast:
                _blow(panel, blast, each)
            blocks.append(longest_block_ms(panel))
            panel.page.context.close()
    note = (
        f"seeds {seeds[0]} to {seeds[-1]}; errors of scripts, executed payloads, foreign elements"
    )
    yield Row("hostile payloads taken by the panel", each * len(seeds), "", note=note + ": none")
    blocks.sort()
    note = "longest time for which its loop stood, with the delivery of 50 payloads; median, worst"
    yield Row(
        "a panel among hostile payloads", blocks[-1], "ms", blocks[len(blocks) // 2], note=note
    )


def _blow(panel: Panel, blast: Storm, each: int) -> None:
    for place in PLACES:
        show(panel, place)
        blast.blow(each // len(PLACES))
        show(panel, place)
        require_unhurt(panel)


@contextlib.contextmanager
def _broker() -> Iterator[tuple[str, int]]:
    """A mosquitto that serves the panel: address of the page, and port for everybody else."""
    with TemporaryDirectory() as name:
        folder, web = Path(name), free_port(socket.SOCK_STREAM)
        launcher = MosquittoLauncher("/usr/sbin/mosquitto", folder, web_listener(folder, web))
        port = free_port(socket.SOCK_STREAM)
        started = launcher.start(port)
        try:
            yield f"http://127.0.0.1:{web}/index.html", port
        finally:
            stop_process(started)
