"""Every order of the operators' documents is given to a whole machine, and comes to who takes it.

The mock plant stands for the world, all controllers are there. Orders come one after the other from
many documents, so that the machine is rarely where a document has it: an order counts as carried
out when its node took it, or refused it with a reason.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import documented
import pytest
import ros2_commands
from documented import Command
from ros2_commands import Call, Echo, Launch, Publish
from session import NEVER_ENDS, OLD, TRIALS, UNTIL_ITS_END, Session

from msg_schemas import qos, topics
from msg_schemas.message_types import message_class, to_time
from operator_console.command_line import Exit

if TYPE_CHECKING:
    from rover_verify.harness import NodeHarness

pytestmark = [pytest.mark.ros, pytest.mark.process, pytest.mark.slow]

MACHINE = ("ros2", "launch", "mother_rover", "mission.launch.py", "plant:=mock")
DOCUMENTS = (
    "docs/winch.md", "docs/launch.md", "docs/descent.md", "docs/rover.md", "docs/jumping.md",
    "docs/driving.md", "docs/mission.md",
)  # fmt: skip
SHOWS = {"--help"}
ANOTHER_MACHINE = "/rover1/"


@dataclass
class Orders(Session):
    """Orders to a machine that stands already."""

    def __post_init__(self) -> None:
        super().__post_init__()
        launch = ros2_commands.read(MACHINE)
        assert isinstance(launch, Launch)
        self.launch(launch)

    def order(self, words: Sequence[str]) -> None:
        if "--bag" in words:
            return  # no order: it shows a bag that another command of the document has recorded
        if SHOWS & set(words) or words[0] in NEVER_ENDS:
            super().order(words)
            return
        given = [word for word in words if word != UNTIL_ITS_END]
        for _ in range(TRIALS):
            process = self.harness.processes.start("operator_console.command_line", None, *given)
            code = process.wait()
            if OLD not in process.output:
                break
        assert code in {Exit.DONE, Exit.REFUSED}, process.output

    def ros2(self, command: Command) -> None:
        meant = ros2_commands.read(command.words)
        if isinstance(meant, Publish):
            self.publish(meant, 1)
        elif isinstance(meant, Call):
            answer = self.observer.call(meant.row.name, meant.values.get("data"))
            assert answer.success or answer.message.endswith("]"), f"{command}: {answer.message}"
        elif isinstance(meant, Echo):
            node, name = self.observer.node, meant.row.name
            self.observer.wait_until(lambda: node.count_publishers(name) > 0, f"no {name}")

    def publish(self, meant: Publish, listeners: int) -> None:
        name = meant.row.name
        node = self.observer.node
        publisher = node.create_publisher(
            message_class(meant.row.message), name, qos.profile(meant.row.intent)
        )
        self.observer.wait_until(
            lambda: (
                publisher.get_subscription_count() >= max(listeners, node.count_subscribers(name))
            ),
            f"no subscription to {name}",
        )
        since = len(self.observer.listen(topics.COMMANDS))
        message = meant.message()
        message.header.stamp = to_time(self.observer.time_ns())
        publisher.publish(message)
        self.observer.wait_for_command(name, since=since)


def _orders() -> Iterator[Command]:
    for command in documented.commands():
        words = command.words
        started = words[0].endswith("_node") or words[:2] in {("ros2", "launch"), ("ros2", "run")}
        if command.block.document in DOCUMENTS and words[0] in {"rover", "ros2"} and not started:
            yield command


def test_every_order_is_taken_or_refused_with_a_reason(harness: NodeHarness):
    session, given = Orders(harness), 0
    for command in _orders():
        if ANOTHER_MACHINE not in str(command):
            session.do(command)
            given += 1
    assert given > 30
