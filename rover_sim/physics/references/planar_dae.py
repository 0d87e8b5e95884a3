"""The source paper's planar model as printed: a redundant DAE with Lagrange multipliers.

Every tether element has its own coordinates, e_i = (r1, r1', r2, r2') (equation 2), and each body
three, G = (x, y, theta) (10); constraints connect them:

    (15) tether to ground, (16) element to element, (17) tether to Body 1, (13) Body 2 to Body 1,

8n + 6 coordinates under 4n + 2 constraints, none redundant. The accelerations and the
multipliers solve the saddle equations (20),

    [ M   Cq^T ] [ q''    ]   [ Q_E   ]
    [ Cq   0   ] [ lambda ] = [ gamma ],    gamma = -(Cq q')_q q' - 2 v Cq q' - v^2 C,

where the stabilisation C'' + 2 v C' + v^2 C = 0 is our reading of (19), which is not completely
legible in the paper's text. Classical Runge-Kutta steps integrate them; the tether's axial wave
limits the step: h < 0.43 l sqrt(rho/E).

This is the reference for the assembled integrator and shares no code with it: the element's
polynomials are integrated exactly, by algebra instead of quadrature. Strain-rate damping, which
the paper does not have, is optional.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import ArrayLike, NDArray

from rover_sim.physics.tether.tether_section import TetherSection

Array = NDArray[np.float64]

DEFAULT_STABILISATION = 20.0
"""v [1/s]; 5 to 100 are suitable at 1 ms."""


class RoverData(Protocol):
    """Parameters of the rover that the model uses; a scenario's rover has them all."""

    @property
    def m1(self) -> float:
        """Mass of Body 1 [kg]."""

    @property
    def m2(self) -> float:
        """Mass of Body 2 [kg]."""

    @property
    def inertia1(self) -> float:
        """Moment of inertia about Body 1's centre of mass [kg m^2]."""

    @property
    def inertia2(self) -> float:
        """Moment of inertia about Body 2's centre of mass [kg m^2]."""

    @property
    def attachment(self) -> tuple[float, float]:
        """Tether's attachment (a, b) in Body 1's axes [m]."""

    @property
    def spring_rate(self) -> float:
        """Spring rate k [N/m]."""

    @property
    def spring_free_length(self) -> float:
        """Free length l0 of the spring [m]."""

    @property
    def slider_damping(self) -> float:
        """Damper along the slider [N s/m]."""


class AssembledState(Protocol):
    """A state of the assembled model: shared nodes, Body 1 and the slider."""

    @property
    def nodes(self) -> Array:
        """Positions r [m] and slopes r' [-], (n + 1, 2, 2)."""

    @property
    def node_rates(self) -> Array:
        """Their rates."""

    @property
    def theta(self) -> float:
        """Angle of both bodies [rad]."""

    @property
    def omega(self) -> float:
        """Rate of theta [rad/s]."""

    @property
    def s(self) -> float:
        """Distance of the centres along the slider [m]."""

    @property
    def s_rate(self) -> float:
        """Rate of s [m/s]."""


@dataclass(frozen=True)
class DaeTrajectory:
    """Result of `PlanarDae.integrate`: samples over time, including the start.

    Attributes:
        time: (k,) [s].
        nodes: (k, n + 1, 2, 2), of the elements' first ends and the last one's second.
        bodies: (k, 2, 3), x, y [m] and theta [rad] of Body 1 and Body 2.
        energy: (k,) kinetic, gravitational, elastic and spring energy together [J].
        constraint: (k,) largest |C| of each sample [m, - or rad].
        largest_constraint: largest |C| of all steps.
    """

    time: Array
    nodes: Array
    bodies: Array
    energy: Array
    constraint: Array
    largest_constraint: float


class PlanarDae:
    """The redundant DAE of one tether and one rover.

    Coordinates q, (8n + 6,): the elements' e_1 ... e_n, then x1, y1, theta1, x2, y2, theta2.
    Constraints C, (4n + 2,): ground (2), elements (4 each), Body 1 (2), slider (2).
    """

    def __init__(
        self,
        section: TetherSection,
        length: float,
        elements: int,
        rover: RoverData,
        gravity: float,
        root: ArrayLike = (0.0, 0.0),
        stabilisation: float = DEFAULT_STABILISATION,
    ) -> None:
        """Set up the constant matrices.

        Args:
            section: stiffness, mass and damping of the tether.
            length: its unstretched length [m].
            elements: number n of elements.
            rover: masses, inertias, attachment, spring.
            gravity: g, along -y [m/s^2].
            root: where the tether is pinned to the ground [m].
            stabilisation: v of equation (19) [1/s].
        """
        self.elements = elements
        self.stabilisation = stabilisation
        self._section = section
        self._rover = rover
        self._root = np.array(root, dtype=np.float64)
        self._integrals = _ElementIntegrals.of(length / elements)
        self._size = 8 * elements + 6
        self._count = 4 * elements + 2
        self._mass = self._mass_matrix()
        self._gravity_force = self._gravity_forces(gravity)
        self._linear = self._linear_constraints()

    def coordinates(self, state: AssembledState) -> tuple[Array, Array]:
        """Coordinates q and rates q', (8n + 6,) each, of a state of the assembled model.

        Body 1's position is computed from the last node.
        """
        return _element_coordinates(state.nodes, self._bodies_of(state)), _element_coordinates(
            state.node_rates, self._body_rates_of(state)
        )

    def integrate(
        self, state: AssembledState, duration: float, h: float, sample_every: int = 1
    ) -> DaeTrajectory:
        """Integrate from a state by Runge-Kutta steps of fourth order.

        Args:
            state: initial state, at time 0.
            duration: [s], a whole number of steps.
            h: step [s].
            sample_every: steps between samples.

        Raises:
            ValueError: duration is not a whole number of steps.
            ArithmeticError: the motion is no longer finite; states the time.
        """
        steps = round(duration / h)
        if steps < 1 or abs(steps * h - duration) > 1e-9 * duration:
            raise ValueError(f"duration {duration} s: must be a whole number of steps of {h} s")
        q, rate = self.coordinates(state)
        motion = np.stack([q, rate])
        samples = [(0.0, motion)]
        largest = self._largest_constraint(motion[0])
        for index in range(1, steps + 1):
            with np.errstate(over="ignore", invalid="ignore"):
                motion = _runge_kutta_step(self._derivative, motion, h)
                constraint = self._largest_constraint(motion[0])
            largest = max(largest, constraint)
            if not np.isfinite(constraint):
                raise ArithmeticError(f"the motion diverged: not finite at {index * h:g} s")
            if index % sample_every == 0 or index == steps:
                samples.append((index * h, motion))
        return DaeTrajectory(
            time=np.array([time for time, _ in samples]),
            nodes=np.array([self.nodes(motion[0]) for _, motion in samples]),
            bodies=np.array([motion[0, -6:].reshape(2, 3) for _, motion in samples]),
            energy=np.array([self.energy(*motion) for _, motion in samples]),
            constraint=np.array([self._largest_constraint(motion[0]) for _, motion in samples]),
            largest_constraint=largest,
        )

    def nodes(self, q: Array) -> Array:
        """Nodes (n + 1, 2, 2) of the elements' first ends and the last one's second."""
        e = q[:-6].reshape(self.elements, 4, 2)
        return np.concatenate([e[:, :2], e[-1:, 2:]])

    def energy(self, q: Array, rate: Array) -> float:
        """Kinetic, gravitational, elastic and spring energy [J]."""
        e = q[:-6].reshape(self.elements, 4, 2)
        integrals, section = self._integrals, self._section
        products = np.einsum("nai,nbi->nab", e, e)
        quartic = np.einsum("nab,abcd,ncd->", products, integrals.slopes4, products)
        quadratic = np.einsum("ab,nab->", integrals.slopes2, products)
        length = self.elements * integrals.length
        axial = section.axial_stiffness / 8.0 * (quartic - 2.0 * quadratic + length)
        bending = (
            0.5 * section.bending_stiffness * np.einsum("ab,nab->", integrals.curves2, products)
        )
        stretch = float(np.hypot(*(q[-3:-1] - q[-6:-4]))) - self._rover.spring_free_length
        spring = 0.5 * self._rover.spring_rate * stretch**2
        kinetic = 0.5 * rate @ self._mass @ rate
        return float(kinetic - self._gravity_force @ q + axial + bending + spring)

    def constraints(self, q: Array) -> Array:
        """C(q), (4n + 2,): equations (15), (16), (17), (13)."""
        values = self._linear @ q
        values[:2] -= self._root
        x1, y1, th1, x2, y2, th2 = q[-6:]
        values[-4:-2] -= _rotated(th1, self._rover.attachment)
        values[-2] = np.cos(th1) * (x2 - x1) + np.sin(th1) * (y2 - y1)
        values[-1] = np.sin(th2 - th1)
        return np.asarray(values)

    def jacobian(self, q: Array) -> Array:
        """Cq = dC/dq, (4n + 2, 8n + 6)."""
        matrix = self._linear.copy()
        x1, y1, th1, x2, y2, th2 = q[-6:]
        cos, sin = np.cos(th1), np.sin(th1)
        arm_x, arm_y = _rotated(th1, self._rover.attachment)
        matrix[-4, -4], matrix[-3, -4] = arm_y, -arm_x
        matrix[-2, -6:] = (-cos, -sin, cos * (y2 - y1) - sin * (x2 - x1), cos, sin, 0.0)
        matrix[-1, -4], matrix[-1, -1] = -np.cos(th2 - th1), np.cos(th2 - th1)
        return matrix

    def quadratic_velocity_terms(self, q: Array, rate: Array) -> Array:
        """(Cq q')_q q', (4n + 2,): the terms of C'' without q''."""
        terms = np.zeros(self._count)
        x1, y1, th1, x2, y2, th2 = q[-6:]
        vx1, vy1, w1, vx2, vy2, w2 = rate[-6:]
        cos, sin = np.cos(th1), np.sin(th1)
        terms[-4:-2] = w1**2 * _rotated(th1, self._rover.attachment)
        terms[-2] = 2.0 * w1 * (cos * (vy2 - vy1) - sin * (vx2 - vx1)) - w1**2 * (
            cos * (x2 - x1) + sin * (y2 - y1)
        )
        terms[-1] = -np.sin(th2 - th1) * (w2 - w1) ** 2
        return terms

    def forces(self, q: Array, rate: Array) -> Array:
        """Q_E, (8n + 6,): weight, elastic and damping forces of tether and spring."""
        e = q[:-6].reshape(self.elements, 4, 2)
        e_rate = rate[:-6].reshape(self.elements, 4, 2)
        integrals, section = self._integrals, self._section
        # (8): K_l(e) = EA/2 int (r'.r' - 1) S'^T S' dx, here with tau d(r'.r'/2)/dt added
        products = np.einsum("nai,nbi->nab", e, e)
        products += 2.0 * section.axial_damping_time * np.einsum("nai,nbi->nab", e, e_rate)
        slopes4 = integrals.slopes4.reshape(16, 16)
        stiffness = 0.5 * (products.reshape(-1, 16) @ slopes4).reshape(-1, 4, 4)
        stiffness -= 0.5 * integrals.slopes2
        # (6): K_t e
        bent = integrals.curves2 @ e
        if section.bending_damping_time > 0.0:
            bent += section.bending_damping_time * self._curvature_damping(e, e_rate)
        elastic = section.axial_stiffness * (stiffness @ e) + section.bending_stiffness * bent

        total = self._gravity_force.copy()
        total[:-6] -= elastic.ravel()
        # (14)
        between = q[-3:-1] - q[-6:-4]
        distance = float(np.hypot(*between))
        along = between / distance
        closing = along @ (rate[-3:-1] - rate[-6:-4])
        rover = self._rover
        pull = (
            rover.spring_rate * (distance - rover.spring_free_length)
            + rover.slider_damping * closing
        )
        total[-6:-4] += pull * along
        total[-3:-1] -= pull * along
        return total

    def _curvature_damping(self, e: Array, e_rate: Array) -> Array:
        """Force int dkappa/dt (d kappa/d e) dx of the curvature kappa = r' x r''/|r'|^2.

        e, its rate and the result are (n, 4, 2). Unlike the rate of r'' the force is zero in a
        rigid rotation.
        """
        integrals = self._integrals
        slope, bend = integrals.slopes @ e, integrals.curves @ e
        slope_rate, bend_rate = integrals.slopes @ e_rate, integrals.curves @ e_rate
        square = np.sum(slope**2, axis=-1)
        curvature = _cross(slope, bend) / square
        # d kappa = per_slope . dr' + per_bend . dr''
        per_slope = np.stack([bend[..., 1], -bend[..., 0]], axis=-1)
        per_slope = (per_slope - 2.0 * curvature[..., None] * slope) / square[..., None]
        per_bend = np.stack([-slope[..., 1], slope[..., 0]], axis=-1) / square[..., None]
        rate = np.sum(per_slope * slope_rate + per_bend * bend_rate, axis=-1)
        weighted = (integrals.weights * rate)[..., None]
        return np.asarray(
            integrals.slopes.T @ (weighted * per_slope) + integrals.curves.T @ (weighted * per_bend)
        )

    def _derivative(self, motion: Array) -> Array:
        """d(q, q')/dt from the saddle equations (20)."""
        q, rate = motion
        matrix = np.zeros((self._size + self._count, self._size + self._count))
        jacobian = self.jacobian(q)
        matrix[: self._size, : self._size] = self._mass
        matrix[: self._size, self._size :] = jacobian.T
        matrix[self._size :, : self._size] = jacobian
        v = self.stabilisation
        gamma = (
            -self.quadratic_velocity_terms(q, rate)
            - 2.0 * v * (jacobian @ rate)
            - v**2 * self.constraints(q)
        )
        right = np.concatenate([self.forces(q, rate), gamma])
        return np.stack([rate, np.linalg.solve(matrix, right)[: self._size]])

    def _largest_constraint(self, q: Array) -> float:
        return float(np.max(np.abs(self.constraints(q))))

    def _bodies_of(self, state: AssembledState) -> Array:
        centre = state.nodes[-1, 0] - _rotated(state.theta, self._rover.attachment)
        second = centre + state.s * _slider_axis(state.theta)
        return np.array([*centre, state.theta, *second, state.theta])

    def _body_rates_of(self, state: AssembledState) -> Array:
        arm = _rotated(state.theta, self._rover.attachment)
        axis = _slider_axis(state.theta)
        velocity = state.node_rates[-1, 0] - state.omega * _quarter_turn(arm)
        second = velocity + state.s_rate * axis + state.s * state.omega * _quarter_turn(axis)
        return np.array([*velocity, state.omega, *second, state.omega])

    def _mass_matrix(self) -> Array:
        element = np.kron(self._section.line_density * self._integrals.shapes2, np.eye(2))
        matrix = np.zeros((self._size, self._size))
        for index in range(self.elements):
            matrix[8 * index : 8 * index + 8, 8 * index : 8 * index + 8] = element
        rover = self._rover
        bodies = (rover.m1, rover.m1, rover.inertia1, rover.m2, rover.m2, rover.inertia2)
        matrix[-6:, -6:] = np.diag(bodies)
        return matrix

    def _gravity_forces(self, gravity: float) -> Array:
        down = np.array([0.0, -gravity])
        element = np.outer(self._section.line_density * self._integrals.shapes1, down)
        rover = self._rover
        bodies = (0.0, -rover.m1 * gravity, 0.0, 0.0, -rover.m2 * gravity, 0.0)
        return np.concatenate([np.tile(element.ravel(), self.elements), bodies])

    def _linear_constraints(self) -> Array:
        """Constant part of the constraints' Jacobian; rows that depend on theta stay zero."""
        matrix = np.zeros((self._count, self._size))
        matrix[:2, :2] = np.eye(2)
        for joint in range(self.elements - 1):
            rows = slice(2 + 4 * joint, 6 + 4 * joint)
            matrix[rows, 8 * joint + 4 : 8 * joint + 8] = np.eye(4)
            matrix[rows, 8 * joint + 8 : 8 * joint + 12] = -np.eye(4)
        last = 8 * self.elements - 4
        matrix[-4:-2, last : last + 2] = np.eye(2)
        matrix[-4:-2, -6:-4] = -np.eye(2)
        return matrix


@dataclass(frozen=True)
class _ElementIntegrals:
    """Exact integrals of products of an element's shape functions over its length.

    The curvature is not a polynomial and is integrated by quadrature.
    """

    length: float
    shapes1: Array  # int S dx, (4,)
    shapes2: Array  # int S S dx, (4, 4)
    slopes2: Array  # int S' S' dx, (4, 4)
    slopes4: Array  # int S' S' S' S' dx, (4, 4, 4, 4)
    curves2: Array  # int S'' S'' dx, (4, 4)
    weights: Array  # of the points [m], (points,)
    slopes: Array  # S' at the points, (points, 4)
    curves: Array  # S'' at the points, (points, 4)

    @classmethod
    def of(cls, length: float) -> "_ElementIntegrals":
        """Integrals for an element of the given length [m]."""
        x = Polynomial([0.0, 1.0])
        t = x / length
        shapes = [
            1.0 - 3.0 * t**2 + 2.0 * t**3,
            length * (t - 2.0 * t**2 + t**3),
            3.0 * t**2 - 2.0 * t**3,
            length * (t**3 - t**2),
        ]
        slopes = [shape.deriv() for shape in shapes]
        curves = [slope.deriv() for slope in slopes]

        def integral(integrand: Polynomial) -> float:
            return float(integrand.integ()(length))

        def table(order: int, functions: list[Polynomial]) -> Array:
            values = np.empty((4,) * order)
            for index in np.ndindex(values.shape):
                product = Polynomial([1.0])
                for entry in index:
                    product = product * functions[entry]
                values[index] = integral(product)
            return values

        abscissae, weights = np.polynomial.legendre.leggauss(7)
        points = 0.5 * length * (1.0 + abscissae)
        return cls(
            length=length,
            shapes1=table(1, shapes),
            shapes2=table(2, shapes),
            slopes2=table(2, slopes),
            slopes4=table(4, slopes),
            curves2=table(2, curves),
            weights=0.5 * length * weights,
            slopes=np.stack([slope(points) for slope in slopes], axis=-1),
            curves=np.stack([curve(points) for curve in curves], axis=-1),
        )


def _runge_kutta_step(derivative: Callable[[Array], Array], motion: Array, h: float) -> Array:
    first = derivative(motion)
    second = derivative(motion + 0.5 * h * first)
    third = derivative(motion + 0.5 * h * second)
    fourth = derivative(motion + h * third)
    return np.asarray(motion + h / 6.0 * (first + 2.0 * (second + third) + fourth))


def _element_coordinates(nodes: Array, bodies: Array) -> Array:
    """Coordinates q from shared nodes and bodies."""
    elements = np.concatenate([nodes[:-1], nodes[1:]], axis=1)
    return np.concatenate([elements.ravel(), bodies])


def _cross(first: Array, second: Array) -> Array:
    return np.asarray(first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0])


def _rotated(angle: float, vector: ArrayLike) -> Array:
    x, y = np.asarray(vector, dtype=np.float64)
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([cos * x - sin * y, sin * x + cos * y])


def _quarter_turn(vector: Array) -> Array:
    """The vector rotated by +90 degrees: w times it is w x vector."""
    return np.array([-vector[1], vector[0]])


def _slider_axis(theta: float) -> Array:
    return np.array([-np.sin(theta), np.cos(theta)])
