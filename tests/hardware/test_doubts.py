"""Doubts about a drive, in exact times: another master on its bus, and what follows a lost bus."""

from __future__ import annotations

from adaptdrive.hardware.doubts import Relink, Rival


def test_another_master_is_remembered_for_five_seconds() -> None:
    now_s = [100.0]
    rival = Rival(lambda: now_s[0])
    assert rival.complaint is None
    rival.hear("0x200 Command")
    now_s[0] = 104.9
    assert "1 x frame 0x200 Command, the last 4.9 s ago" in str(rival.complaint)
    rival.hear("0x200 Command")
    now_s[0] = 109.9
    assert "2 x frame" in str(rival.complaint)
    now_s[0] = 110.0
    assert rival.complaint is None


def test_a_drive_that_stopped_unheard_waits_for_the_safe_command() -> None:
    relink = Relink()
    relink.note(bridge=True, safe=False)
    relink.hear(bridge=True)
    relink.open(bridge=True)
    assert not relink.admits(bridge=True)  # until it has reported
    assert relink.admits(bridge=False)
    relink.hear(bridge=False)
    assert "drive stopped" in str(relink.complaint)
    assert not relink.admits(bridge=True)
    relink.note(bridge=False, safe=True)
    assert relink.complaint is None
    assert relink.admits(bridge=True)
