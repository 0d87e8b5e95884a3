"""Step a tether in space, with or without rover, by the kernel's own parts: what tests watch."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rover_sim.physics.numerics import vectors
from rover_sim.physics.numerics.compiled import checked
from rover_sim.physics.rover import spatial_rover
from rover_sim.physics.tether import energy_momentum, remesh, tether, variable_length
from rover_sim.physics.tether.ancf import Array
from rover_sim.physics.tether.natural_curvature import make_natural_curvature

PINNED, FREE, PAYING_OUT = range(3)
TOLERANCE = 1e-11


ORIGIN = np.zeros((3, 3))
SPLIT_BEYOND, MERGE_BELOW = 1.5, 0.5  # of the element's length


@checked
def _attempt(
    cable: Any, natural: Any, rover: Any, spring: Any, mass: float, root: int, h: float, pay: Any,
    q: Array, v: Array, fairlead_slope: Array, body: Array, work: Any, step: Any, exit_element: Any,
    q1: Array, v1: Array, body1: Array,
) -> float:  # fmt: skip
    n = cable.elements
    for k in range(6):
        work.end_fixed[0, k] = 1.0 if root == PINNED and k < 3 else 0.0
        work.end_fixed[1, k] = 0.0
        for i in range(n + 1):
            work.increment[k, i] = h * v[k, i]
        if work.end_fixed[0, k] != 0.0:
            work.increment[k, 0] = 0.0
    energy_momentum.begin_ends(cable, work)
    energy_momentum.begin_step(cable, h, q, v, work)
    for k in range(3):
        step.increment[k] = h * body[spatial_rover.SPIN + k]
        exit_element.increment[k] = h * fairlead_slope[1, k]
    axis = vectors.rotation_of(spatial_rover.orientation(body))[2]
    step.increment[3] = 0.0
    for k in range(3):
        step.increment[3] += h * axis[k] * (body[13 + k] - body[10 + k])
    if root == PAYING_OUT:
        variable_length.begin_exit(ORIGIN, fairlead_slope[0], fairlead_slope[1], q, v, exit_element)
    for _ in range(30):
        if mass > 0.0:
            for d in range(3):
                pull = 2.0 / h * (work.increment[d, n] / h - v[d, n]) - cable.gravity[d]
                energy_momentum.set_end(work, 1, 6, d, mass * pull)
                energy_momentum.set_end(work, 1, d, d, 2.0 * mass / h**2)
        else:
            middle = body[16] + 0.5 * step.increment[3]
            step.slide[0] = spring[0] * (spring[1] - middle) - spring[2] * step.increment[3] / h
            step.slide[1] = -0.5 * spring[0] - spring[2] / h
            spatial_rover.add_rover(rover, cable.gravity, h, n, body, work, step)
        if root == PAYING_OUT:
            unchanged = variable_length.PayoutChange(pay, 0.0)
            variable_length.add_exit(cable, h, pay, unchanged, natural, work, exit_element)
        change = energy_momentum.newton_increment(cable, h, work)
        if mass == 0.0:
            change += spatial_rover.apply_rover_increment(n, work, step)
        if root == PAYING_OUT:
            change += variable_length.apply_exit_increment(pay.length0, work, exit_element)
        if change < TOLERANCE:
            break
    if not change < TOLERANCE:
        return np.nan
    loss = energy_momentum.end_step(cable, h, q, v, work, q1, v1)[0]
    if mass == 0.0:
        spatial_rover.end_rover_step(rover, h, n, body, work, step, body1)
        loss += spring[2] * step.increment[3] ** 2 / h
    if root == PAYING_OUT:
        loss += variable_length.end_exit_step(
            cable, h, pay, work, exit_element, fairlead_slope[2], fairlead_slope[3]
        )
    return float(loss)


@dataclass
class March:
    """A tether in space and what hangs on it; `run` moves it on in place."""

    cable: tether.Tether
    nodes: Array  # (n + 1, 2, 3)
    node_rates: Array
    rover: spatial_rover.SpatialRover | None = None
    body: Array = field(default_factory=lambda: np.zeros(spatial_rover.BODY_SIZE))
    mass: float = 0.0  # at the tip, instead of a rover
    root: int = PINNED
    room: int = 0  # elements by which the chain can grow; 0: it is never divided nor joined
    length: float = 0.0  # of the first element that pays out
    slope: Array = field(default_factory=lambda: np.zeros(3))  # at the fairlead
    slope_rate: Array = field(default_factory=lambda: np.zeros(3))
    payout_rate: float = 0.0
    spring: tuple[float, float, float] = (1.0, 0.0, 0.0)  # rate [N/m], length [m], damper [N s/m]
    dissipated: float = 0.0
    flowed_in: float = 0.0  # energy brought in at the fairlead [J]
    fairlead_tension: float = 0.0
    tensions: list[float] = field(default_factory=list)  # at the fairlead, of all steps [N]
    remeshed: list[float] = field(default_factory=list)  # changes of energy [J]
    splits: int = 0

    def __post_init__(self) -> None:
        n = self.cable.elements
        width = tether.row_width(n + self.room, 3)
        self.q, self.v = np.zeros((6, width)), np.zeros((6, width))
        self.q[:, : n + 1] = tether.to_rows(self.nodes)[:, : n + 1]
        self.v[:, : n + 1] = tether.to_rows(self.node_rates)[:, : n + 1]
        self._work = energy_momentum.make_workspace(n + self.room, 3)
        self._anchors = np.zeros((2 * (n + self.room), 3))
        self._step = spatial_rover.make_rover_step()
        self._exit = variable_length.make_exit(3)
        self._natural = make_natural_curvature(width, 0.0, np.zeros((2, 1)), guided=False)
        self._after = (np.zeros_like(self.q), np.zeros_like(self.v), np.zeros_like(self.body))
        self._rover = self.rover or spatial_rover.SpatialRover(
            0.0, 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        )

    def run(self, duration: float, h: float, payout_acceleration: float = 0.0) -> None:
        """Step on; the payout rate changes steadily."""
        self._step.rotors_after[:] = self.body[spatial_rover.ROTORS :]
        for _ in range(round(duration / h)):
            rate1 = self.payout_rate + h * payout_acceleration
            mean = float(0.5 * (self.payout_rate + rate1))
            pay = variable_length.Payout(
                self.length, self.length + h * mean, self.payout_rate, rate1
            )
            fairlead_slope = np.array([self.slope, self.slope_rate, self.slope, self.slope_rate])
            loss = _attempt(
                self.cable, self._natural, self._rover, self.spring, self.mass, self.root, h, pay,
                self.q, self.v, fairlead_slope, self.body, self._work, self._step, self._exit,
                *self._after,
            )  # fmt: skip
            assert np.isfinite(loss), "the step did not converge"
            self.dissipated += loss
            if self.root == PAYING_OUT:
                self._count_flow(h, mean, 0.5 * (self.slope + fairlead_slope[2]))
            self.q[:], self.v[:] = self._after[0], self._after[1]
            if self.mass == 0.0:
                self.body[:] = self._after[2]
            self.slope, self.slope_rate = fairlead_slope[2].copy(), fairlead_slope[3].copy()
            self.length, self.payout_rate = pay.length1, rate1
            if self.room > 0:
                self._remesh()

    def _remesh(self) -> None:
        """Divide or join at the fairlead, as the length of the first element asks."""
        nominal, n = self.cable.element_length, self.cable.elements
        fairlead_slope = np.array([self.slope, self.slope_rate])
        state = (
            self.length,
            self.payout_rate,
            ORIGIN,
            fairlead_slope,
            self.q,
            self.v,
            self._anchors,
        )
        if self.length > SPLIT_BEYOND * nominal:
            self.remeshed.append(remesh.split_first(self.cable, *state))
            self.length -= nominal
            self.cable = self.cable._replace(elements=n + 1)
            self.splits += 1
        elif self.length < MERGE_BELOW * nominal and n > 1:
            self.remeshed.append(remesh.merge_first(self.cable, *state))
            self.length += nominal
            self.cable = self.cable._replace(elements=n - 1)
            self.slope, self.slope_rate = fairlead_slope[0].copy(), fairlead_slope[1].copy()

    def _count_flow(self, h: float, rate: float, slope: Array) -> None:
        """dE/dt = R.(r' v) + v (rhoA |dr/dt|^2/2 + EA eps^2/2) at the fairlead."""
        self.fairlead_tension = float(self._exit.tension[0])
        self.tensions.append(self.fairlead_tension)
        square = float(slope @ slope)
        strain = 0.5 * (square - 1.0)
        carried = 0.5 * self.cable.line_density * rate**2 * square
        carried += 0.5 * self.cable.axial_stiffness * strain**2
        self.flowed_in += h * rate * (float(self._exit.reaction @ slope) + carried)

    @property
    def tip(self) -> Array:
        """Position of the last node [m]."""
        return self.q[:3, self.cable.elements].copy()

    @property
    def attitude(self) -> Array:
        """Rotation vector, body to world [rad]."""
        w, vector = self.body[3], self.body[4:7]
        size = float(np.linalg.norm(vector))
        return vector * (2.0 * np.arctan2(size, w) / size) if size > 0.0 else 2.0 * vector

    @property
    def energy(self) -> float:
        """Everything stored [J]."""
        total: Any = sum(tether.tether_energies(self.cable, self.q, self.v))
        gravity = np.array(self.cable.gravity)
        n = self.cable.elements
        if self.mass > 0.0:
            rate = self.v[:3, n]
            total += 0.5 * self.mass * float(rate @ rate) - self.mass * float(gravity @ self.tip)
        else:
            total += sum(spatial_rover.rover_energies(self._rover, self.cable.gravity, self.body))
            total += 0.5 * self.spring[0] * (self.body[16] - self.spring[1]) ** 2
        if self.root == PAYING_OUT:
            e = np.array([np.zeros(3), self.slope, self.q[:3, 0], self.q[3:, 0]])
            rate = np.array([np.zeros(3), self.slope_rate, self.v[:3, 0], self.v[3:, 0]])
            total += sum(
                variable_length.exit_energies(self.cable, self.length, self.payout_rate, e, rate)
            )
        return float(total)


def rotation(vector: Array) -> Array:
    """Matrix (3, 3) of a rotation vector."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * skew + (1.0 - np.cos(angle)) * skew @ skew)


def quaternion(vector: Array) -> Array:
    """Quaternion (w, x, y, z) of a rotation vector."""
    angle = float(np.linalg.norm(vector))
    axis = vector / angle if angle > 0.0 else vector
    return np.concatenate([[np.cos(0.5 * angle)], np.sin(0.5 * angle) * axis])


def rover_at(
    rover: spatial_rover.SpatialRover,
    tip: Array,
    tip_rate: Array,
    attitude: Array,
    spin: Array,
    s: float,
) -> Array:
    """Body array of a rover that moves as one rigid body with its attachment at the tip.

    `attitude` is a rotation vector; `spin` the angular velocity in world axes.
    """
    turned = rotation(attitude)
    body = np.zeros(spatial_rover.BODY_SIZE)
    lever1 = -turned @ np.array(rover.attachment)
    lever2 = lever1 + s * turned[:, 2] + turned @ np.array(rover.offset)
    body[0:3] = tip + lever1
    body[3:7] = quaternion(attitude)
    body[7:10] = turned.T @ spin
    body[10:13] = tip_rate + np.cross(spin, lever1)
    body[13:16] = tip_rate + np.cross(spin, lever2)
    body[16] = s
    return body
