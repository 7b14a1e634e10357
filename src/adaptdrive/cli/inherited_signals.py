"""Signals of a process whose starter had blocked them, or had ended children reaped unseen."""

from __future__ import annotations

import signal
import threading


def heed_signals() -> None:
    """Unblocks every signal, and has ended child processes reported.

    A process inherits both from the program that starts it. With SIGTERM blocked nothing but
    SIGKILL would end a daemon, and a drive would stay on; with SIGCHLD ignored the status of a
    recorder that has ended is lost. A signal that was ignored on purpose, as by `nohup`, stays so.
    """
    signal.pthread_sigmask(signal.SIG_UNBLOCK, signal.valid_signals())
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
