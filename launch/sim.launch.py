"""The plant alone, with optional recorder and RViz.

ros2 launch mother_rover sim.launch.py scenario:=lunar_jump real_time_factor:=2.0 record:=bag1
ros2 launch mother_rover sim.launch.py plant:=mock namespace:=rover2
"""

from launch import LaunchDescription

from rover_launch.description import describe


def generate_launch_description() -> LaunchDescription:
    return describe()
