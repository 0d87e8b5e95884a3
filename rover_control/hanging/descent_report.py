"""Samples of the contract for state and observations of the descent. Pure."""

from __future__ import annotations

import math

from msg_schemas import machine
from msg_schemas.samples import JointSample, JointValue
from rover_control.hanging.descent import DescentController
from rover_control.hanging.observations import Observation


def state_sample(descent: DescentController, now_ns: int) -> JointSample | None:
    """State with estimates and setpoints; None before the first swing estimate."""
    controller = descent.controller
    swing = controller.swing
    if swing is None:
        return None
    ellipse = swing.ellipse
    wheels, flywheel = controller.wheels.axis, controller.flywheel.axis
    rotors = controller.parameters.rotors
    screw = descent.nut.screw
    travel = 0.0 if math.isnan(screw) else screw - rotors.screw_travel_centre
    goal = controller.profile.length_setpoint
    pointing = controller.pointing
    remaining = pointing.error(controller.turn.angle) if pointing.is_active else 0.0
    # A displacement along +x is a negative rotation about +y, one along +y a positive about +x.
    values = {
        machine.DEPTH: JointValue(controller.length, controller.estimator.rate),
        machine.DEPTH_GOAL: JointValue(controller.length if math.isnan(goal) else goal),
        machine.STOPS_LEFT: JointValue(float(len(controller.profile.stops))),
        machine.SWING_MAJOR: JointValue(ellipse.major),
        machine.SWING_MINOR: JointValue(ellipse.minor),
        machine.SWING_PLANE: JointValue(ellipse.plane),
        machine.SWING_FREQUENCY: JointValue(velocity=swing.frequency),
        machine.SWING_ERROR: JointValue(velocity=swing.swing_error),
        machine.TILT_X: JointValue(swing.tilt[1], swing.tilt_rate[1]),
        machine.TILT_Y: JointValue(-swing.tilt[0], -swing.tilt_rate[0]),
        machine.HEADING: JointValue(controller.heading, swing.yaw_rate),
        machine.HEADING_GOAL: JointValue(
            math.remainder(controller.turn.angle + remaining, math.tau)
        ),
        machine.YAW_ERROR: JointValue(velocity=swing.yaw_error),
        machine.CAMERA_RATE: JointValue(velocity=swing.camera_rate),
        machine.WHEEL_MOMENTUM: JointValue(-wheels.momentum),
        machine.WHEEL_BUDGET: JointValue(-wheels.momentum / wheels.budget),
        machine.FLYWHEEL_MOMENTUM: JointValue(flywheel.momentum),
        machine.FLYWHEEL_BUDGET: JointValue(flywheel.momentum / flywheel.budget),
        machine.FLYWHEEL_TRAVEL: JointValue(travel),
        machine.TRAVEL_BUDGET: JointValue(travel / rotors.screw_travel),
    }
    return JointSample(now_ns, values)


def observation_sample(observation: Observation) -> JointSample:
    """Sample of a picture, stamped with the time of its exposure."""
    exposure = observation.exposure
    values = {
        machine.PICTURE: JointValue(float(observation.number)),
        machine.DEPTH: JointValue(exposure.depth),
        machine.HEADING: JointValue(exposure.heading),
        machine.CAMERA_RATE: JointValue(velocity=exposure.camera_rate),
    }
    for name, value in (
        (machine.SMEAR, observation.smear),
        (machine.WALL_DISTANCE, observation.wall_distance),
    ):
        if math.isfinite(value):
            values[name] = JointValue(value)
    return JointSample(round(exposure.time * 1e9), values)
