"""Validity of a command that energises a drive on Modbus: when it must not be sent any more."""

from __future__ import annotations

import math
from collections.abc import Callable

from adaptdrive.control.signals import SAFE_COMMAND, Command
from adaptdrive.hardware.modbus.sight import Sight
from adaptdrive.hardware.relink import REFUSED, UNANSWERED, UNREAD, Relink


class CommandValidity:
    """Notes what the polls of a drive have shown, and whether a command may follow from it.

    The safe command is always valid. *Given on* means that the last command which the drive may
    have received had the bridge on.

    Attributes:
        silent: Whether the drive did not answer the last poll.
        powered: Whether its last reading has the bridge on, or it is assumed to be on.
        may_be_on: The same, of the last report on this link or before; it may come with refused
            values.
    """

    def __init__(self, frozen_s: float, sight: Sight, clock: Callable[[], float]) -> None:
        """Know nothing of the drive yet.

        Args:
            frozen_s: Time without a step of the port after which its process has stood still.
            sight: Freshness of what is known of the drive.
            clock: Monotonic clock, in s.
        """
        self._frozen_s = frozen_s
        self._sight = sight
        self._clock = clock
        self._relink = Relink()
        self._blank = True
        self._read_s = -math.inf
        self._stepped_s = math.inf
        self._outdated = False
        self.silent = False
        self.powered = False
        self.may_be_on = False

    @property
    def complaint(self) -> str | None:
        """Reason not to energise the drive: it has stopped; None for none."""
        return self._relink.complaint

    def renew(self, command: Command) -> None:
        """Note that a new command was decided."""
        self._relink.note(bridge=command.bridge, safe=command == SAFE_COMMAND)
        self._outdated = False

    def begin(self, *, given_on: bool) -> None:
        """Begin a link: nothing is known of the drive on it."""
        self._relink.open(bridge=given_on)
        self.silent = self.powered = False
        self._blank = True
        self._sight.forget()
        self._stepped_s = self._clock()

    def note_step(self) -> None:
        """Note that the port does its work; a command from before a standstill is void."""
        now_s = self._clock()  # one look: the process may stand still between two
        self._outdated = self._outdated or self._stands_still(now_s)
        self._stepped_s = now_s

    def note_read(self, *, answered: bool, given_on: bool) -> bool:
        """Note the end of a poll, which gives no reading unless its bridge is noted next.

        A drive that has given none for as long as its own time-out may be, or has neither answered
        a read nor acknowledged a command, may have stopped: what energises waits for a reading, as
        after a lost link.

        Args:
            answered: Whether the drive answered: a silent one ignores more than commands.
            given_on: Whether it may be on by command.

        Returns:
            Whether what energises waits.
        """
        self.silent = self.silent or not answered
        waits = self._unfed or self._unread
        if waits:
            self._relink.open(bridge=given_on, how=UNANSWERED if self.silent else UNREAD)
        self.silent, self._blank = not answered, True
        return waits

    def note_bridge(self, *, powered: bool, acknowledged_on: bool, reported_s: float) -> None:
        """Note a reading.

        Args:
            powered: Whether the drive reports its bridge on, or is assumed to have it on.
            acknowledged_on: Whether the last command that it acknowledged had the bridge on.
            reported_s: When the report was asked for, monotonic clock.
        """
        if acknowledged_on and self.powered and not powered:
            self._outdated = True  # a command from before the bridge went off
        self.powered = self.may_be_on = powered
        self._sight.look(reported_s)
        self._blank, self._read_s = False, reported_s
        self._relink.hear(bridge=powered)

    def note_refused(
        self, *, powered: bool | None, acknowledged_on: bool, given_on: bool, reported_s: float
    ) -> None:
        """Note a poll without a reading: what energises waits where it has the bridge off.

        One that has it on counts as a report: a drive that is off in the next reading has stopped.

        Args:
            powered: The bridge reported with the refused values, None where it must not be used.
            acknowledged_on: Whether the last command that it acknowledged had the bridge on.
            given_on: Whether it may be on by command.
            reported_s: When the report was asked for, monotonic clock.
        """
        if powered is not None:
            self.may_be_on = powered
            self._sight.look(reported_s)
        if powered is False:
            self._relink.open(bridge=given_on, how=REFUSED)
        elif powered and acknowledged_on:
            self._relink.glimpse_on(REFUSED)

    def assume(self, *, powered: bool) -> None:
        """Note that a drive which never reports its bridge has it as it was commanded."""
        self.may_be_on = powered

    def admits(self, command: Command) -> bool:
        """Return whether a command is still valid.

        A process that did not run for long finds here what it decided before: that is void. So is
        one for a drive that was on when its link was lost or a read failed, before it is read, and
        one that was decided by a reading of long ago.
        """
        if command == SAFE_COMMAND:
            return True
        void = self._outdated or self._stands_still(self._clock()) or self._unfed or self._unread
        return not void and self._relink.admits(bridge=command.bridge)

    def may_join(self, command: Command) -> bool:
        """Return whether a valid command may be written with a read."""
        return not command.bridge or self._sight.joins_look

    def may_follow(self, command: Command) -> bool:
        """Return whether a valid command may be written after a read."""
        return not command.bridge or self._sight.follows_look

    @property
    def _unfed(self) -> bool:
        """True if a silent drive has acknowledged no command for as long as it may need to stop."""
        return self.silent and self._sight.may_have_timed_out

    @property
    def _unread(self) -> bool:
        """True if the polls have given no reading for as long as the drive may be silent."""
        return self._blank and self._clock() - self._read_s > self._sight.limit_s

    def _stands_still(self, now_s: float) -> bool:
        return now_s - self._stepped_s > self._frozen_s
