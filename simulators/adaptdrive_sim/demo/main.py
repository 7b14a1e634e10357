"""`adaptdrive-sim demo`: runs one demonstration and prints its outcome."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from adaptdrive.errors import AdaptdriveError
from adaptdrive_sim.demo.processes import ProcessDiedError
from adaptdrive_sim.demo.settings import DemoSettings
from adaptdrive_sim.demo.show import choose_show, operator_program
from adaptdrive_sim.demo.stage import perform
from adaptdrive_sim.demo.summary import one_line


def run_demo(settings: DemoSettings) -> int:
    """Run a demonstration and print its summary.

    Args:
        settings: What is wanted; without a terminal it is headless anyway.

    Returns:
        0 when control worked, 1 when it failed.

    Raises:
        AdaptdriveError: It could not begin.
    """
    settings.check()
    settings = replace(settings, headless=settings.headless or not sys.stdout.isatty())
    outcome = asyncio.run(perform(settings, choose_show(settings)))
    summary = outcome.summary
    text = one_line(summary) if settings.headless else "\n".join(_lines(summary))
    sys.stdout.write(text + "\n")
    if not summary["ok"]:
        sys.stderr.write("\n".join(_complaint(summary, outcome.failure)) + "\n")
    return 0 if summary["ok"] else 1


def _complaint(summary: dict[str, Any], failure: AdaptdriveError | None) -> Iterator[str]:
    yield f"adaptdrive-sim: {summary['reason']}"
    if isinstance(failure, ProcessDiedError):
        yield from (f"  {line}" for line in failure.tail)


def _lines(summary: dict[str, Any]) -> Iterator[str]:
    verdict = "control worked" if summary["ok"] else "control failed"
    yield f"{summary['demo']} demo: {verdict} for {summary['duration_s']:.0f} s"
    yield f"  bus        {summary['bus']}, broker {summary['broker']}"
    yield f"  ticks      {summary['ticks']}, missed {summary['missed']}, held {summary['held']}"
    if summary["lateness_us"] is not None:
        yield f"  lateness   {_lateness(summary['lateness_us'])}"
    if summary["tracking_error_rms"] is not None:
        error = 100.0 * summary["tracking_error_rms"]
        yield f"  tracking   {error:.1f} % of a step (rms) from the ideal response"
    for controller, found in summary["overshoot"].items():
        if found:
            yield f"  overshoot  {controller}: {_overshoots(found)}"
    yield f"  kept in    {_short(summary['directory'])}"
    if summary["session"]:
        yield f"  try        {operator_program()} replay {_short(summary['session'])}"


def _lateness(lateness_us: dict[str, float]) -> str:
    times = ", ".join(f"{name} {time / 1e3:.2f} ms" for name, time in lateness_us.items())
    return f"of a tick: {times}"


def _overshoots(found: dict[str, float]) -> str:
    return ", ".join(
        f"{100.0 * share:.1f} % with {disks} disk{'s' if disks != '1' else ''}"
        for disks, share in found.items()
    )


def _short(path: str) -> str:
    here = Path.cwd()
    return str(Path(path).relative_to(here)) if Path(path).is_relative_to(here) else path
