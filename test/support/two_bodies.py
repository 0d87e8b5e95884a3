"""Two bodies on a slider, up and down only: a rig for the jump drive, apart from the plant.

Body 1 stands on a rigid floor that cannot pull, or floats. Steps by the implicit midpoint rule.
"""

import math
from dataclasses import dataclass

from rover_sim.physics.mechanisms import jump_drive
from rover_sim.physics.mechanisms.jump_drive import (
    JumpCommand,
    JumpDrive,
    JumpEnergyBalance,
    JumpLoads,
    JumpState,
    Latch,
)
from rover_sim.physics.mechanisms.slider import NutAction, Slider, slider_energy, slider_force


@dataclass(frozen=True)
class Rig:
    """Masses [kg], gravity [m/s^2] and whether Body 1 stands on a floor."""

    m1: float
    m2: float
    gravity: float
    on_floor: bool


def settled(drive: JumpDrive, slider: Slider, compression: float) -> JumpState:
    """A drive at rest whose nut holds the spring at a compression [m]."""
    nut = compression * (1.0 + slider.spring_rate / slider.nut_stiffness)
    return jump_drive.initial_state(drive, 0.0)._replace(nut=nut, latch=int(Latch.ENGAGED))


class JumpRun:
    """A rig with a jump drive, stepped with energy balances.

    Attributes:
        visited: states of the latch in the order in which they were first seen.
        balance: sums of the drive's energy balances [J].
        slider_heat: what the slider's forces turned into heat [J].
        drift: what all energy balances leave unexplained [J].
        fastest: Body 2's greatest speed upwards [m/s].
    """

    def __init__(
        self, rig: Rig, drive: JumpDrive, slider: Slider, state: JumpState, h: float = 1e-3
    ) -> None:
        self.rig, self.drive, self.slider, self.state, self.h = rig, drive, slider, state, h
        self.z1 = self.v1 = self.v2 = 0.0
        held = state.nut / (1.0 + slider.spring_rate / slider.nut_stiffness)
        sag = rig.m2 * rig.gravity / slider.spring_rate  # of a Body 2 that stands on the spring
        self.s = slider.free_length - max(held, sag)
        self.standing = rig.on_floor
        self.body_rate = 0.0
        self.visited: list[Latch] = []
        self.balance = dict.fromkeys(JumpEnergyBalance._fields, 0.0)
        self.slider_heat = 0.0
        self.floor_heat = 0.0
        self.fastest = 0.0
        self.last = JumpEnergyBalance(*[0.0] * len(JumpEnergyBalance._fields))
        self._start = self._mechanical()

    @property
    def compression(self) -> float:
        return self.slider.free_length - self.s

    @property
    def momentum(self) -> float:
        return self.rig.m1 * self.v1 + self.rig.m2 * self.v2

    @property
    def take_off(self) -> float:
        """Velocity [m/s] of the common centre of mass when it was where Body 1 left the floor."""
        rig, stretch = self.rig, self.s - self.slider.free_length
        mass = rig.m1 + rig.m2
        rise = self.z1 + rig.m2 / mass * stretch
        return math.sqrt((self.momentum / mass) ** 2 + 2.0 * rig.gravity * rise)

    @property
    def kinetic(self) -> float:
        """Energy of the drive's rotor [J]."""
        state = self.state
        return 0.5 * self.drive.inertia * (state.rate + state.body_rate) ** 2

    @property
    def drift(self) -> float:
        balance = self.balance
        put_in = balance["motor_work"] + balance["body_work"]
        heat = balance["screw_heat"] + balance["friction_heat"] + balance["stop_heat"]
        return self._mechanical() - self._start - put_in + heat + self.slider_heat + self.floor_heat

    def _pressing(self) -> bool:
        return self.state.latch not in {Latch.RELEASED, Latch.HOOKING}

    def _elastic(self) -> float:
        return float(slider_energy(self.slider, self._pressing(), self.state.nut, self.s))

    def _mechanical(self) -> float:
        rig = self.rig
        weight = rig.gravity * (rig.m1 * self.z1 + rig.m2 * (self.z1 + self.s))
        moving = 0.5 * rig.m1 * self.v1**2 + 0.5 * rig.m2 * self.v2**2
        return self.kinetic + moving + weight + self._elastic()

    def steps(self, command: JumpCommand, count: int) -> float:
        """Advance by `count` steps; returns the greatest speed of the nut [m/s]."""
        fastest = 0.0
        for _ in range(count):
            left = self.h
            while left > 1e-12:
                left -= self._advance(command, left)
            fastest = max(fastest, abs(self.state.rate) * self.drive.pitch)
        return fastest

    def until_tripped(self, command: JumpCommand) -> None:
        """Advance until the latch trips."""
        for _ in range(60_000):
            self._advance(command, self.h)
            if self.state.latch == Latch.RELEASED:
                return
        raise AssertionError("the latch did not trip")

    def until_airborne(self, command: JumpCommand) -> None:
        """Advance until Body 1 is a millimetre above the floor."""
        for _ in range(60_000):
            self._advance(command, self.h)
            if self.z1 > 1e-3:
                return
        raise AssertionError("the rover did not leave the floor")

    def _advance(self, command: JumpCommand, h: float) -> float:
        loads = JumpLoads(self.s, self.v2 - self.v1, self.body_rate)
        before = self._elastic()
        self.state, outputs, self.last = jump_drive.advance(
            self.drive, self.slider, self.state, command, loads, h
        )
        for name, value in self.last._asdict().items():
            self.balance[name] += value
        if not self.visited or self.visited[-1] != self.state.latch:
            self.visited.append(Latch(self.state.latch))
        elapsed = float(outputs.elapsed)
        work = self._move(outputs.nut, elapsed) if elapsed > 0.0 else 0.0
        self.slider_heat += self.last.nut_work - work - (self._elastic() - before)
        self.fastest = max(self.fastest, self.v2)
        return elapsed

    def _move(self, nut: NutAction, h: float) -> float:
        """Move both bodies by h; returns the slider force's work on them [J]."""
        rig = self.rig
        standing = self.standing
        inverse = 1.0 / rig.m2 + (0.0 if standing else 1.0 / rig.m1)
        push = -rig.gravity if standing else 0.0  # of the relative motion
        rate = self.v2 - self.v1
        end = rate
        for _ in range(60):
            mean = 0.5 * (rate + end)
            force = slider_force(self.slider, nut, self.s + 0.5 * h * mean, mean)
            wrong = end - rate - h * (inverse * force.force + push)
            slope = 1.0 - h * inverse * 0.5 * (force.by_rate + 0.5 * h * force.by_position)
            end -= wrong / slope
            if abs(wrong) < 1e-13 * (1.0 + abs(end)):
                break
        else:
            raise AssertionError("Newton did not converge")
        mean = 0.5 * (rate + end)
        push1 = -force.force / rig.m1 - rig.gravity
        if standing and push1 > 0.0:  # the floor cannot pull
            self.standing = False
            return self._move(nut, h)
        v1 = 0.0 if standing else self.v1 + h * push1
        self.z1 += 0.5 * h * (self.v1 + v1)
        self.v1 = v1
        self.v2 = v1 + end
        self.s += h * mean
        if rig.on_floor and not standing and self.z1 < 0.0:  # down again: it stays
            self.floor_heat += 0.5 * rig.m1 * self.v1**2 + rig.gravity * rig.m1 * self.z1
            self.floor_heat += rig.gravity * rig.m2 * self.z1
            self.floor_heat += 0.5 * rig.m2 * (self.v2**2 - (self.v2 - self.v1) ** 2)
            self.z1, self.v2, self.v1 = 0.0, self.v2 - self.v1, 0.0
            self.standing = True
        return float(force.force * h * mean)
