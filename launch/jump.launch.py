"""The rover with jump and winch controllers; arguments as sim.launch.py.

ros2 launch mother_rover jump.launch.py
ros2 topic pub --once /jump/request sensor_msgs/msg/JointState \
    "{name: [jump_stroke], position: [0.2], velocity: [0.1], effort: [0.0]}"
"""

from launch import LaunchDescription

from rover_launch.description import describe


def generate_launch_description() -> LaunchDescription:
    return describe("jump_node", "winch_node")
