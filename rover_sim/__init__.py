"""The plant: a tethered rover, simulated.

This is the public interface for studies and notebooks; the nodes use it too. A scenario defines
what is simulated, a plant steps it, `run` and `jump` simulate up to an event:

>>> from rover_sim import build_plant, jump, load_scenario
>>> scenario = load_scenario("paper_table1_high", {"start.geometry": "+K", "start.slack": 2.0})
>>> plant = build_plant(scenario)
>>> metrics = jump(plant)
>>> print(f"{metrics.height:.3f} m, {metrics.attitude_variation:+.2f} rad")
0.309 m, +0.66 rad

The same jump tick by tick. States are immutable, so they can be kept and reused:

>>> from rover_sim import JumpMotorCommand, PlantCommand
>>> state = plant.initial_state()
>>> command = PlantCommand(jump=JumpMotorCommand(compression=0.2, rate=2.0))
>>> state, result = plant.step(state, command, 0.2)
>>> state.phase.value, [event.name.value for event in result.events], result.outcome.value
('flight', ['take_off'], 'converged')

The spatial plant has a floor with rubble, winch, drives and sensors. Parallel runs use all cores:

>>> from rover_sim import roll_out
>>> plant = build_plant(load_scenario("floor_rubble"))
>>> standing = plant.initial_state()
>>> strokes = (0.10, 0.15, 0.20)
>>> jumps = [PlantCommand(jump=JumpMotorCommand(stroke, rate=0.05)) for stroke in strokes]
>>> for flown in roll_out(plant, [standing], jumps, duration=12.0):
...     print(f"{flown.event('apex').values['height']:.1f} m high, {flown.peak_tension:.0f} N")
0.1 m high, 0 N
0.2 m high, 1 N
0.4 m high, 1 N

The plant's interface yields the samples of the contract's topics; sensor readings have the
scenario's noise, bias and delay:

>>> from msg_schemas import topics
>>> from rover_sim import build_interface
>>> outside = build_interface(plant, seed=1)
>>> outside.restart(standing, stamp_ns=0)
>>> state, result = plant.step(standing, PlantCommand(), 0.01)
>>> outside.measure(state, 10_000_000, result)
>>> imu = dict(outside.samples([topics.IMU]))[topics.IMU]
>>> print(f"{imu.linear_acceleration[2]:.1f} m/s2")
1.6 m/s2

The names are imported when the first of them is used: a node starts, and the middleware finds the
others, before the node imports the plant.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rover_sim.public_interface import *  # noqa: F403 - it lists its names


def __getattr__(name: str) -> Any:
    """Return a name of the public interface."""
    return getattr(importlib.import_module("rover_sim.public_interface"), name)
