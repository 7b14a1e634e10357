"""Libraries that belong to an extra of the package."""

from __future__ import annotations

import sys


class Extra:
    """Names the extra that a missing library belongs to, where one is imported."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __enter__(self) -> None:
        """Nothing to prepare."""

    def __exit__(self, _kind: object, problem: BaseException | None, _trace: object) -> None:
        if isinstance(problem, ModuleNotFoundError):
            advice = f"{problem.name} is missing: pip install 'adaptdrive[{self._name}]'"
            sys.exit(f"adaptdrive: {advice}")
