"""Names of frames, joints and scalars in messages, and the contract's limits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

WORLD_FRAME = "map"
ODOM_FRAME = "odom"
FAIRLEAD_FRAME = "fairlead"
BODY1_FRAME = "base_link"
BODY2_FRAME = "body2"
CAMERA_FRAME = "camera"
CAMERA_OPTICAL_FRAME = "camera_optical"
IMU_FRAME = "imu"
TETHER_FRAME = "tether_attachment"
SWITCH_FRAME = "contact_switches"
TRUTH_PREFIX = "truth/"
TRUTH_BODY1_FRAME = TRUTH_PREFIX + BODY1_FRAME
TRUTH_BODY2_FRAME = TRUTH_PREFIX + BODY2_FRAME

FRAMES: Mapping[str, str] = MappingProxyType(
    {
        WORLD_FRAME: "fixed to the mother machine: origin at the fairlead, x forward along the "
        "jumping plane, z up against gravity",
        ODOM_FRAME: "where the odometry began; moves in map where the estimated pose is corrected, "
        "such as at the touchdown",
        FAIRLEAD_FRAME: "the fairlead with its load cell, axes of map",
        BODY1_FRAME: "Body 1 (wheels, motors, tether attachment): origin at its centre of mass, "
        "x forward, y left along the wheels' axle, z up along the slider",
        BODY2_FRAME: "Body 2 (the mass that jumps): origin at its centre of mass, axes of Body 1",
        CAMERA_FRAME: "the wall camera: x along its optical axis",
        CAMERA_OPTICAL_FRAME: "the wall camera: z along its optical axis, x right and y down in "
        "the picture",
        IMU_FRAME: "the IMU, axes of Body 1",
        TETHER_FRAME: "the tether's attachment with its load cell, axes of Body 1",
        SWITCH_FRAME: "the contact switches, between the wheels at their lowest points, axes of "
        "Body 1",
        TRUTH_BODY1_FRAME: "the true Body 1; so have all links of the simulated rover a frame",
        TRUTH_BODY2_FRAME: "the true Body 2",
    }
)

# Joints of the drives.
JUMP_SCREW = "jump_screw"
JUMP_SLIDER = "jump_slider"  # of the robot description: Body 2 on Body 1
JUMP_LATCH = "jump_latch"
FLYWHEEL = "flywheel"
WHEEL_DRIVE = "wheel_drive"
WHEEL_LEFT = "wheel_left"
WHEEL_RIGHT = "wheel_right"
WINCH_DRUM = "winch_drum"
WINCH_BRAKE = "winch_brake"
WINCH_LIMIT = "winch_limit"

# Motors, in the topic of their currents.
JUMP_MOTOR = "jump_motor"
WHEEL_MOTOR = "wheel_motor"
WINCH_MOTOR = "winch_motor"

# Contact switches; those of the wheels have the wheels' names.
FLOOR_SWITCH = "floor"
BODY_SWITCH = "body"

# Measurements of the wall camera.
WALL_DISTANCE = "wall_distance"
SMEAR = "smear"
NO_WALL = 1000.0
"""Reading of the range finder without a wall in range [m]."""
STEADY_CAMERA_RATE = math.radians(0.14)
"""Largest camera rate of a sharp picture [rad/s]."""
SHARP_SMEAR = STEADY_CAMERA_RATE * 0.1 / 0.5e-3
"""Largest smear of a sharp picture [px]: of this rate over 0.1 s, with pixels of 0.5 mrad."""

# Requests.
JUMP_STROKE = "jump_stroke"
JUMP_HEIGHT = "jump_height"
JUMP_CLEARANCE = "jump_clearance"
JUMP_PREDICTION = "jump_prediction"
OBSERVATION_STOP = "observation_stop"
PLAIN_STOP = "plain_stop"
HEADING_TURN = "heading_turn"
WINCH_TO_LENGTH = "winch_length"
WINCH_WHILE_RENEWED = "winch_length_renewed"
WINCH_AT_RATE = "winch_rate"
WINCH_AT_TENSION = "winch_tension"
WINCH_SLACK = "winch_slack"

# Predicted and measured values of a jump.
JUMP_REQUESTED = "jump_requested"
JUMP_RANGE = "jump_range"
JUMP_AHEAD = "jump_ahead"
JUMP_LEFT = "jump_left"
JUMP_TURN = "jump_turn"
JUMP_TILT = "jump_tilt"
JUMP_TIME = "jump_time"
JUMP_TENSION = "jump_tension"
JUMP_SLACK = "jump_slack"
UPRIGHT = "upright"
ROLLOUTS = "rollouts"
SPRING_GAIN = "spring_gain"
SPRING_ZERO = "spring_zero"
# Estimates of the winch.
PAYOUT = "payout"
STRETCHED = "stretched"
TENSION = "tension"
TETHER_OUT = "tether_out"
REFERENCE = "reference"
# Estimates of the descent controller, and data of a picture.
SWING_MAJOR = "swing_major"
SWING_MINOR = "swing_minor"
SWING_PLANE = "swing_plane"
SWING_FREQUENCY = "swing_frequency"
SWING_ERROR = "swing_error"
TILT_X = "tilt_about_x"
TILT_Y = "tilt_about_y"
HEADING = "heading"
HEADING_GOAL = "heading_goal"
YAW_ERROR = "yaw_error"
CAMERA_RATE = "camera_rate"
WHEEL_MOMENTUM = "wheel_momentum"
WHEEL_BUDGET = "wheel_budget"
FLYWHEEL_MOMENTUM = "flywheel_momentum"
FLYWHEEL_BUDGET = "flywheel_budget"
FLYWHEEL_TRAVEL = "flywheel_travel"
TRAVEL_BUDGET = "travel_budget"
DEPTH = "depth"
DEPTH_GOAL = "depth_goal"
STOPS_LEFT = "stops_left"
PICTURE = "picture"

# Estimates of the drive controller.
FORWARD = "forward"
YAW = "yaw"
PITCH = "pitch"
ROLL = "roll"
SLIP = "slip"
GYRO_BIAS = "gyro_bias"
GOAL_DISTANCE = "goal_distance"
GOALS_LEFT = "goals_left"
POSITION_ERROR = "position_error"
HEADING_ERROR = "heading_error"
WHEEL_EFFORT = "wheel_effort"
TETHER_RANGE = "tether_range"
TETHER_DROP = "tether_drop"

# Progress of the mission.
MISSION_LEG = "mission_leg"
LEGS_LEFT = "legs_left"
FAILED_TRIALS = "failed_trials"
PICTURES_TAKEN = "pictures_taken"
JUMPS_FLOWN = "jumps_flown"

# Alarms of the winch.
TOUCHDOWN = "touchdown"
SLACK = "slack"
SNAG = "snag"
OVER_TENSION = "over_tension"
ALARM_NAMES = (TOUCHDOWN, SLACK, SNAG, OVER_TENSION)

ENERGY_NAMES = (
    "kinetic", "rotors", "gravity", "axial", "bending", "twist", "spring", "contact",
    "input", "driven_ends", "dissipated", "air_drag", "drift",
)  # fmt: skip

MAX_STROKE = 0.40  # [m]
MAX_FREE_TRAVEL = 0.10  # of the nut above the latch [m]
MAX_NUT_SPEED = 0.5  # [m/s]
MAX_JUMP_HEIGHT = 10.0  # [m]
MAX_NUT_FORCE = 1000.0  # [N]
MAX_FLYWHEEL_TORQUE = 1.0  # [N m]
MAX_WHEEL_RATE = 20.0  # [rad/s]
MAX_WHEEL_TORQUE = 20.0  # [N m]
MAX_DRIVE_SPEED = 1.0  # [m/s]
MAX_TURN_RATE = 3.0  # [rad/s]
MAX_TENSION = 5000.0  # [N]
MAX_LENGTH = 1000.0  # [m]
MAX_PAYOUT_RATE = 0.5  # [m/s]
MAX_RATE_TRIM = 0.3  # [m/s]
MAX_SLACK = 20.0  # [m]
SMALLEST_LIMIT = 0.01  # of a force that a motor may use [N]
# Of the commands of a moving winch: 0.25 s that it bears and one tick (docs/winch.md) [s].
WINCH_TIMEOUT_MOVING = 0.26
