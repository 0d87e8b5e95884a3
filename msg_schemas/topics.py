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
JUMP_MOTOR_STATE = "jump_motor/state"
WINCH_STATE = "winch/state"

JUMP_MOTOR_COMMAND = "jump_motor/command"
WINCH_COMMAND = "winch/command"

JUMP_REQUEST = "jump/request"
JUMP_PHASE = "jump/phase"
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
