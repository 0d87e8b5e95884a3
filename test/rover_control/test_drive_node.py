"""drive_node as a process, with the mock plant."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest
from driving import ON_MOCK_PLANT
from graph import forbidden_to_controllers, subscriptions_of

from msg_schemas import topics
from msg_schemas.events import DriveEvent
from msg_schemas.phases import DrivePhase
from msg_schemas.samples import OdometrySample, PoseEstimateSample, PoseSample, TwistSample

if TYPE_CHECKING:
    from rover_verify.harness import NodeHarness

pytestmark = [pytest.mark.ros, pytest.mark.process]

# Standing on the floor with a slack tether; in real time, so that no sample is lost under load.
PLANT = {
    "scenario": "floor_rubble",
    "overrides": '{"tether.length": 30.0, "start.position": [1.0, 0.0]}',
    "real_time_factor": 1.0,
}
DRIVE = {"use_sim_time": True, **ON_MOCK_PLANT}


def test_a_goal_is_reached_and_impossible_requests_are_refused(harness: NodeHarness):
    observer = harness.observer()
    for name in (topics.DIAGNOSTICS, topics.DRIVE_PHASE, topics.DRIVE_STATE, topics.POSE):
        observer.listen(name)
    truth = observer.listen(topics.TRUTH_BODY1)
    harness.processes.start("rover_sim.node.mock_plant_node", PLANT)
    node = harness.processes.start("rover_control.drive.drive_node", DRIVE)
    observer.wait_until_ready("drive_node")
    assert not subscriptions_of(observer, "drive_node", topics.CMD_VEL) & forbidden_to_controllers()

    observer.send(topics.CMD_VEL, TwistSample(0, (-0.1, 0.0, 0.0), (0.0, 0.0, 0.0)))
    refusal = observer.wait_for_refusal(topics.CMD_VEL, "not_supported")
    assert "ratchet" in refusal.message
    observer.send(topics.DRIVE_GOAL, PoseSample(0, (500.0, 0.0, 0.0)))
    observer.wait_for_refusal(topics.DRIVE_GOAL, "out_of_limits")

    ahead = (0.0, 0.0, 0.0, 1.0)
    observer.send(topics.DRIVE_START, PoseEstimateSample(0, (1.0, 0.0, 0.0), ahead))
    observer.wait_for_event(DriveEvent.POSE_SET)
    observer.send(topics.DRIVE_GOAL, PoseSample(0, (2.0, 0.6, 0.0)))
    observer.wait_for_event(DriveEvent.COMPLETED)
    observer.wait_for_text(topics.DRIVE_PHASE, DrivePhase.RELEASED)
    true: OdometrySample = truth.last
    # The mock plant turns about the middle of its axle, not about the pivot.
    assert math.dist(true.position[:2], (2.0, 0.6)) < 0.5
    seen: PoseEstimateSample = observer.listen(topics.POSE).last
    assert math.dist(seen.position[:2], (2.0, 0.6)) < 0.11
    assert len(seen.pose_covariance) == 36
    assert observer.call(topics.DRIVE_STOP).success
    assert node.stop() == 0
