"""The table is consistent with itself and with the message packages."""

import math
import re

import pytest

from msg_schemas import topics
from msg_schemas.access import Act, nodes_that
from msg_schemas.document import render
from msg_schemas.machine import FRAMES
from msg_schemas.message_types import message_class
from msg_schemas.samples import JointSample
from msg_schemas.specifications import Audience, Intent, Service, Topic, Unstamped
from msg_schemas.table import SERVICES, TOPICS

ROWS = list(TOPICS.values())
NAMES = {value for key, value in vars(topics).items() if key.isupper()}


def test_every_name_has_exactly_one_row():
    assert set(TOPICS) | set(SERVICES) == NAMES
    assert not set(TOPICS) & set(SERVICES)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_message_type_exists_and_holds_the_frame(row: Topic):
    message = message_class(row.message)()
    assert not row.frame or row.frame in FRAMES
    if row.child_frame:
        assert row.child_frame in FRAMES
        assert hasattr(message, "child_frame_id")


@pytest.mark.parametrize("service", SERVICES.values(), ids=lambda row: row.name)
def test_service_type_exists(service: Service):
    assert message_class(service.service).Request is not None


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_names_are_relative_except_the_clock(row: Topic):
    assert row.name.startswith("/") == (row.intent is Intent.CLOCK)
    assert re.fullmatch(r"/?[a-z][a-z0-9_]*(/[a-z][a-z0-9_]*)*", row.name)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_fields_have_units_meanings_and_an_open_range(row: Topic):
    assert len(row.by_path) == len(row.fields), "a field stands twice"
    for item in row.fields:
        assert item.unit
        assert item.about
        assert item.minimum <= item.maximum
        if item.default is not None:
            assert item.minimum <= item.default <= item.maximum


@pytest.mark.parametrize("row", [r for r in ROWS if r.sample is JointSample], ids=lambda r: r.name)
def test_joint_topics_describe_all_three_numbers_of_each_joint(row: Topic):
    joints = (*row.joints, *row.optional_joints)
    expected = {f"{j}.{part}" for j in joints for part in ("position", "velocity", "effort")}
    assert len(set(joints)) == len(joints) > 0
    assert set(row.by_path) == expected


@pytest.mark.parametrize(
    "row", [r for r in ROWS if r.intent is Intent.COMMAND], ids=lambda r: r.name
)
def test_every_command_goes_stale_and_every_actuator_falls_silent(row: Topic):
    assert math.isfinite(row.stale.max_age)
    assert math.isfinite(row.stale.max_lead)
    if "operator" not in nodes_that(Act.PUBLISH, row.name):
        assert row.stale.unstamped is Unstamped.REFUSE
        assert math.isfinite(row.stale.timeout)
        assert row.rate is not None
        first = min(row.stale.timeout, row.stale.timeout_moving)
        assert first * row.rate >= 3, "one lost message must not stop a drive"


def test_a_winch_that_moves_bears_a_quarter_of_a_second_and_stops_within_0_2_m():
    stale = TOPICS[topics.WINCH_COMMAND].stale
    assert 0.25 < stale.timeout_moving < stale.timeout <= 0.5
    # At 0.3 m/s, with two ticks from the command to its reception and a ramp of 0.4 m/s^2.
    assert 0.3 * (stale.timeout_moving + 0.02) + 0.3**2 / (2.0 * 0.4) <= 0.2
    assert "brake" in stale.on_timeout_moving


def test_truth_is_not_for_controllers():
    truth = [row for row in ROWS if row.name.startswith("truth/")]
    assert truth
    assert all(row.audience is Audience.NOT_CONTROLLERS for row in truth)


def test_document_names_every_topic_service_frame_and_unit():
    text = render()
    for row in ROWS:
        assert f"### `{row.name}`" in text
        for item in row.fields:
            assert f"| `{item.path}` | {item.unit} |" in text
    for name in (*SERVICES, *FRAMES):
        assert f"`{name}`" in text
