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
"""

from msg_schemas.phases import PlantPhase
from msg_schemas.yaml_reader import read_yaml
from rover_sim.devices.actuators import COMMANDS
from rover_sim.interface.interface_factory import build_interface
from rover_sim.node.sim_loop import Simulation, Tick
from rover_sim.node.state_publisher import (
    StatePublisher,
    TruthRates,
    build_simulation,
    run_statistics,
    simulation_from,
    start_of,
)
from rover_sim.physics.ground.wheel_soil import (
    STEEPEST_WHEEL,
    Soil,
    Wheel,
    steady_wheel,
    wheel_on_soil,
)
from rover_sim.physics.tether.statics import StaticsError, static_equilibrium
from rover_sim.physics.tether.tether_section import TetherSection
from rover_sim.plants.ahead_of_time import compile_ahead
from rover_sim.plants.end_motion import EndMotion
from rover_sim.plants.held_cable import CableLaws, HeldCable, natural_curvature_of
from rover_sim.plants.planar_plant import PlanarPlant, PlanarState
from rover_sim.plants.plant import (
    Energies,
    Event,
    FlywheelCommand,
    JumpMotorCommand,
    Outcome,
    Plant,
    PlantCommand,
    State,
    StepResult,
    WheelRateCommand,
    WheelTorqueCommand,
    WinchCommand,
)
from rover_sim.plants.plant_factory import build_plant
from rover_sim.plants.process_pool import available_cores, worker_processes
from rover_sim.plants.run import JumpMetrics, Run, RunError, jump, jump_many, march, roll_out, run
from rover_sim.plants.saved_state import (
    STAMP,
    START,
    is_state,
    plain_state,
    read_state,
    write_state,
)
from rover_sim.plants.settling import SettlingError
from rover_sim.plants.spatial_displacement import Displacement, displaced
from rover_sim.plants.spatial_jump import SpatialJumpMetrics, spatial_jump
from rover_sim.plants.spatial_plant import SpatialPlant
from rover_sim.plants.spatial_state import SpatialState
from rover_sim.scenarios.scenario import (
    AnyScenario,
    Scenario,
    ScenarioError,
    SpatialScenario,
    dump_scenario,
    list_scenarios,
    load_overridden,
    load_planar,
    load_scenario,
    load_spatial,
    parse_override,
    scenario_from_mapping,
)
from rover_sim.scenarios.spatial_scenario import MOST_BENT

__all__ = [
    "COMMANDS",
    "MOST_BENT",
    "STAMP",
    "START",
    "STEEPEST_WHEEL",
    "AnyScenario",
    "CableLaws",
    "Displacement",
    "EndMotion",
    "Energies",
    "Event",
    "FlywheelCommand",
    "HeldCable",
    "JumpMetrics",
    "JumpMotorCommand",
    "Outcome",
    "PlanarPlant",
    "PlanarState",
    "Plant",
    "PlantCommand",
    "PlantPhase",
    "Run",
    "RunError",
    "Scenario",
    "ScenarioError",
    "SettlingError",
    "Simulation",
    "Soil",
    "SpatialJumpMetrics",
    "SpatialPlant",
    "SpatialScenario",
    "SpatialState",
    "State",
    "StatePublisher",
    "StaticsError",
    "StepResult",
    "TetherSection",
    "Tick",
    "TruthRates",
    "Wheel",
    "WheelRateCommand",
    "WheelTorqueCommand",
    "WinchCommand",
    "available_cores",
    "build_interface",
    "build_plant",
    "build_simulation",
    "compile_ahead",
    "displaced",
    "dump_scenario",
    "is_state",
    "jump",
    "jump_many",
    "list_scenarios",
    "load_overridden",
    "load_planar",
    "load_scenario",
    "load_spatial",
    "march",
    "natural_curvature_of",
    "parse_override",
    "plain_state",
    "read_state",
    "read_yaml",
    "roll_out",
    "run",
    "run_statistics",
    "scenario_from_mapping",
    "simulation_from",
    "spatial_jump",
    "start_of",
    "static_equilibrium",
    "steady_wheel",
    "wheel_on_soil",
    "worker_processes",
    "write_state",
]
