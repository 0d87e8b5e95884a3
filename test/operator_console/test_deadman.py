"""Orders that are held: renewed while they are, and never after a gap."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest

from operator_console.completion import Completion
from operator_console.deadman import LONGEST_GAP, DeadmanCommands


@dataclass
class Winch:
    """What hears renewals, with a clock of the test's own."""

    time: float = 0.0
    heard: list[str] = field(default_factory=list)
    ending: Completion | None = None

    def say_again(self, order: str) -> Completion | None:
        if self.ending is None:
            self.heard.append(order)
        return self.ending

    def orders(self) -> DeadmanCommands[str]:
        return DeadmanCommands(self.say_again, lambda: self.time)


def test_each_renewal_is_said_once():
    winch = Winch()
    orders = winch.orders()
    name = orders.begin("jog")
    assert winch.heard == []
    for _ in range(3):
        winch.time += 0.9 * LONGEST_GAP
        assert orders.renew(name).is_done
    assert winch.heard == ["jog"] * 3


def test_what_was_not_held_for_a_while_does_not_move_again():
    winch = Winch()
    orders = winch.orders()
    name = orders.begin("jog")
    winch.time += LONGEST_GAP + 0.5
    assert orders.renew(name) == (False, "it was not held for 1.5 s")
    assert orders.renew(name) == (False, "nothing is held by that name")
    assert winch.heard == []


def test_what_is_over_is_told_and_not_said_again():
    winch = Winch()
    orders = winch.orders()
    name = orders.begin("pull")
    winch.ending = Completion(False, "the drum's end is reached")
    assert orders.renew(name) == (False, "the drum's end is reached")
    winch.ending = None
    assert not orders.renew(name).is_done
    assert winch.heard == []


@pytest.mark.parametrize("name", ["", "jog", "0" * 16])
def test_nobody_renews_what_he_did_not_begin(name: str):
    winch = Winch()
    orders = winch.orders()
    orders.begin("jog")
    assert not orders.renew(name).is_done
    assert winch.heard == []


def test_presses_that_nobody_ended_are_forgotten():
    winch = Winch()
    orders = winch.orders()
    names = [orders.begin(f"jog {number}") for number in range(40)]
    assert not orders.renew(names[0]).is_done
    assert orders.renew(names[-1]).is_done
