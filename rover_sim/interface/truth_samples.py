"""Samples of the ground truth that all plants share."""

from __future__ import annotations

import numpy as np

from msg_schemas import machine
from msg_schemas.samples import JointSample, JointValue, TetherSample, TextSample
from rover_sim.physics.tether.ancf import Array
from rover_sim.plants.plant import Energies, State
from rover_sim.plants.saved_state import state_message


def tether_sample(stamp_ns: int, nodes: Array, tension: Array) -> TetherSample:
    """Return the sample of the tether's shape.

    Args:
        stamp_ns: simulated time.
        nodes: positions [m] and slopes in map, (n + 1, 2, 3).
        tension: at the nodes [N], (n + 1,).
    """
    return TetherSample(stamp_ns, np.column_stack([nodes[:, 0], nodes[:, 1], tension]))


def energy_sample(stamp_ns: int, energies: Energies) -> JointSample:
    """Return the sample of the energies and their balance [J]."""
    return JointSample(
        stamp_ns, {name: JointValue(getattr(energies, name)) for name in machine.ENERGY_NAMES}
    )


def state_sample(stamp_ns: int, state: State) -> TextSample:
    """Return the sample of a plant's whole state."""
    return TextSample(state_message(state, stamp_ns))
