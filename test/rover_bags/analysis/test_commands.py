"""Commands of a bag: who sent them, and what became of them."""

from dataclasses import replace
from pathlib import Path

import pytest
from contract_bag import MadeUp, ns

from msg_schemas import topics
from msg_schemas.commands import CommandRecord, CommandState
from msg_schemas.events import NodeEvent
from msg_schemas.faults import Reason
from msg_schemas.samples import ClockSample, Level, Status, StatusSample
from rover_bags.analysis.metrics import measure
from rover_bags.reading.read import read_bag
from rover_bags.views.summary import as_text

RECORD = CommandRecord(
    "winch_node", topics.WINCH_REQUEST, "rover", "1", ns(2.0), CommandState.ACCEPTED,
    "winch_length 8 m",
)  # fmt: skip


def test_commands_are_listed_with_their_ends(tmp_path: Path):
    made = MadeUp()

    def publish(time: float, change: CommandRecord) -> None:
        made.add(time, topics.COMMANDS, StatusSample(ns(time), (change.status(),)))

    for time in range(12):
        made.add(float(time), topics.CLOCK, ClockSample(ns(float(time))))
    publish(2.0, RECORD)
    publish(3.0, replace(RECORD, state=CommandState.RUNNING, progress=0.5))
    done = replace(RECORD, state=CommandState.DONE, reason=Reason.COMPLETED)
    publish(6.5, replace(done, progress=1.0, text="at 8 m"))
    second = replace(RECORD, identifier="2", taken_ns=ns(8.0))
    publish(8.0, replace(second, state=CommandState.RUNNING, text="length"))
    active = Status(NodeEvent.ACTIVE, "active", Level.OK, "winch_node")
    made.add(10.0, topics.EVENTS, StatusSample(ns(10.0), (active,)))
    call = replace(done, sender="", identifier="7000000000", taken_ns=ns(7.0), what="")
    publish(7.0, call)

    bag = read_bag(made.write(tmp_path / "bag"))
    metrics = measure(bag)
    found = [
        (each.sender, each.taken_s, each.changed_s, each.state, each.reason)
        for each in metrics.commands
    ]
    assert found == [
        ("rover#1", 2.0, 6.5, "done", "completed"),
        ("7000000000", 7.0, 7.0, "done", "completed"),
        ("rover#2", 8.0, 10.0, "failed", "restarted"),
    ]
    text = as_text(bag, metrics)
    assert "winch/request winch_length 8 m" in text
    assert "at 8 m" in text
    assert metrics.to_mapping()["commands"][2]["text"] == "winch_node has started again"


@pytest.mark.parametrize(
    ("begun", "state"), [(0.0, "failed"), (0.5, "failed"), (None, "running")],
)  # fmt: skip
def test_a_command_ends_with_its_node_whatever_the_clock_of_the_next_start(
    begun: float | None, state: str, tmp_path: Path
):
    """A start before the first clock message is stamped 0; the clock may have begun anew."""
    made = MadeUp()

    def start(time: float, stamp: float, name: NodeEvent = NodeEvent.ACTIVE) -> None:
        status = Status(name, "", Level.OK, "winch_node")
        made.add(time, topics.EVENTS, StatusSample(ns(stamp), (status,)))

    running = StatusSample(ns(2.0), (replace(RECORD, state=CommandState.RUNNING).status(),))
    made.add(0.1, topics.COMMANDS, running)  # latched: a recorder may receive it first
    start(0.2, 0.0)
    start(0.2, 0.0, NodeEvent.INACTIVE)
    start(0.2, 0.0)
    if begun is not None:
        start(3.0, begun)
    (found,) = measure(read_bag(made.write(tmp_path / "bag"))).commands
    assert found.state == state
    assert found.changed_s == 2.0


def test_a_bag_without_records_has_no_table_of_commands(tmp_path: Path):
    made = MadeUp()
    made.add(0.0, topics.CLOCK, ClockSample(1))
    made.add(1.0, topics.CLOCK, ClockSample(ns(1.0)))
    bag = read_bag(made.write(tmp_path / "bag"))
    assert "commands:" not in as_text(bag, measure(bag))
