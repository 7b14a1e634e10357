"""Jobs beside the recording: one that fails is reported, and the others are done."""

import msgspec
import pytest

from adaptdrive.errors import RecordingError
from adaptdrive.recording.batches import News
from adaptdrive.recording.housekeeping import Housekeeper
from adaptdrive.recording.writer import send_to_parent


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


def test_the_name_of_a_file_that_is_not_utf8_is_reported(
    capfdbinary: pytest.CaptureFixture[bytes],
) -> None:
    send_to_parent(News(severity="info", detail="session Pr\udcfcfung removed"))
    news = msgspec.json.decode(capfdbinary.readouterr().out, type=News)
    assert news.detail == r"session Pr\udcfcfung removed"
