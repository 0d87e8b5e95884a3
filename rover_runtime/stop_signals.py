"""Signals that ask a process to stop: Ctrl-C, `kill`, and a terminal that closes."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


def stop_signals() -> tuple[signal.Signals, ...]:
    """Return the signals; without SIGHUP where `nohup` has it ignored."""
    signals = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    is_ignored = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    return signals[:2] if is_ignored else signals


@contextmanager
def deferred_stop_signals() -> Iterator[None]:
    """Let a signal that comes within the block act after it.

    A signal that raises an exception between the start of a process and its registration would
    leave a process that nobody ends.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # Python handles signals in the main thread alone
        return
    received: list[int] = []
    before = {
        number: signal.signal(number, lambda this, _frame: received.append(this))
        for number in stop_signals()
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if received:
            signal.raise_signal(received[0])
