"""What a step of the spatial plant reports, read from the arrays of `integrator_memory`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property

from msg_schemas.events import PlantEvent
from rover_sim.physics.integrators import integrator_memory
from rover_sim.physics.mechanisms.jump_drive import Latch
from rover_sim.physics.tether.ancf import Array
from rover_sim.plants.plant import Energies, Event, Forces, Outcome, StepResult
from rover_sim.plants.spatial_state import SpatialState, energy_balance_sums


class SpatialResult(StepResult):
    """Result of a step that decodes energies and forces when somebody asks for them."""

    _report: list[float]
    _after: SpatialState

    def __init__(
        self, outcome: Outcome, report: list[float], after: SpatialState, events: tuple[Event, ...]
    ) -> None:
        peak = report[integrator_memory.PEAK_TENSION]
        self.__dict__.update(
            outcome=outcome,
            constraint_drift=report[integrator_memory.CONSTRAINT_DRIFT],
            newton_iterations=int(report[integrator_memory.ITERATIONS]),
            smallest_step=report[integrator_memory.SMALLEST_STEP],
            events=events,
            peak_tension=peak if math.isfinite(peak) else 0.0,
            _report=report,
            _after=after,
        )

    @cached_property
    def energies(self) -> Energies:
        """Energies at the end of the step."""
        return energies_of(self._report, self._after.memory)

    @cached_property
    def forces(self) -> Forces:
        """Forces and currents of the last step of the integrator."""
        return _forces_of(self._report, self._after.memory)


def energies_of(report: Sequence[float], memory: Array) -> Energies:
    """Return the energies at the end of a call, from its report and the memory."""
    received, dissipated = energy_balance_sums(memory)
    rotors = float(memory[integrator_memory.DRIVE_KINETIC])
    return Energies(
        kinetic=report[integrator_memory.KINETIC] - rotors,
        gravity=report[integrator_memory.GRAVITY],
        axial=report[integrator_memory.AXIAL],
        bending=report[integrator_memory.BENDING],
        spring=report[integrator_memory.SPRING],
        input=received,
        dissipated=dissipated,
        initial=float(memory[integrator_memory.INITIAL_ENERGY]),
        rotors=rotors,
        contact=report[integrator_memory.CONTACT],
        twist=report[integrator_memory.TORSION],
        driven_ends=float(memory[integrator_memory.INPUT_ENDS]),
        air_drag=float(memory[integrator_memory.HEAT_AIR]),
    )


def _forces_of(report: Sequence[float], memory: Array) -> Forces:
    return Forces(
        fairlead_tension=float(memory[integrator_memory.FAIRLEAD_TENSION]),
        rover_tension=report[integrator_memory.TIP_TENSION],
        left_wheel=report[integrator_memory.LEFT_LOAD],
        right_wheel=report[integrator_memory.RIGHT_LOAD],
        body=report[integrator_memory.BODY_LOAD],
        jump_current=report[integrator_memory.JUMP_CURRENT],
        wheel_current=report[integrator_memory.WHEEL_CURRENT],
        winch_current=report[integrator_memory.WINCH_CURRENT],
        screw_hard_limit=int(report[integrator_memory.SCREW_HARD_LIMIT]),
    )


def event_of(row: Array) -> Event:
    """Return the event of a row of the event array."""
    kind, time, x, y, z, speed, rise, tension, value = (float(entry) for entry in row)
    place = {"x": x, "y": y, "z": z}
    if int(kind) == integrator_memory.EVENT_LATCH:
        return Event(PlantEvent[f"LATCH_{Latch(int(value)).name}"], time, {**place, "speed": speed})
    name, values = {
        integrator_memory.EVENT_TAKE_OFF: (PlantEvent.TAKE_OFF, {"speed": speed}),
        integrator_memory.EVENT_APEX: (PlantEvent.APEX, {"height": value}),
        integrator_memory.EVENT_TOUCHDOWN: (
            PlantEvent.TOUCHDOWN,
            {"height": rise, "speed": speed, "load": value},
        ),
        integrator_memory.EVENT_BROKEN: (PlantEvent.TETHER_BROKEN, {"tension": tension}),
        integrator_memory.EVENT_DIVERGED: (PlantEvent.DIVERGED, {}),
        integrator_memory.EVENT_DRUM_STOP: (
            PlantEvent.DRUM_STOP,
            {"side": value, "tension": tension},
        ),
        integrator_memory.EVENT_ENERGY_DRIFT: (
            PlantEvent.ENERGY_DRIFT,
            {"drift": value, "turnover": tension},
        ),
        integrator_memory.EVENT_TETHER_PUSH: (
            PlantEvent.TETHER_PUSH,
            {"push": value, "limit": tension},
        ),
    }[int(kind)]
    return Event(name, time, {**place, **values})
