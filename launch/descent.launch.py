"""The hanging rover with winch and descent controllers; arguments as sim.launch.py.

ros2 launch mother_rover descent.launch.py record:=descent_bag
ros2 service call /winch/rearm std_srvs/srv/Trigger
ros2 topic pub --once /descent/request sensor_msgs/msg/JointState \
    "{name: [observation_stop], position: [12.0]}"
"""

from launch import LaunchDescription

from rover_launch.description import describe
from rover_launch.plan import HANGING_DEFAULTS


def generate_launch_description() -> LaunchDescription:
    return describe("winch_node", "descent_node", **HANGING_DEFAULTS)
