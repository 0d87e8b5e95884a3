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
    JumpOutputs,
    JumpResponse,
    JumpState,
    JumpStep,
    Latch,
)
from rover_sim.physics.mechanisms.slider import Slider, slider_energy, slider_force


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


def advance(
    drive: JumpDrive,
    slider: Slider,
    state: JumpState,
    command: JumpCommand,
    loads: JumpLoads,
    h: float,
) -> tuple[JumpState, JumpOutputs, JumpEnergyBalance]:
    """Advance a drive whose step no trip ends, with bodies that move as given."""
    step = jump_drive.begin(drive, slider, state, command, loads, h)
    response = jump_drive.respond(drive, slider, state, step, loads)
    ended: tuple[JumpState, JumpOutputs, JumpEnergyBalance] = jump_drive.end(
        drive, slider, state, step, loads, response
    )
    return ended


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
        drive, slider, state = self.drive, self.slider, self.state
        loads = JumpLoads(self.s, self.v2 - self.v1, self.body_rate)
        before = self._elastic()
        step = jump_drive.begin(drive, slider, state, command, loads, h)
        self.last = JumpEnergyBalance(
            0.5 * drive.inertia * (state.rate + state.body_rate) ** 2, *[0.0] * 6
        )
        if step.elapsed == 0.0:
            self.state = jump_drive.at_trip(state, step)
            self.slider_heat += before - self._elastic()
        else:
            self._move(step, before)
        for name, value in self.last._asdict().items():
            self.balance[name] += value
        if not self.visited or self.visited[-1] != self.state.latch:
            self.visited.append(Latch(self.state.latch))
        self.fastest = max(self.fastest, self.v2)
        return float(step.elapsed)

    def _move(self, step: JumpStep, before: float) -> None:
        """Move drive and bodies by a step; `before` is the elastic energy at its start [J]."""
        rig, state, h = self.rig, self.state, step.elapsed
        standing = self.standing
        inverse = 1.0 / rig.m2 + (0.0 if standing else 1.0 / rig.m1)
        push = -rig.gravity if standing else 0.0  # of the relative motion
        rate = end = self.v2 - self.v1
        for _ in range(60):
            screw, force, by_change = self._forces(step, 0.5 * h * (rate + end))
            wrong = end - rate - h * (inverse * force + push)
            end -= wrong / (1.0 - 0.5 * h * h * inverse * by_change)
            if abs(wrong) < 1e-12 * (1.0 + abs(end)):
                break
        else:
            raise AssertionError("Newton did not converge")
        change = 0.5 * h * (rate + end)
        screw, force, _ = self._forces(step, change)
        push1 = -force / rig.m1 - rig.gravity
        if standing and push1 > 0.0:  # the floor cannot pull
            self.standing = False
            self._move(step, before)
            return
        loads = JumpLoads(self.s, change / h, self.body_rate)
        self.state, _, self.last = jump_drive.end(
            self.drive, self.slider, state, step, loads, screw
        )
        v1 = 0.0 if standing else self.v1 + h * push1
        self.z1 += 0.5 * h * (self.v1 + v1)
        self.v1 = v1
        self.v2 = v1 + end
        self.s += change
        self.slider_heat += self.last.nut_work - force * change - (self._elastic() - before)
        if rig.on_floor and not standing and self.z1 < 0.0:  # down again: it stays
            self.floor_heat += 0.5 * rig.m1 * self.v1**2 + rig.gravity * rig.m1 * self.z1
            self.floor_heat += rig.gravity * rig.m2 * self.z1
            self.floor_heat += 0.5 * rig.m2 * (self.v2**2 - (self.v2 - self.v1) ** 2)
            self.z1, self.v2, self.v1 = 0.0, self.v2 - self.v1, 0.0
            self.standing = True

    def _forces(self, step: JumpStep, change: float) -> tuple[JumpResponse, float, float]:
        """Response of the screw, force between the bodies [N] and its slope [N/m]."""
        loads = JumpLoads(self.s, change / step.elapsed, self.body_rate)
        screw = jump_drive.respond(self.drive, self.slider, self.state, step, loads)
        slide = slider_force(self.slider, self.s, change, step.elapsed)
        return screw, slide.force - screw.force, slide.by_change - screw.force_by_change
