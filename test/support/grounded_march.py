"""Steps a tether on a terrain with the parts of the kernel."""

from typing import Any

import numpy as np

from rover_sim.physics.ground.contact import contact_energy
from rover_sim.physics.ground.terrain import Terrain
from rover_sim.physics.ground.tether_contact import (
    POINTS,
    TetherContactParameters,
    add_tether_contact,
    begin_tether_contact,
    end_tether_contact,
    make_tether_contact,
    place_points,
    point_law,
    query_terrain,
)
from rover_sim.physics.numerics.compiled import checked
from rover_sim.physics.tether.ancf import Array
from rover_sim.physics.tether.energy_momentum import (
    assemble,
    begin_ends,
    begin_step,
    end_step,
    make_workspace,
    set_end,
    solve_increment,
)
from rover_sim.physics.tether.tether import Tether, tether_energies, to_rows

# Indices of the log.
(
    TETHER_HEAT, GROUND_HEAT, CONTACT_ENERGY, NORMAL, TOUCHING, ITERATIONS, STEPS, HALVINGS,
    LEAST_HEAT, DEEPEST,
) = range(10)  # fmt: skip


@checked
def _attempt(
    terrain: Any, law: Any, cable: Any, mass: float, h: float,
    q: Array, v: Array, anchors: Array, work: Any, contact: Any, q1: Array, v1: Array,
    tolerance: float, log: Array,
) -> bool:  # fmt: skip
    n = cable.elements
    for k in range(6):
        for i in range(n + 1):
            work.increment[k, i] = h * v[k, i]
        for end in range(2):
            if work.end_fixed[end, k] != 0.0:
                work.increment[k, end * n] = 0.0
    begin_ends(cable, work)
    begin_step(cable, h, q, v, work)
    begin_tether_contact(terrain, cable, h, q, v, anchors, False, contact)
    done = False
    for _ in range(20):
        for d in range(3):
            if mass > 0.0:
                pull = 2.0 / h * (work.increment[d, n] / h - v[d, n]) - cable.gravity[d]
                set_end(work, 1, 6, d, mass * pull)
                set_end(work, 1, d, d, 2.0 * mass / h**2)
        assemble(cable, h, work)
        linearised = add_tether_contact(terrain, law, cable, h, anchors, work, contact)
        change = solve_increment(cable, work)
        log[ITERATIONS] += 1.0
        if change < tolerance and linearised == 0:
            done = True
            break
    if not done:
        return False
    log[TETHER_HEAT] += end_step(cable, h, q, v, work, q1, v1)[0]
    ground = end_tether_contact(law, cable, h, anchors, work, contact)
    log[GROUND_HEAT] += ground.dissipated
    log[CONTACT_ENERGY] += ground.stored_change
    log[NORMAL], log[TOUCHING] = 0.0, 0.0
    log[LEAST_HEAT] = min(log[LEAST_HEAT], ground.dissipated)
    for s in range(contact.near_count[0]):
        if contact.touches[s] != 0:
            log[TOUCHING] += 1.0
            for d in range(3):
                log[NORMAL] += contact.force[s, 3, d] * contact.ground[s, 1 + d]
        log[DEEPEST] = max(log[DEEPEST], contact.ground[s, 0])
    return True


@checked
def _march(
    terrain: Any, law: Any, cable: Any, mass: float, h: float, steps: int,
    q: Array, v: Array, anchors: Array, work: Any, contact: Any, q1: Array, v1: Array,
    tolerance: float, log: Array,
) -> bool:  # fmt: skip
    for _ in range(steps):
        left, part = h, h
        while left > 1e-12 * h:
            part = min(part, left)
            if _attempt(
                terrain, law, cable, mass, part, q, v, anchors, work, contact, q1, v1,
                tolerance, log,
            ):  # fmt: skip
                left -= part
                log[STEPS] += 1.0
                for k in range(6):
                    for i in range(cable.elements + 1):
                        q[k, i], v[k, i] = q1[k, i], v1[k, i]
            else:
                part *= 0.5
                log[HALVINGS] += 1.0
                if part < h / 1000.0:
                    return False
    return True


@checked
def _ground_energy(
    terrain: Any, law: Any, tether: Any, q: Array, anchors: Array, contact: Any
) -> float:
    """Energy stored in ground and anchors [J]; overwrites arrays of `contact`."""
    place_points(tether, q, contact)
    query_terrain(terrain, contact.start, POINTS * tether.elements, contact.ground)
    weight = tether.element_length / POINTS
    stored = 0.0
    for p in range(POINTS * tether.elements):
        here = point_law(law, weight, contact.ground[p, 4])
        bristle = (anchors[p, 0], anchors[p, 1], anchors[p, 2])
        stored += contact_energy(here, contact.ground[p, 0], bristle)
    return stored


class GroundedTether:
    """A spatial tether on a terrain, with free or fixed ends or an end mass."""

    def __init__(
        self,
        cable: Tether,
        terrain: Terrain,
        nodes: Array,
        parameters: TetherContactParameters | None = None,
        held: tuple[int, ...] = (),
        mass: float = 0.0,
        room: int = 0,
    ) -> None:
        """Start at rest with nodes (n + 1, 2, 3); `held` are the ends with fixed positions."""
        n = cable.elements
        self.cable, self.terrain, self.mass = cable, terrain, mass
        self.law = (parameters or TetherContactParameters()).law()
        self.q = to_rows(nodes)
        self.v = np.zeros_like(self.q)
        self.anchors = np.zeros((2 * (n + room), 3))
        self.work = make_workspace(n, 3)
        self.contact = make_tether_contact(n + room)
        self.log = np.zeros(10)
        self._after = (np.zeros_like(self.q), np.zeros_like(self.q))
        for end in held:
            self.work.end_fixed[end, :3] = 1.0

    def run(self, duration: float, h: float, tolerance: float = 1e-10) -> None:
        """Advance; steps that do not converge are halved."""
        ok = _march(
            self.terrain, self.law, self.cable, self.mass, h, round(duration / h), self.q, self.v,
            self.anchors, self.work, self.contact, *self._after, tolerance, self.log,
        )  # fmt: skip
        assert ok, "a step did not converge"

    @property
    def places(self) -> Array:
        """Positions of the nodes [m], (n + 1, 3)."""
        return self.q[:3, : self.cable.elements + 1].T.copy()

    @property
    def ground_energy(self) -> float:
        """Energy stored in ground and anchors [J]."""
        return float(
            _ground_energy(self.terrain, self.law, self.cable, self.q, self.anchors, self.contact)
        )

    @property
    def energy(self) -> float:
        """Total stored energy [J]."""
        n = self.cable.elements
        total: Any = sum(tether_energies(self.cable, self.q, self.v)) + self.ground_energy
        rate = self.v[:3, n]
        weight = self.mass * float(np.array(self.cable.gravity) @ self.q[:3, n])
        return float(total + 0.5 * self.mass * rate @ rate - weight)

    @property
    def dissipated(self) -> float:
        """Energy dissipated by tether and ground since the start [J]."""
        return float(self.log[TETHER_HEAT] + self.log[GROUND_HEAT])
