"""Any parameters, transitions, services and bytes over DDS end no node and move nothing."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from damage import damaged
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from msg_schemas import topics
from msg_schemas.cdr import pack
from msg_schemas.machine import WINCH_AT_RATE, WINCH_BRAKE, WINCH_DRUM, WINCH_TO_LENGTH
from msg_schemas.samples import JointSample, JointValue

if TYPE_CHECKING:
    from rover_verify.harness import NodeHarness, Observer, Process

pytestmark = [pytest.mark.ros, pytest.mark.process]

NODE = "winch_node"
MEMORY = 400.0  # resident size of the node [MB]
LOG = 500_000  # characters of its output
CALLED = (topics.WINCH_HOLD, topics.WINCH_STOP, topics.WINCH_RELAX)
NAMES = st.sampled_from(["max_rate", "command_timeout", "use_sim_time", "lockstep", ""]) | st.text(
    st.characters(codec="utf-8", exclude_characters="\0"), max_size=20
)
VALUES = st.one_of(
    st.booleans(), st.integers(-(2**63), 2**63 - 1), st.floats(), st.lists(st.floats(), max_size=3),
    st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=20),
)  # fmt: skip
REQUESTS = [
    pack(topics.WINCH_REQUEST, JointSample(0, {name: JointValue(length, 0.1, 50.0)}))
    for name, length in ((WINCH_TO_LENGTH, 6.0), (WINCH_AT_RATE, 0.0))
]


@dataclass
class Machine:
    """A winch that is never armed, with the mock plant."""

    winch: Process
    observer: Observer
    length: float

    def check(self) -> None:
        """It lives within its limits, and the drum has not moved."""
        assert self.winch.is_running
        status = Path(f"/proc/{self.winch.pid}/status").read_text("ascii")
        (resident,) = (line for line in status.splitlines() if line.startswith("VmRSS"))
        assert float(resident.split()[1]) / 1024.0 < MEMORY
        assert len(self.winch.output) < LOG
        drum = self.observer.listen(topics.WINCH_STATE)
        last = drum.wait(since=len(drum))
        assert last.joints[WINCH_BRAKE].position == 0.0
        assert last.joints[WINCH_DRUM].position == pytest.approx(self.length, abs=1e-6)


@pytest.fixture(scope="module")
def machine(shared_harness: NodeHarness) -> Machine:
    start = shared_harness.processes.start
    start("rover_sim.node.mock_plant_node", {"scenario": "free_hang"})
    winch = start("tether_winch.winch_node", {"use_sim_time": True})
    observer = shared_harness.observer()
    observer.wait_until_ready(NODE)
    drum = observer.listen(topics.WINCH_STATE).wait()
    return Machine(winch, observer, drum.joints[WINCH_DRUM].position)


def act(machine: Machine, kind: str, data: st.DataObject) -> Any:
    """Do something to the node; a refusal is an answer."""
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState

    observer = machine.observer
    if kind == "parameter":
        return observer.set_parameter(NODE, data.draw(NAMES), data.draw(VALUES))
    if kind == "transition":
        request = ChangeState.Request(transition=Transition(id=data.draw(st.integers(1, 4))))
        return observer.request(ChangeState, f"{NODE}/change_state", request)
    if kind == "service":
        if observer.state_of(NODE) != "active":
            return None  # then it serves nothing
        return observer.call(data.draw(st.sampled_from(CALLED)))
    request = data.draw(damaged(data.draw(st.sampled_from(REQUESTS))))
    return observer.publisher(topics.WINCH_REQUEST).publish(request)


@given(data=st.data(), kinds=st.lists(
    st.sampled_from(["parameter", "transition", "service", "message", "message"]),
    min_size=10, max_size=25,
))  # fmt: skip
@settings(max_examples=4, suppress_health_check=list(HealthCheck))
def test_nothing_ends_or_moves_a_winch_that_is_not_armed(
    machine: Machine, data: st.DataObject, kinds: list[str]
):
    for kind in kinds:
        if kind in {"service", "message"} and machine.observer.state_of(NODE) != "active":
            continue
        act(machine, kind, data)
    machine.check()
    for transition in ("configure", "activate"):
        machine.observer.change_state(NODE, transition)
    assert machine.observer.state_of(NODE) == "active"
