"""The mapping between contract and objects, in both directions, to the size of a count."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from contract_samples import samples_of
from hypothesis import example, given
from hypothesis import strategies as st

from msg_schemas import machine, topics
from msg_schemas.access import ACCESS
from msg_schemas.cdr import check
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import JointSample, JointValue, Sample
from msg_schemas.table import TOPICS
from rover_hil.bridge.wiring import (
    AT_REST,
    COMMANDED,
    PUBLISHED,
    command_of,
    requests_rest,
    sample_of,
    setpoint_of,
    values_of,
)
from rover_hil.canopen.devices import BY_NAME, DEVICES, JUMP, WINCH

SWITCHES = ("jump_latch", "winch_brake")
# Only these objects have a smaller range than the contract: such commands are refused.
NARROWER = {"winch_drum.effort": 3276.7}


@st.composite
def commands(draw: st.DrawFn) -> tuple[str, JointSample]:
    topic = draw(st.sampled_from(sorted(COMMANDED)))
    sample = draw(samples_of(TOPICS[topic]))
    joints = dict(sample.joints)
    for name in SWITCHES:
        if name in joints:
            joints[name] = JointValue(float(draw(st.booleans())))
    for path, limit in NARROWER.items():
        name = path.partition(".")[0]
        if name in joints:
            joints[name] = joints[name]._replace(effort=min(joints[name].effort, limit))
    return topic, JointSample(sample.stamp_ns, joints)


@given(commands())
@example(
    (topics.JUMP_MOTOR_COMMAND, JointSample(1, {machine.JUMP_SCREW: JointValue(0.0, 1e-4, 0.01)}))
)
def test_a_command_and_its_setpoint_agree_to_a_count(item: tuple[str, JointSample]):
    topic, sample = item
    device = COMMANDED[topic]
    setpoint = setpoint_of(topic, sample)
    entries = device.by_key
    counted = {key: entries[key].value(entries[key].counts(v)) for key, v in setpoint.items()}
    back = command_of(device, counted)
    assert back is not None
    assert back[0] == topic
    check(topic, JointSample(sample.stamp_ns, back[1]))
    for name, value in sample.joints.items():
        count = max(entry.scale for entry in entries.values() if "target" in entry.key or (
            entry.key == "max_torque"))  # fmt: skip
        for mine, theirs in zip(value, back[1][name], strict=True):
            assert abs(mine - theirs) <= count


@given(st.data())
def test_device_values_and_samples_agree_to_a_count(data: st.DataObject):
    samples: dict[str, Sample] = {}
    for topic in PUBLISHED:
        narrow = samples_of(TOPICS[topic])
        samples[topic] = data.draw(narrow)
    samples |= dict(physical(samples))
    values = values_of(samples)
    counted = {
        name: {
            key: BY_NAME[name].by_key[key].value(BY_NAME[name].by_key[key].saturated(value))
            for key, value in each.items()
        }
        for name, each in values.items()
    }
    back = values_of({topic: sample_of(topic, 1, counted) for topic in PUBLISHED})
    for name, each in counted.items():
        for key, value in each.items():
            entry = BY_NAME[name].by_key[key]
            assert abs(back[name][key] - value) <= 1.01 * entry.scale, (name, key)
    for topic in PUBLISHED:
        check(topic, sample_of(topic, 1, counted))  # within the contract's limits


def physical(samples: dict[str, Sample]) -> Iterator[tuple[str, Sample]]:
    """Consistent samples: switches are closed or open, the floor switch is any of the others."""
    contact, winch = samples[topics.CONTACT], samples[topics.WINCH_STATE]
    assert isinstance(contact, JointSample)
    assert isinstance(winch, JointSample)
    closed = {
        name: round(contact.joints.get(name, JointValue()).position)
        for name in ("wheel_left", "wheel_right", "body")
    }
    joints = {name: JointValue(float(on)) for name, on in closed.items()}
    floor = JointValue(float(any(closed.values())))
    yield topics.CONTACT, JointSample(1, {"floor": floor, **joints})
    brake = JointValue(float(round(winch.joints[machine.WINCH_BRAKE].position)))
    yield topics.WINCH_STATE, JointSample(1, {**winch.joints, machine.WINCH_BRAKE: brake})


def test_every_topic_of_the_bridge_is_mapped():
    access = ACCESS["hil_bridge"]
    assert {*PUBLISHED, topics.LINK_STATUS} == {*access.publishes}
    assert {*COMMANDED} == {*access.subscribes}
    assert {device.name for devices in PUBLISHED.values() for device in devices} == {
        device.name for device in DEVICES
    }


def winch(rate: float = 0.0, brake: float = 0.0, tension: float = 0.0) -> JointSample:
    return JointSample(
        1,
        {
            machine.WINCH_DRUM: JointValue(10.0, rate, tension),
            machine.WINCH_BRAKE: JointValue(brake),
            machine.WINCH_LIMIT: JointValue(0.0, 0.0, 0.01),
        },
    )


@pytest.mark.parametrize("sample", [winch(brake=0.5), winch(tension=4000.0)])
def test_a_value_beyond_the_range_of_its_object_is_refused_with_the_reason(sample: JointSample):
    with pytest.raises(Refusal, match=r"must be 1 or 0|should be from") as refused:
        setpoint_of(topics.WINCH_COMMAND, sample)
    assert refused.value.code is RefusalCode.OUT_OF_LIMITS


def test_a_limit_smaller_than_a_count_stays_a_limit():
    setpoint = setpoint_of(topics.WINCH_COMMAND, winch())
    assert setpoint["max_torque"] == WINCH.by_key["max_torque"].scale


@pytest.mark.parametrize(
    ("topic", "joint", "rated"),
    [
        (topics.FLYWHEEL_COMMAND, machine.FLYWHEEL, 0.05),
        (topics.WHEEL_TORQUE_COMMAND, machine.WHEEL_DRIVE, 1.0),
    ],
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_torque_is_bounded_by_the_drive_s_limit_which_the_bridge_leaves_open(
    topic: str, joint: str, rated: float, sign: float
):
    device = COMMANDED[topic]
    setpoint = setpoint_of(topic, JointSample(1, {joint: JointValue(0.0, 0.0, sign * 0.8 * rated)}))
    limit = device.by_key["max_torque"]
    for counts, torque in ((limit.counts(setpoint["max_torque"]), 0.8 * rated), (500, 0.5 * rated)):
        command = command_of(device, {**setpoint, "max_torque": limit.value(counts)})
        assert command is not None
        assert command[1][joint].effort == pytest.approx(sign * torque)


def test_only_a_closed_brake_at_zero_rate_requests_rest():
    topic = topics.WINCH_COMMAND
    assert requests_rest(topic, setpoint_of(topic, winch()))
    assert not requests_rest(topic, setpoint_of(topic, winch(brake=1.0)))
    assert not requests_rest(topic, setpoint_of(topic, winch(rate=0.1)))


def test_an_unsupported_mode_is_not_a_command():
    assert command_of(WINCH, {**AT_REST, "mode": 10}) is None
    assert command_of(JUMP, {**AT_REST, "mode": 9}) is None
    assert command_of(JUMP, AT_REST) is None
