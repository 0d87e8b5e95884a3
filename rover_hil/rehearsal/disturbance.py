"""Whether an emulated machine kept time: what was measured on one that did not says nothing.

Bridge, emulator and rehearsal then share a computer that is not the rover's. What the emulator had
to give up, and what the bridge's loop lacks, is told by their own reports. A real machine has no
such excuse, and none is looked for.
"""

from __future__ import annotations

from itertools import pairwise

from msg_schemas import topics
from msg_schemas.samples import Status, StatusSample
from rover_hil.rehearsal.history import Heard, History

_LACKING = 0.05  # time that the bridge's loop may lack against its reports' own [s]


def disturbance(history: History, since_ns: int) -> str:
    """What kept an emulated machine from keeping time, since a steady time [ns]; empty: nothing."""
    plant = _reports(history.of(topics.SIM_STATUS), since_ns, ": plant")
    if any(status.values.get("real_time") == "false" for _, status in plant) and not any(
        status.values.get("real_time_factor") == "lockstep" for _, status in plant
    ):
        return "the emulated machine did not keep real time"
    given_up = _change(plant, "wall_time_dropped")
    if given_up:
        return f"the emulated machine gave up {given_up:.2g} s"
    lacking = _lacking(_reports(history.of(topics.LINK_STATUS), since_ns, ": link"))
    if lacking > _LACKING:
        return f"the bridge was held up for {lacking:.2g} s by the computer that it is emulated on"
    return ""


def _reports(heard: list[Heard], since_ns: int, ending: str) -> list[tuple[int, Status]]:
    """Steady times and statuses of a name, from the last one before a steady time on."""
    told = [
        (each.steady_ns, status)
        for each in heard
        if isinstance(each.sample, StatusSample)
        for status in each.sample.statuses
        if status.name.endswith(ending)
    ]
    before = [index for index, (steady_ns, _) in enumerate(told) if steady_ns <= since_ns]
    return told[before[-1] :] if before else told


def _change(told: list[tuple[int, Status]], key: str) -> float:
    values = [float(status.values[key]) for _, status in told if status.values.get(key)]
    return values[-1] - values[0] if values else 0.0


def _lacking(told: list[tuple[int, Status]]) -> float:
    """Most by which the bridge's cycles fell behind its reports, between two of them [s]."""
    lacking = 0.0
    for (first_ns, first), (second_ns, second) in pairwise(told):
        if "cycles" not in first.values or "cycles" not in second.values:
            continue
        done = int(second.values["cycles"]) - int(first.values["cycles"])
        if done < 0:  # it began anew
            continue
        took = (second_ns - first_ns) * 1e-9
        lacking = max(lacking, took - done / float(second.values["sync_rate"]))
    return lacking
