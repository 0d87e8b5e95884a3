"""Who may do what: the table, the policy that is written of it, and nodes that reach beyond."""

from __future__ import annotations

import re
from dataclasses import astuple
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from msg_schemas import topics
from msg_schemas.access import (
    ACCESS,
    ALL,
    BATCHES,
    OF_ALL_NODES,
    TRUTH_BATCHES,
    Act,
    check_access,
    node_that,
    nodes_that,
)
from msg_schemas.access_policy import DEFAULT_PATH, enclave, policy
from msg_schemas.actions import ACTIONS
from msg_schemas.table import SERVICES, TOPICS
from rover_cli.command_line import main

ROOT = Path(__file__).resolve().parents[2]


def granted(xml: str, node: str, kind: str, act: str) -> set[str]:
    profile = ET.fromstring(xml.split("?>", 1)[1]).find(f".//profile[@node='{node}']")
    assert profile is not None
    return {
        each.text or "" for group in profile.iterfind(f"{kind}s[@{act}='ALLOW']") for each in group
    }


def test_the_table_names_what_is_in_the_contract():
    for access in (*ACCESS.values(), OF_ALL_NODES):
        *known, besides, executed, requested = (set(each) - set(ALL) for each in astuple(access))
        published, subscribed, served, called = known
        assert published | subscribed <= set(TOPICS)
        assert served | called <= set(SERVICES)
        assert not besides & set(TOPICS)
        assert executed | requested <= set(ACTIONS)


def test_every_topic_has_a_speaker_and_every_service_a_server():
    spoken = {name for access in (*ACCESS.values(), OF_ALL_NODES) for name in access.publishes}
    assert spoken == set(TOPICS)
    assert {name for access in ACCESS.values() for name in access.serves} == set(SERVICES)


def test_the_nodes_of_a_topic_or_service_are_those_whose_rows_name_it():
    assert nodes_that(Act.SERVE, topics.SIM_STEP) == ("sim_node", "mock_plant")
    assert nodes_that(Act.PUBLISH, topics.EVENTS) == ()
    assert node_that(Act.PUBLISH, topics.WINCH_MODE) == "winch_node"
    with pytest.raises(ValueError, match="too many values"):
        node_that(Act.PUBLISH, topics.WINCH_REQUEST)


NODE_NAME = r'class \w+\(\w*(?:Node|Component)\):(?:.|\n)*?\n    NAME = "(\w+)"'


def test_every_node_of_the_suite_has_its_row():
    sources = (
        path.read_text(encoding="utf-8")
        for package in ("rover_sim", "rover_control", "tether_winch", "rover_hil", "rover_bags",
                        "operator_console", "rover_view", "rover_actions")
        for path in (ROOT / package).rglob("*.py")
    )  # fmt: skip
    named = {name for source in sources for name in re.findall(NODE_NAME, source)}
    assert named
    assert named <= set(ACCESS)


def test_only_who_may_receive_ground_truth_receives_its_batches():
    text = policy()
    for node in ("winch_node", "descent_node", "drive_node", "jump_node", "mission_node"):
        assert BATCHES in granted(text, node, "topic", "subscribe")
        for act in ("publish", "subscribe"):
            assert TRUTH_BATCHES not in granted(text, node, "topic", act)
    assert {BATCHES, TRUTH_BATCHES} <= granted(text, "sim_node", "topic", "publish")
    assert TRUTH_BATCHES in granted(text, "view_node", "topic", "subscribe")


def test_only_the_viewer_node_may_publish_frames():
    text = policy()
    assert granted(text, "view_node", "topic", "publish") >= {"tf", "tf_static"}
    assert all(
        "tf" not in granted(text, node, "topic", "publish")
        for node in ACCESS
        if node != "view_node"
    )


def test_actions_are_executed_by_their_node_and_requested_by_operators():
    text = policy()
    assert granted(text, "action_node", "action", "execute") == set(ACTIONS)
    assert granted(text, "operator", "action", "call") == {"*"}
    others = set(ACCESS) - {"action_node"}
    assert not any(granted(text, node, "action", "execute") for node in others)
    with pytest.raises(PermissionError, match="view_node executes descend"):
        check_access("view_node", Act.EXECUTE, "descend")


def test_a_node_that_reaches_beyond_its_row_is_refused():
    check_access("jump_node", Act.PUBLISH, "jump_motor/command")
    check_access("jump_node", Act.PUBLISH, "events")
    check_access("bag_record", Act.SUBSCRIBE, "anything/at/all")
    check_access("somebody_elses_node", Act.PUBLISH, "winch/command")
    with pytest.raises(PermissionError, match="jump_node publishes winch/command: its row"):
        check_access("jump_node", Act.PUBLISH, "winch/command")
    with pytest.raises(PermissionError, match="bag_record serves winch/stop"):
        check_access("bag_record", Act.SERVE, "winch/stop")


def test_only_those_who_drive_may_command_drives():
    drives = {name for name in TOPICS if TOPICS[name].owned}
    assert drives
    command_sources = {node for node, access in ACCESS.items() if drives & set(access.publishes)}
    written = {node for node in ACCESS if drives & granted(policy(), node, "topic", "publish")}
    assert command_sources == written
    assert command_sources.isdisjoint({"operator", "bag_record", "sim_node", "hil_bridge"})


def test_the_shipped_policy_is_the_tables():
    assert (ROOT / DEFAULT_PATH).read_text(encoding="utf-8") == policy()


@pytest.mark.parametrize("node", ACCESS)
def test_the_policy_grants_what_the_row_does(node: str):
    xml, access = policy(), ACCESS[node]
    subscribes = granted(xml, node, "topic", "subscribe")
    assert subscribes == {"*"} if access.subscribes == ALL else subscribes >= set(access.subscribes)
    assert granted(xml, node, "topic", "publish") >= {*access.publishes, "events", "/rosout"}
    assert granted(xml, node, "service", "reply") >= {*access.serves, "~/change_state"}
    assert granted(xml, node, "service", "request") == set(access.calls)


def test_in_a_namespace_all_is_within_it():
    xml = policy("/rovers/first")
    assert enclave("winch_node", "/rovers/first") == "/mother_rover/rovers/first/winch_node"
    assert f'path="{enclave("winch_node", "/rovers/first")}"' in xml
    assert "clock" in granted(xml, "winch_node", "topic", "subscribe")
    assert "/clock" not in granted(xml, "winch_node", "topic", "subscribe")
    with pytest.raises(ValueError, match="'first': should be absolute"):
        policy("first")


def test_it_is_written_by_a_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    for namespace, code in (("/one", 0), ("one two", 2)):
        target = tmp_path / "config" / "policy.xml"
        assert main(["policy", str(target), "--namespace", namespace]) == code
    assert target.read_text(encoding="utf-8") == policy("/one")
    assert "'one two': should be absolute" in capsys.readouterr().err
