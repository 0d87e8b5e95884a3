"""Names of all topics and services: relative, so that namespaces and remapping work.

The clock alone is absolute, by ROS convention: every time source listens there.
"""

CLOCK = "/clock"

TRUTH_BODY1 = "truth/body1"
TRUTH_BODY2 = "truth/body2"
TRUTH_TETHER = "truth/tether"
TRUTH_ENERGY = "truth/energy"
TRUTH_PHASE = "truth/phase"

IMU = "sensors/imu"
CONTACT = "sensors/contact"
LOAD_CELL = "sensors/load_cell"
ROVER_LOAD_CELL = "sensors/rover_load_cell"
MOTOR_CURRENTS = "sensors/motor_currents"
CAMERA = "sensors/camera"
JUMP_MOTOR_STATE = "jump_motor/state"
FLYWHEEL_STATE = "flywheel/state"
WHEEL_STATE = "wheel_motor/state"
WINCH_STATE = "winch/state"

JUMP_MOTOR_COMMAND = "jump_motor/command"
FLYWHEEL_COMMAND = "flywheel/command"
WHEEL_COMMAND = "wheel_motor/command"
WHEEL_TORQUE_COMMAND = "wheel_motor/torque_command"
WINCH_COMMAND = "winch/command"

JUMP_REQUEST = "jump/request"
JUMP_PHASE = "jump/phase"
WINCH_REQUEST = "winch/request"
WINCH_TRIM = "winch/trim"
WINCH_ESTIMATE = "winch/estimate"
WINCH_MODE = "winch/mode"
WINCH_ALARMS = "winch/alarms"
TENSION_WATCH = "winch/tension_watch"

CONFIG = "config"
EVENTS = "events"
DIAGNOSTICS = "diagnostics"
SIM_STATUS = "sim/status"
MARKERS = "markers"

SIM_PAUSE = "sim/pause"
SIM_STEP = "sim/step"
SIM_RESET = "sim/reset"
SIM_RESET_PLANT = "sim/reset_plant"
JUMP_ABORT = "jump/abort"
WINCH_HOLD = "winch/hold"
WINCH_RELAX = "winch/relax"
WINCH_STOP = "winch/stop"
WINCH_REARM = "winch/rearm"
