"""Whether an emulated machine kept real time; otherwise its measured times are invalid.

Bridge, emulator and rehearsal share one computer then. The emulator reports the wall time that it
dropped, and the bridge reports its cycles. A real machine is always held to its times.
"""

from __future__ import annotations

from itertools import pairwise

from msg_schemas import topics
from msg_schemas.samples import Status, StatusSample
from rover_hil.rehearsal.message_history import MessageHistory, ReceivedMessage

_LAG_LIMIT = 0.05  # by which the bridge's cycles may fall behind its reports [s]


def timing_fault(history: MessageHistory, since_ns: int) -> str:
    """Why an emulated machine lost real time since a steady time [ns]; empty: it kept real time."""
    plant = _reports(history.of(topics.SIM_STATUS), since_ns, ": plant")
    if any(status.values.get("real_time") == "false" for _, status in plant) and not any(
        status.values.get("real_time_factor") == "lockstep" for _, status in plant
    ):
        return "the emulated machine did not keep real time"
    dropped = _increase(plant, "wall_time_dropped")
    if dropped:
        return f"the emulated machine dropped {dropped:.2g} s of wall time"
    lag = _longest_lag(_reports(history.of(topics.LINK_STATUS), since_ns, ": link"))
    if lag > _LAG_LIMIT:
        return f"the bridge lagged by {lag:.2g} s on the emulating computer"
    return ""


def _reports(
    messages: list[ReceivedMessage], since_ns: int, suffix: str
) -> list[tuple[int, Status]]:
    """Steady times and statuses with a name suffix, from the last one before a steady time on."""
    reports = [
        (each.steady_ns, status)
        for each in messages
        if isinstance(each.sample, StatusSample)
        for status in each.sample.statuses
        if status.name.endswith(suffix)
    ]
    before = [index for index, (steady_ns, _) in enumerate(reports) if steady_ns <= since_ns]
    return reports[before[-1] :] if before else reports


def _increase(reports: list[tuple[int, Status]], key: str) -> float:
    values = [float(status.values[key]) for _, status in reports if status.values.get(key)]
    return values[-1] - values[0] if values else 0.0


def _longest_lag(reports: list[tuple[int, Status]]) -> float:
    """Longest lag of the bridge's cycles between two of its reports [s]."""
    lag = 0.0
    for (first_ns, first), (second_ns, second) in pairwise(reports):
        if "cycles" not in first.values or "cycles" not in second.values:
            continue
        cycles = int(second.values["cycles"]) - int(first.values["cycles"])
        if cycles < 0:  # it restarted
            continue
        elapsed = (second_ns - first_ns) * 1e-9
        lag = max(lag, elapsed - cycles / float(second.values["sync_rate"]))
    return lag
