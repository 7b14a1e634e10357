"""The harness itself: a test that leaves a task behind fails, others do not."""

from __future__ import annotations

from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]
SETTINGS = f"""
[pytest]
pythonpath = {TESTS.parent}
asyncio_mode = auto
asyncio_default_fixture_loop_scope = function
"""
PREAMBLE = """
import asyncio
import pytest

async def for_ever():
    await asyncio.Event().wait()
"""
LEAKING = """
async def test_leak():
    test_leak.task = asyncio.create_task(for_ever(), name="forgotten")
"""
AWAITING = """
async def test_awaited():
    await asyncio.create_task(asyncio.sleep(0))
"""
CANCELLING = """
async def test_cancelled():
    task = asyncio.create_task(for_ever())
    await asyncio.sleep(0)
    task.cancel()
"""
BY_FIXTURE = """
@pytest.fixture
async def served():
    task = asyncio.create_task(for_ever())
    yield
    task.cancel()

async def test_fixture(served):
    await asyncio.sleep(0)
"""
SYNCHRONOUS = """
def test_without_loop():
    pass
"""


def run(pytester: pytest.Pytester, test: str) -> pytest.RunResult:
    pytester.makeini(SETTINGS)
    pytester.makeconftest((TESTS / "conftest.py").read_text())
    pytester.makepyfile(PREAMBLE + test)
    return pytester.runpytest_subprocess("-p", "no:cacheprovider")


def test_a_test_that_leaves_a_task_pending_fails(pytester: pytest.Pytester) -> None:
    result = run(pytester, LEAKING)
    result.assert_outcomes(passed=1, errors=1)
    result.stdout.fnmatch_lines(["*the test left tasks pending*", "*name='forgotten'*"])
    assert result.ret == pytest.ExitCode.TESTS_FAILED


@pytest.mark.parametrize(
    "test",
    [
        pytest.param(AWAITING, id="awaited"),
        pytest.param(CANCELLING, id="cancelled"),
        pytest.param(BY_FIXTURE, id="owned-by-a-fixture"),
        pytest.param(SYNCHRONOUS, id="synchronous"),
    ],
)
def test_a_test_that_cleans_up_passes(pytester: pytest.Pytester, test: str) -> None:
    run(pytester, test).assert_outcomes(passed=1)
