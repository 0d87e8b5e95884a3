"""Samples of the contract for state and observations of the descent. Pure."""

from __future__ import annotations

import math

from msg_schemas.machine import (
    CAMERA_RATE,
    DEPTH,
    DEPTH_GOAL,
    FLYWHEEL_BUDGET,
    FLYWHEEL_MOMENTUM,
    FLYWHEEL_TRAVEL,
    HEADING,
    HEADING_GOAL,
    PICTURE,
    SMEAR,
    STOPS_LEFT,
    SWING_ERROR,
    SWING_FREQUENCY,
    SWING_MAJOR,
    SWING_MINOR,
    SWING_PLANE,
    TILT_X,
    TILT_Y,
    TRAVEL_BUDGET,
    WALL_DISTANCE,
    WHEEL_BUDGET,
    WHEEL_MOMENTUM,
    YAW_ERROR,
)
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
        DEPTH: JointValue(controller.length, controller.estimator.rate),
        DEPTH_GOAL: JointValue(controller.length if math.isnan(goal) else goal),
        STOPS_LEFT: JointValue(float(len(controller.profile.stops))),
        SWING_MAJOR: JointValue(ellipse.major),
        SWING_MINOR: JointValue(ellipse.minor),
        SWING_PLANE: JointValue(ellipse.plane),
        SWING_FREQUENCY: JointValue(velocity=swing.frequency),
        SWING_ERROR: JointValue(velocity=swing.swing_error),
        TILT_X: JointValue(swing.tilt[1], swing.tilt_rate[1]),
        TILT_Y: JointValue(-swing.tilt[0], -swing.tilt_rate[0]),
        HEADING: JointValue(controller.heading, swing.yaw_rate),
        HEADING_GOAL: JointValue(math.remainder(controller.turn.angle + remaining, math.tau)),
        YAW_ERROR: JointValue(velocity=swing.yaw_error),
        CAMERA_RATE: JointValue(velocity=swing.camera_rate),
        WHEEL_MOMENTUM: JointValue(-wheels.momentum),
        WHEEL_BUDGET: JointValue(-wheels.momentum / wheels.budget),
        FLYWHEEL_MOMENTUM: JointValue(flywheel.momentum),
        FLYWHEEL_BUDGET: JointValue(flywheel.momentum / flywheel.budget),
        FLYWHEEL_TRAVEL: JointValue(travel),
        TRAVEL_BUDGET: JointValue(travel / rotors.screw_travel),
    }
    return JointSample(now_ns, values)


def observation_sample(observation: Observation) -> JointSample:
    """Sample of a picture, stamped with the time of its exposure."""
    exposure = observation.exposure
    values = {
        PICTURE: JointValue(float(observation.number)),
        DEPTH: JointValue(exposure.depth),
        HEADING: JointValue(exposure.heading),
        CAMERA_RATE: JointValue(velocity=exposure.camera_rate),
    }
    for name, value in ((SMEAR, observation.smear), (WALL_DISTANCE, observation.wall_distance)):
        if math.isfinite(value):
            values[name] = JointValue(value)
    return JointSample(round(exposure.time * 1e9), values)
