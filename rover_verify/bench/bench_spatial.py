"""Bench of the spatial plant: at rest on rubble with all models on, and its slowest 10 ms."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Final

import numpy as np

from msg_schemas.events import PlantEvent
from rover_sim import JumpMotorCommand, PlantCommand, SpatialPlant, SpatialState, load_spatial
from rover_verify.bench import core_peak
from rover_verify.bench.bench_row import Progress, Row, bench_row, text_table

RESTING: Final = "rest on rubble"
WORST: Final = "worst window"
ELEMENTS: Final = (20, 50, 100)
WORST_ELEMENTS: Final = 50

_SCENARIO = "floor_rubble"
_TICK = 0.01  # of the control loop [s]
_DURATION = 2.0  # simulated and timed [s]
_JUMPING = 7.0  # compression, jump, landing and bounces [s]
_STROKE = PlantCommand(jump=JumpMotorCommand(0.15, 0.06))
_IDLE = PlantCommand()


def make_plant(elements: int) -> SpatialPlant:
    """The default machine on rubble with `elements` elements, slack tether on the floor."""
    overrides = {"tether.element_length": None, "tether.elements": elements}
    return SpatialPlant(load_spatial(_SCENARIO, overrides))


def _rest(plant: SpatialPlant, start: SpatialState, tick: float) -> tuple[float, int]:
    """CPU time [s] and Newton iterations of a rover at rest, stepped by `tick` [s]."""
    state, iterations = start, 0
    began = time.process_time()
    for _ in range(round(_DURATION / tick)):
        state, result = plant.step(state, _IDLE, tick)
        iterations += result.newton_iterations
    return time.process_time() - began, iterations


def measure_rest(repetitions: int, progress: Progress) -> list[Row]:
    """One row for each number of elements, measured in turn.

    The shortest time of each counts: without a peer no ratio cancels the effect of other load on
    the computer.
    """
    plants = [make_plant(n) for n in ELEMENTS]
    starts = [plant.initial_state() for plant in plants]
    ticked: list[list[float]] = [[] for _ in ELEMENTS]
    whole: list[list[float]] = [[] for _ in ELEMENTS]
    iterations = [0 for _ in ELEMENTS]
    for repetition in range(repetitions + 1):  # the first warms up
        progress(f"timing {repetition}/{repetitions}")
        for k, (plant, start) in enumerate(zip(plants, starts, strict=True)):
            spent, iterations[k] = _rest(plant, start, _TICK)
            in_one, _ = _rest(plant, start, _DURATION)
            if repetition > 0:
                ticked[k].append(spent)
                whole[k].append(in_one)
    steps = round(_DURATION / plants[0].scenario.integration.h)
    compiled = [min(times) / steps for times in whole]
    # The cost of a step is linear in the number of elements; the slope is the tether's.
    slope, rest = np.polyfit(ELEMENTS, compiled, 1)
    peak = core_peak.peak_gflops()
    rows: list[Row] = []
    for k, n in enumerate(ELEMENTS):
        best = min(ticked[k])
        per_element = float(slope) * steps / iterations[k]
        rows.append(
            bench_row(
                RESTING,
                n,
                rtf=_DURATION / best,
                tick_s=_TICK,
                microseconds_per_step=best / steps * 1e6,
                rtf_in_one_call=1e-3 / compiled[k],
                share_compiled=compiled[k] * steps / best,
                share_tether=float(slope) * n * steps / best,
                microseconds_rover_drives_ground=float(rest) * 1e6,
                nanoseconds_per_element_and_iteration=per_element * 1e9,
                iterations_per_step=iterations[k] / steps,
                core_peak_gflops=peak,
                share_of_core_peak=(
                    core_peak.FLOPS_PER_SPATIAL_ELEMENT_ITERATION / per_element * 1e-9 / peak
                ),
            )
        )
    return rows


def measure_worst(repetitions: int, progress: Progress) -> Row:
    """The slowest tick of a jump with its landing on rubble.

    The same ticks are timed several times and the shortest time of each counts, which excludes
    other load on the computer.
    """
    plant = make_plant(WORST_ELEMENTS)
    start = plant.initial_state()
    ticks = round(_JUMPING / _TICK)
    spent = np.full(ticks, np.inf)
    iterations = np.zeros(ticks)
    times = np.zeros(ticks)
    for repetition in range(max(3, repetitions)):
        progress(f"jump {repetition + 1}")
        state, released = start, False
        for k in range(ticks):
            began = time.thread_time_ns()
            state, result = plant.step(state, _IDLE if released else _STROKE, _TICK)
            spent[k] = min(spent[k], (time.thread_time_ns() - began) * 1e-9)
            released = released or any(
                event.name == PlantEvent.LATCH_RELEASED for event in result.events
            )
            iterations[k], times[k] = result.newton_iterations, state.time
    if not released:
        raise RuntimeError("the rover did not jump")
    worst = int(np.argmax(spent))
    return bench_row(
        WORST,
        WORST_ELEMENTS,
        rtf=_TICK / float(spent[worst]),
        tick_s=_TICK,
        at_s=float(times[worst]),
        iterations=int(iterations[worst]),
        rtf_median=_TICK / float(np.median(spent)),
    )


def measure(names: Sequence[str], repetitions: int, progress: Progress) -> list[Row]:
    """Rows of the chosen cases."""
    rows: list[Row] = []
    if RESTING in names:
        rows += measure_rest(repetitions, progress)
    if WORST in names:
        rows.append(measure_worst(repetitions, progress))
    return rows


_RESTING_COLUMNS = (
    ("resting on rubble", "case", ""), ("n", "n", ""), ("rtf", "rtf", ".1f"),
    ("us/step", "microseconds_per_step", ".1f"), ("compiled", "share_compiled", ".0%"),
    ("tether", "share_tether", ".0%"), ("iterations", "iterations_per_step", ".2f"),
    ("ns/element/iteration", "nanoseconds_per_element_and_iteration", ".0f"),
    ("of core peak", "share_of_core_peak", ".1%"),
)  # fmt: skip


def table(rows: Sequence[Row]) -> str:
    """The rows as text for a terminal."""
    lines = [f"spatial plant, all models on, at 1 ms, in ticks of {_TICK * 1e3:g} ms"]
    resting = [row for row in rows if row["case"] == RESTING]
    if resting:
        rest = resting[0]["microseconds_rover_drives_ground"]
        operations = core_peak.FLOPS_PER_SPATIAL_ELEMENT_ITERATION
        lines += [
            *text_table(_RESTING_COLUMNS, resting),
            f"rover, drives and ground without the tether: {rest:.1f} us/step",
            f"about {operations} operations per element and iteration",
        ]
    lines += [
        f"worst {_TICK * 1e3:g} ms of a jump and its landing, n = {row['n']}: rtf {row['rtf']:.1f} "
        f"({row['iterations']} iterations, at {row['at_s']:.2f} s; median {row['rtf_median']:.1f})"
        for row in rows
        if row["case"] == WORST
    ]
    return "\n".join(lines)
