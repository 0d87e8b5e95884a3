"""Signals that ask a process to stop: Ctrl-C, `kill`, and a terminal that closes."""

from __future__ import annotations

import signal


def stop_signals() -> tuple[signal.Signals, ...]:
    """Return the signals; without SIGHUP where `nohup` has it ignored."""
    signals = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    is_ignored = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    return signals[:2] if is_ignored else signals
