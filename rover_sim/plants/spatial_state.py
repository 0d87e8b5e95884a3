"""State of the spatial plant, and its conversion to and from arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TypedDict, Unpack

import numpy as np

from msg_schemas.phases import PlantPhase
from rover_sim.physics.ground.rover_contact import anchor_rows
from rover_sim.physics.integrators import integrator_memory, session
from rover_sim.physics.integrators.drive_states import (
    DRUM_ANGLE,
    LATCH,
    DriveStates,
    read_drives,
    write_drives,
)
from rover_sim.physics.integrators.session import Session, vector_size
from rover_sim.physics.mechanisms.jump_drive import Latch
from rover_sim.physics.rover import spatial_rover
from rover_sim.physics.tether.ancf import Array
from rover_sim.physics.tether.carried_frames import set_relaxed
from rover_sim.scenarios.hardware import RoverSettings

FRAME_ROWS = 6
"""Rows of `SpatialState.frames`."""

_ENERGY_BALANCE = {
    "input_jump_motor": integrator_memory.INPUT_JUMP,
    "input_wheel_motor": integrator_memory.INPUT_WHEELS,
    "input_winch_motor": integrator_memory.INPUT_WINCH,
    "input_driven_ends": integrator_memory.INPUT_ENDS,
    "input_rotors": integrator_memory.INPUT_ROTORS,
    "input_tether_paid_out": integrator_memory.INPUT_TETHER,
    "input_remeshing": integrator_memory.INPUT_REMESHING,
    "heat_tether": integrator_memory.HEAT_TETHER,
    "heat_slider": integrator_memory.HEAT_SLIDER,
    "heat_jump_drive": integrator_memory.HEAT_JUMP,
    "heat_wheel_drive": integrator_memory.HEAT_WHEELS,
    "heat_winch": integrator_memory.HEAT_WINCH,
    "heat_rover_on_ground": integrator_memory.HEAT_ROVER_GROUND,
    "heat_tether_on_ground": integrator_memory.HEAT_TETHER_GROUND,
    "heat_swivel": integrator_memory.HEAT_SWIVEL,
    "heat_air": integrator_memory.HEAT_AIR,
}


class StateParts(TypedDict, total=False):
    """Parts of a `SpatialState`; its properties describe them."""

    phase: PlantPhase
    nodes: Array
    node_rates: Array
    fairlead_slope: Array
    body: Array
    rover_anchors: Array
    tether_anchors: Array
    frames: Array
    drives: DriveStates
    memory: Array


@dataclass(frozen=True, eq=False)
class SpatialState:
    """State of the spatial plant; its arrays are read-only.

    World axes are map: origin at the fairlead, x forward, y left, z up; body axes are base_link.
    Without a rover the fields of the bodies are zero. With a winch the tether's first element, of
    variable length, connects the fairlead to nodes[0]; without one nodes[0] is the root at the
    fairlead. The elements from nodes[0] on form the chain.

    `from_parts` makes a state from its parts, `replaced` one with other parts.
    """

    phase: PlantPhase
    vector: Array  # its parts: see `rover_sim.physics.integrators.session`
    rows: Array  # coordinates, then rates, of the chain's nodes, (12, n + 1)
    tether_anchors: Array  # two for each element of the chain [m], (2 n, 3)
    frames: Array  # of a tether with natural curvature: d1 of the chain's nodes, and the twist
    # of the element after each node [rad], last that of the element at the fairlead; the relaxed
    # curvature of the nodes [1/m]: (6, n + 1), see `natural_curvature`. Of a straight one: (6, 0)

    @classmethod
    def from_parts(cls, **parts: Unpack[StateParts]) -> SpatialState:
        """Copy all parts to a new state."""
        anchors = np.asarray(parts["rover_anchors"])
        vector = np.zeros(vector_size(len(anchors) - anchor_rows(0)))
        vector[session.MEMORY] = parts["memory"]
        write_drives.py_func(parts["drives"], vector[session.DRIVES])
        vector[session.BODY] = parts["body"]
        vector[session.SLOPE] = np.ravel(parts["fairlead_slope"])
        vector[session.ANCHORS] = np.ravel(anchors)
        nodes = np.stack([parts["nodes"], parts["node_rates"]], axis=1)
        rows = np.ascontiguousarray(nodes.reshape(len(nodes), 12).T)
        return cls(
            parts["phase"],
            _read_only(vector),
            _read_only(rows),
            _read_only(np.array(parts["tether_anchors"], dtype=np.float64)),
            _read_only(np.array(parts["frames"], dtype=np.float64)),
        )

    def replaced(self, **changes: Unpack[StateParts]) -> SpatialState:
        """Return a state with changed parts."""
        parts: StateParts = {
            "phase": self.phase,
            "nodes": self.nodes,
            "node_rates": self.node_rates,
            "fairlead_slope": self.fairlead_slope,
            "body": self.body,
            "rover_anchors": self.rover_anchors,
            "tether_anchors": self.tether_anchors,
            "frames": self.frames,
            "drives": self.drives,
            "memory": self.memory,
        }
        parts.update(changes)
        return self.from_parts(**parts)

    # --------------------------------------------------------------------------------- parts

    @property
    def memory(self) -> Array:
        """The integrator's memory, see `rover_sim.physics.integrators.integrator_memory`."""
        return self.vector[session.MEMORY]

    @property
    def body(self) -> Array:
        """Of the rover, as in `rover_sim.physics.rover.spatial_rover`, (20,)."""
        return self.vector[session.BODY]

    @property
    def fairlead_slope(self) -> Array:
        """Slope [-] and slope rate [1/s] of the tether at the fairlead, (2, 3)."""
        return self.vector[session.SLOPE].reshape(2, 3)

    @property
    def rover_anchors(self) -> Array:
        """Of corners and wheels [m], and their rocks; see `rover_contact`."""
        return self.vector[session.ANCHORS].reshape(-1, 3)

    @cached_property
    def drives(self) -> DriveStates:
        """States of jump drive, drum and wheel drive."""
        states: DriveStates = read_drives.py_func(self.vector[session.DRIVES].tolist())
        return states

    @cached_property
    def nodes(self) -> Array:
        """Of the chain, (n + 1, 2, 3): [i, 0] position [m], [i, 1] slope r' [-] of node i."""
        return _nodes_of(self.rows[:6])

    @cached_property
    def node_rates(self) -> Array:
        """The same per second."""
        return _nodes_of(self.rows[6:])

    @property
    def time(self) -> float:
        """[s]."""
        return float(self.vector[integrator_memory.TIME])

    # ---------------------------------------------------------------------------------- bodies

    @property
    def G1(self) -> Array:
        """Centre of Body 1, the origin of base_link [m], (3,)."""
        return self.body[spatial_rover.POSITION : spatial_rover.POSITION + 3]

    @property
    def G1_rate(self) -> Array:
        """[m/s], (3,)."""
        return self.body[spatial_rover.VELOCITY1 : spatial_rover.VELOCITY1 + 3]

    @property
    def G2_rate(self) -> Array:
        """Velocity of Body 2's centre [m/s], (3,)."""
        return self.body[spatial_rover.VELOCITY2 : spatial_rover.VELOCITY2 + 3]

    @cached_property
    def orientation(self) -> Array:
        """Quaternion (x, y, z, w), base_link to map; Body 2 has the same."""
        w, x, y, z = self.body[spatial_rover.ORIENTATION : spatial_rover.ORIENTATION + 4]
        return np.array([x, y, z, w])

    @cached_property
    def rotation(self) -> Array:
        """Rotation matrix, base_link to map, (3, 3)."""
        return rotation_matrix(self.body[spatial_rover.ORIENTATION : spatial_rover.ORIENTATION + 4])

    @property
    def omega(self) -> Array:
        """Angular velocity of both bodies in base_link [rad/s], (3,)."""
        return self.body[spatial_rover.SPIN : spatial_rover.SPIN + 3]

    @property
    def s(self) -> float:
        """Distance of the bodies' centres along the slider [m]."""
        return float(self.body[spatial_rover.SLIDE])

    def centre2(self, rover: RoverSettings) -> Array:
        """Return the centre of Body 2 of a rover [m], (3,)."""
        return np.asarray(self.G1 + self.rotation @ rover.body2_place(self.s), dtype=np.float64)

    # ---------------------------------------------------------------------------------- drives

    @property
    def length(self) -> float:
        """Payout, the unstretched length at the drum [m]; only with a winch."""
        return self.drives.drum.length

    @property
    def drum_angle(self) -> float:
        """Angle of the drum, zero when nothing is paid out [rad]."""
        return float(self.vector[session.DRIVES.start + DRUM_ANGLE])

    @property
    def drum_rate(self) -> float:
        """[rad/s], > 0 pays out."""
        return self.drives.drum.rate

    @property
    def braked(self) -> bool:
        """Whether the winch's brake is closed."""
        return self.drives.drum.braked

    @property
    def latch(self) -> Latch:
        """State of nut and latch."""
        return Latch(int(self.vector[session.DRIVES.start + LATCH]))

    @property
    def nut(self) -> float:
        """Position of the nut as compression of the spring [m]; below 0 it is above the latch."""
        return self.drives.jump.nut

    @property
    def flywheel_rate(self) -> float:
        """Rate of the jump motor's shaft relative to Body 1 [rad/s], > 0 drives the nut down."""
        return self.drives.jump.rate

    @property
    def wheel_angles(self) -> tuple[float, float]:
        """Left and right, relative to Body 1 [rad]."""
        wheels = self.drives.wheels
        return wheels.left_angle, wheels.right_angle

    @property
    def wheel_rates(self) -> tuple[float, float]:
        """Left and right, relative to Body 1 [rad/s]."""
        return self.drives.wheels.left, self.drives.wheels.right

    # ---------------------------------------------------------------------------------- tether

    @property
    def elements(self) -> int:
        """Number of elements of the chain, n."""
        return len(self.nodes) - 1

    @property
    def tip(self) -> Array:
        """The tether's attachment at the rover [m], (3,)."""
        return np.asarray(self.nodes[-1, 0])

    @property
    def twist(self) -> float:
        """Elastic twist of the tether [rad]."""
        return float(
            self.memory[integrator_memory.TWIST] - self.memory[integrator_memory.SWIVEL_SLIP]
        )

    @property
    def energy_balance(self) -> Mapping[str, float]:
        """Energy input and heat since the start of the run [J], by name."""
        return {name: float(self.memory[entry]) for name, entry in _ENERGY_BALANCE.items()}

    # ----------------------------------------------------------------------------- comparisons

    def turn_from(self, other: SpatialState) -> float:
        """Change of the heading since another state [rad], > 0 from x towards y."""
        before, after = other.rotation[:2, 0], self.rotation[:2, 0]
        return math.atan2(
            before[0] * after[1] - before[1] * after[0],
            before[0] * after[0] + before[1] * after[1],
        )

    def tilt_from(self, other: SpatialState) -> float:
        """Angle between the directions of base_link's z in this and another state [rad]."""
        leaning = float(other.rotation[:, 2] @ self.rotation[:, 2])
        return math.acos(max(-1.0, min(1.0, leaning)))


_NO_FRAMES = np.zeros((FRAME_ROWS, 0))


def rotation_matrix(quaternion: Array) -> Array:
    """Return the rotation matrix (3, 3), body to world, of a quaternion (w, x, y, z)."""
    w, x, y, z = quaternion
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


_INPUTS = np.array([entry for name, entry in _ENERGY_BALANCE.items() if name.startswith("input")])
_HEATS = np.array([entry for name, entry in _ENERGY_BALANCE.items() if name.startswith("heat")])


def energy_balance_sums(memory: Array) -> tuple[float, float]:
    """Return total input and heat since the start of the run [J]."""
    return sum(memory[_INPUTS].tolist()), sum(memory[_HEATS].tolist())


def load_state(state: SpatialState, to: Session) -> None:
    """Copy the state to the session's arrays."""
    nodes, anchors = state.rows.shape[1], len(state.tether_anchors)
    to.vector[:] = state.vector
    # what lies beyond the tether must be finite: packets read it
    to.rows[:, nodes:] = 0.0
    to.rows[:, :nodes] = state.rows
    to.motion.tether_anchors[anchors:] = 0.0
    to.motion.tether_anchors[:anchors] = state.tether_anchors
    if to.natural.active:
        to.natural.director[:, :nodes] = state.frames[:3]
        to.natural.twist[: nodes - 1] = state.frames[3, :-1]
        to.natural.exit[0] = state.frames[3, -1]
        if to.natural.relaxation.share > 0.0:
            for node, relaxed in enumerate(state.frames[4:].T.tolist()):
                set_relaxed.py_func(to.natural, nodes - 1 - node, relaxed)


def state_of(source: Session, phase: PlantPhase) -> SpatialState:
    """Return a copy of the session's state."""
    elements = int(source.memory[integrator_memory.ELEMENTS])
    return SpatialState(
        phase,
        _read_only(source.vector.copy()),
        _read_only(source.rows[:, : elements + 1].copy()),
        _read_only(source.motion.tether_anchors[: 2 * elements].copy()),
        _read_only(_frames_of(source, elements)),
    )


def _frames_of(source: Session, elements: int) -> Array:
    """Copy of the tether's frames; see `SpatialState`."""
    law = source.natural
    if not law.active:
        return _NO_FRAMES
    return np.vstack([
        law.director[:, : elements + 1],
        [*law.twist[:elements], law.exit[0]],
        law.relaxed[:, elements::-1],
    ])  # fmt: skip


def _nodes_of(rows: Array) -> Array:
    """Nodes (n + 1, 2, 3) of the rows (6, n + 1) of a tether."""
    return _read_only(np.ascontiguousarray(rows.T).reshape(-1, 2, 3))


def _read_only(array: Array) -> Array:
    array.flags.writeable = False
    return array
