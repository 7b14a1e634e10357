"""The frame of the tests itself: who leaves a task behind, or reaches outside, fails."""

from __future__ import annotations

from pathlib import Path

import pytest

TESTS = Path(__file__).parents[3]
SETTINGS = f"""
[pytest]
pythonpath = {TESTS.parent}
asyncio_mode = auto
asyncio_default_fixture_loop_scope = function
markers =
    unit: by conftest.py
    integration: by conftest.py
"""
PREAMBLE = """
import asyncio, contextlib, os, socket, subprocess, sys, time
import pytest

ADDRESS = ("127.0.0.1", 9)

async def for_ever():
    await asyncio.Event().wait()
"""
LEAKING = """
async def test_leak():
    test_leak.task = asyncio.create_task(for_ever(), name="forgotten")
"""
TIDY = """
@pytest.fixture
async def served():
    task = asyncio.create_task(for_ever())
    yield
    task.cancel()

async def test_owned_by_a_fixture(served):
    await asyncio.create_task(asyncio.sleep(3600.0))

async def test_cancelled():
    task = asyncio.create_task(for_ever())
    await asyncio.sleep(0)
    task.cancel()

def test_synchronous():
    ours, theirs = socket.socketpair()
    ours.close(), theirs.close()
"""
REACHING = """
def test_connects():
    with contextlib.suppress(Exception), socket.socket(type=socket.SOCK_DGRAM) as one:
        one.connect(ADDRESS)

def test_swallows_the_failure():
    with contextlib.suppress(BaseException), socket.socket(type=socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))

def test_starts():
    subprocess.run([sys.executable, "-c", ""])

def test_forks():
    os.fork() or os._exit(0)

def test_sleeps():
    time.sleep(0.0)
"""
ALLOWED = """
@pytest.fixture
def site(outside):
    return "a site"

def test_by_a_fixture_of_a_fixture(site, request):
    subprocess.run([sys.executable, "-c", ""], check=True)
    assert request.node.get_closest_marker("integration")
    assert not request.node.get_closest_marker("unit")

def test_unit(request):
    assert request.node.get_closest_marker("unit")
    assert not request.node.get_closest_marker("integration")
"""


def run(pytester: pytest.Pytester, test: str) -> pytest.RunResult:
    pytester.makeini(SETTINGS)
    pytester.makeconftest((TESTS / "conftest.py").read_text())
    pytester.makepyfile(PREAMBLE + test)
    return pytester.runpytest_subprocess("-p", "no:cacheprovider")


@pytest.mark.usefixtures("outside")
def test_a_test_that_leaves_a_task_pending_fails(pytester: pytest.Pytester) -> None:
    result = run(pytester, LEAKING + TIDY)
    result.assert_outcomes(passed=4, errors=1)
    result.stdout.fnmatch_lines(["*the test left tasks pending*", "*name='forgotten'*"])


@pytest.mark.usefixtures("outside")
def test_a_unit_test_that_reaches_outside_fails_and_a_fixture_permits_it(
    pytester: pytest.Pytester,
) -> None:
    result = run(pytester, REACHING + ALLOWED)
    result.assert_outcomes(passed=3, failed=4, errors=5)  # the swallowed one is found at its end
    for name in ("connects", "swallows_the_failure", "starts", "forks", "sleeps"):
        result.stdout.fnmatch_lines([f"ERROR *::test_{name}*"])
