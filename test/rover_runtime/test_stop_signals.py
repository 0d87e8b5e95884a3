"""Signals that ask a process to stop, while it may not stop."""

from __future__ import annotations

import signal
import threading

import pytest

from rover_runtime.stop_signals import deferred_stop_signals, stop_signals


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_acts_once_after_the_block(number: signal.Signals):
    received: list[int] = []
    before = signal.signal(number, lambda this, _frame: received.append(this))
    try:
        with deferred_stop_signals():
            signal.raise_signal(number)
            signal.raise_signal(number)
            assert received == []
        assert received == [number]
        signal.raise_signal(number)
        assert received == [number, number]
    finally:
        signal.signal(number, before)


def test_an_interrupt_comes_after_the_block():
    done: list[str] = []

    def register() -> None:
        with deferred_stop_signals():
            signal.raise_signal(signal.SIGINT)
            done.append("registered")

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            register()
    finally:
        signal.signal(signal.SIGINT, before)
    assert done == ["registered"]


def test_another_thread_is_left_alone():
    before = [signal.getsignal(number) for number in stop_signals()]
    during: list[object] = []

    def enter() -> None:
        with deferred_stop_signals():
            during.extend(signal.getsignal(number) for number in stop_signals())

    thread = threading.Thread(target=enter)
    thread.start()
    thread.join(30.0)
    assert during == before
