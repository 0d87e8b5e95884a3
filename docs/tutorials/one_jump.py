"""A jump of the source paper, without ROS."""

from rover_sim import build_plant, jump, load_scenario

scenario = load_scenario("paper_table1_high", {"start.geometry": "+K", "start.slack": 2.0})
metrics = jump(build_plant(scenario))
print(f"{metrics.height:.3f} m, {metrics.attitude_variation:+.2f} rad")
