"""Jobs beside the recording: one that fails is reported, and the others are done."""

import pytest

from adaptdrive.errors import RecordingError
from adaptdrive.recording.housekeeping import Housekeeper


@pytest.mark.parametrize(
    ("problem", "reported"),
    [
        (RecordingError("one", "damaged"), "one: damaged"),
        (OverflowError("out of range"), "internal error: OverflowError('out of range')"),
    ],
)
def test_a_job_that_fails_is_reported_and_those_behind_it_are_done(
    problem: Exception, reported: str
) -> None:
    warnings: list[str] = []
    done: list[str] = []

    def fail() -> None:
        raise problem

    housekeeper = Housekeeper(warnings.append)
    housekeeper.submit(fail)
    housekeeper.submit(lambda: done.append("closed"))
    housekeeper.finish()
    assert (warnings, done) == ([reported], ["closed"])
