"""Sessions of the documents that lead somewhere, played on the mock plant; see `session`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import documented
import pytest
from session import Session

if TYPE_CHECKING:
    from rover_verify.harness import NodeHarness

pytestmark = [pytest.mark.ros, pytest.mark.process, pytest.mark.slow]


def test_the_first_descent_by_hand(harness: NodeHarness, tmp_path: Path):
    session = Session(harness)
    for command in documented.section("README.md", "First descent by hand"):
        session.do(command)
    assert session.started["bag_record"].stop() == 0
    (bag,) = tmp_path.glob("descent_bag/*.mcap")
    assert bag.stat().st_size > 10_000


def test_the_controller_of_one_s_own_lands(harness: NodeHarness):
    session = Session(harness)
    heading = "Run it with the mock plant, then with the simulated plant"
    for command in documented.section("docs/tutorials/own_controller.md", heading):
        if "sim_node" not in command.words:  # the simulator takes minutes on a busy machine
            session.do(command)
    session.started["lander"].wait_for_output("landed: on the floor at 7.5")
