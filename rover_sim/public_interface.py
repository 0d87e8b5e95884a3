"""The names of the package's public interface; the package describes it and has them all."""

from msg_schemas.phases import PlantPhase
from msg_schemas.yaml_reader import read_yaml
from rover_sim.devices.actuators import COMMANDS
from rover_sim.interface.interface_factory import build_interface
from rover_sim.node.publishing_rates import TruthRates
from rover_sim.node.sim_loop import Simulation, Tick
from rover_sim.node.state_publisher import (
    StatePublisher,
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
