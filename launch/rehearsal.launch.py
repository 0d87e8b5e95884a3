"""The hanging rover with drives on a link: bridge, drive emulator, winch and descent controllers.

ros2 launch mother_rover rehearsal.launch.py record:=rehearsal_bag
ros2 service call /drives/arm std_srvs/srv/SetBool "{data: true}"
ros2 service call /winch/rearm std_srvs/srv/Trigger
ros2 topic pub --once /descent/request sensor_msgs/msg/JointState \
    "{name: [observation_stop], position: [12.0]}"

With the real drives:

ros2 launch mother_rover rehearsal.launch.py drives:=socketcan:can0
"""

from launch import LaunchDescription

from rover_launch.description import describe
from rover_launch.plan import HANGING_DEFAULTS, HIL


def generate_launch_description() -> LaunchDescription:
    return describe("winch_node", "descent_node", plant=HIL, **HANGING_DEFAULTS)
