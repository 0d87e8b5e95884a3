"""Dead-man orders are renewed while the button is pressed, and never after a gap."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest

from operator_console.deadman import RENEWAL_TIMEOUT, DeadmanCommands
from operator_console.exchange import Completion


@dataclass
class Winch:
    """Receives renewals; has a simulated clock."""

    time: float = 0.0
    received: list[str] = field(default_factory=list)
    completion: Completion | None = None

    def send_again(self, order: str) -> Completion | None:
        if self.completion is None:
            self.received.append(order)
        return self.completion

    def orders(self) -> DeadmanCommands[str]:
        return DeadmanCommands(self.send_again, lambda: self.time)


def test_each_renewal_is_sent_once():
    winch = Winch()
    orders = winch.orders()
    name = orders.begin("jog")
    assert winch.received == []
    for _ in range(3):
        winch.time += 0.9 * RENEWAL_TIMEOUT
        assert orders.renew(name).is_done
    assert winch.received == ["jog"] * 3


def test_an_order_does_not_resume_after_a_gap():
    winch = Winch()
    orders = winch.orders()
    name = orders.begin("jog")
    winch.time += RENEWAL_TIMEOUT + 0.5
    assert orders.renew(name) == (False, "the press was not renewed for 1.5 s (limit 1 s)")
    assert orders.renew(name) == (False, "this press is not known or has ended")
    assert winch.received == []


def test_a_completed_order_is_reported_and_not_sent_again():
    winch = Winch()
    orders = winch.orders()
    name = orders.begin("pull")
    winch.completion = Completion(False, "the drum's end is reached")
    assert orders.renew(name) == (False, "the drum's end is reached")
    winch.completion = None
    assert not orders.renew(name).is_done
    assert winch.received == []


@pytest.mark.parametrize("name", ["", "jog", "0" * 16])
def test_an_unknown_key_renews_nothing(name: str):
    winch = Winch()
    orders = winch.orders()
    orders.begin("jog")
    assert not orders.renew(name).is_done
    assert winch.received == []


def test_old_presses_are_dropped():
    winch = Winch()
    orders = winch.orders()
    names = [orders.begin(f"jog {number}") for number in range(40)]
    assert not orders.renew(names[0]).is_done
    assert orders.renew(names[-1]).is_done
