"""Published samples of the mission supervisor. Pure."""

from __future__ import annotations

from msg_schemas import machine
from msg_schemas.samples import JointSample, JointValue
from rover_control.mission.mission_supervisor import Mission


def state_sample(mission: Mission, now_ns: int) -> JointSample:
    """Progress of the mission."""
    number = mission.route.number
    values = {
        machine.MISSION_LEG: number,
        machine.LEGS_LEFT: len(mission.route.legs) - number if number else 0,
        machine.FAILED_TRIALS: mission.failed_trials,
        machine.PICTURES_TAKEN: mission.blackboard.pictures,
        machine.JUMPS_FLOWN: mission.blackboard.jumps,
    }
    return JointSample(now_ns, {name: JointValue(float(value)) for name, value in values.items()})
