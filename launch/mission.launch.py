"""The whole mission: the plant, all controllers and their supervisor; arguments as sim.launch.py.

ros2 launch mother_rover mission.launch.py rviz:=true
ros2 launch mother_rover mission.launch.py plant:=mock namespace:=rover1
ros2 launch mother_rover mission.launch.py plant:=hil drives:=socketcan:can0
"""

from launch import LaunchDescription

from rover_launch.description import describe
from rover_launch.plan import HANGING_DEFAULTS


def generate_launch_description() -> LaunchDescription:
    return describe(
        "winch_node", "descent_node", "drive_node", "jump_node", "mission_node", **HANGING_DEFAULTS
    )
