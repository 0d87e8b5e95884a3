"""Executable and module of every node, as `ros2 run`, launch files and tests start them."""

from __future__ import annotations

# Each module has a `main` that reads `sys.argv` and returns the exit code.
NODES = {
    "sim_node": "rover_sim.node.sim_node",
    "mock_plant": "rover_sim.node.mock_plant_node",
    "jump_node": "rover_control.jump.jump_node",
    "descent_node": "rover_control.hanging.descent_node",
    "drive_node": "rover_control.drive.drive_node",
    "mission_node": "rover_control.mission.mission_node",
    "winch_node": "tether_winch.winch_node",
    "mother_nodes": "rover_launch.mother_nodes",
    "rover_nodes": "rover_launch.rover_nodes",
    "operations_nodes": "rover_launch.operations_nodes",
    "view_node": "rover_view.view_node",
    "action_node": "rover_actions.action_node",
    "hil_bridge": "rover_hil.bridge.bridge_node",
    "drive_emulator": "rover_hil.emulator.emulator_node",
    "hil_rehearsal": "rover_hil.rehearsal.rehearsal_node",
    "operator_console": "operator_console.console_node",
    "bag_record": "rover_bags.recording.record",
}
