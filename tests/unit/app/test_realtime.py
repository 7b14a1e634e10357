"""What is told at start about the time before each frame of the drive."""

from adaptdrive.app.process import before_frames
from tests.unit.config import documents, modbus_documents

WANTED = {"realtime__rehearse_us": "650.0", "realtime__spin_us": "300.0"}


def test_nothing_is_told_of_what_nobody_wants() -> None:
    assert list(before_frames(documents.parse())) == []


def test_a_rehearsal_and_a_busy_wait_are_told_with_what_they_cost() -> None:
    rehearsal, wait = before_frames(documents.parse(**WANTED))
    assert (rehearsal.asked, rehearsal.granted) == ("rehearse_us = 650", True)
    assert (wait.asked, wait.granted) == ("spin_us = 300", True)
    assert wait.meaning == "busy before each frame and deadline, up to 4 % of a CPU"


def test_a_drive_that_is_polled_gets_no_rehearsal_and_hears_why() -> None:
    rehearsal, wait = before_frames(modbus_documents.parse(**WANTED))
    assert not rehearsal.granted
    assert "polled" in rehearsal.meaning
    assert "each deadline of the timer" in wait.meaning
