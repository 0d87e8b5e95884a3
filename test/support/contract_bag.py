"""Synthetic bags of contract samples with closed-form metrics."""

import dataclasses
import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from rosbags.typesys import Stores, get_typestore

from msg_schemas import machine, topics
from msg_schemas.cdr import pack
from msg_schemas.phases import PlantPhase
from msg_schemas.refusal import RefusalCode, RefusalReport
from msg_schemas.samples import (
    ClockSample,
    JointSample,
    JointValue,
    OdometrySample,
    Sample,
    Status,
    StatusSample,
    TetherSample,
    TextSample,
    WrenchSample,
)
from msg_schemas.table import TOPICS
from rover_bags.files.store import BagWriter, standard_type

__all__ = ["STORE", "MadeUp", "Parabola", "ns", "odometry", "tether"]

STORE = get_typestore(Stores.ROS2_JAZZY)
EPOCH_NS = 1_790_000_000_000_000_000
LATENCY_NS = 300_000
GRAVITY = 9.81


@dataclasses.dataclass(frozen=True)
class Parabola:
    """A jump without tether forces: every metric has a closed form."""

    take_off: float = 1.003
    up: float = 2.0
    forward: float = 0.5
    turning: float = 0.8
    start: tuple[float, float, float] = (4.2, -2.0, 0.1)

    @property
    def height(self) -> float:
        return self.up**2 / (2.0 * GRAVITY)

    @property
    def flight_time(self) -> float:
        return 2.0 * self.up / GRAVITY

    def at(self, time: float, *, held: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """Pose x, z, theta and rates; ``held``: the plant stops the body at the landing."""
        since = time - self.take_off
        start = np.array(self.start)
        if since < 0.0:
            return start, np.zeros(3)
        rates = np.array([self.forward, self.up, self.turning])
        if since > self.flight_time and held:
            return start + rates * [1.0, 0.0, 1.0] * self.flight_time, np.zeros(3)
        pose = start + rates * since - np.array([0.0, 0.5 * GRAVITY * since**2, 0.0])
        return pose, rates - np.array([0.0, GRAVITY * since, 0.0])

    @property
    def landing(self) -> tuple[float, float, float]:
        """Pose at touchdown: x, z, theta."""
        x, z, theta = self.start
        return (x + self.forward * self.flight_time, z, theta + self.turning * self.flight_time)

    def phase(self, time: float) -> str:
        if time < self.take_off:
            return "held"
        return "flight" if time < self.take_off + self.flight_time else "landed"


def odometry(time: float, pose: np.ndarray, rates: np.ndarray) -> OdometrySample:
    """Planar pose and rates as a contract sample: theta turns about minus y."""
    x, z, theta = pose.tolist()
    vx, vz, rate = rates.tolist()
    c, s = math.cos(theta), math.sin(theta)
    return OdometrySample(
        ns(time),
        (x, 0.0, z),
        (0.0, -math.sin(theta / 2), 0.0, math.cos(theta / 2)),
        (c * vx + s * vz, 0.0, c * vz - s * vx),
        (0.0, -rate, 0.0),
    )


def ns(time: float) -> int:
    return round(time * 1e9)


def tether(time: float, end: tuple[float, float], tension: float, nodes: int = 6) -> TetherSample:
    """A straight tether from the fairlead to ``end``; the tension peaks in its middle."""
    share = np.linspace(0.0, 1.0, nodes)
    table = np.zeros((nodes, 7))
    table[:, 0], table[:, 2] = share * end[0], share * end[1]
    length = math.hypot(*end)
    table[:, 3], table[:, 5] = end[0] / length, end[1] / length
    table[:, 6] = tension * (1.0 - np.abs(share - share[nodes // 2]))
    return TetherSample(ns(time), table)


SCENARIO = {
    "name": "made up",
    "tether": {"length": 5.0},
    "rover": {"body1_size": [0.3, 0.15], "body2_size": [0.2, 0.1]},
}


class MadeUp:
    """Collects timed samples and writes them as a bag."""

    def __init__(self) -> None:
        self.rows: list[tuple[float, str, bytes]] = []

    def add(self, time: float, name: str, sample: Sample) -> None:
        self.rows.append((time, name, pack(name, sample)))

    def add_raw(self, time: float, name: str, data: bytes) -> None:
        self.rows.append((time, name, data))

    def jumps(
        self,
        jumps: Iterable[Parabola],
        *,
        until: float,
        rate: float = 100.0,
        held: bool = True,
        without: Iterable[str] = (),
        offset: float = 0.0,
    ) -> None:
        """Add all periodic topics over consecutive jumps.

        Args:
            jumps: in the order of their take-offs.
            until: end [s].
            rate: rate of bodies, sensors and energy [Hz].
            held: whether the plant stops the body at the landing.
            without: topics to omit.
            offset: added to the time of reception [s], for messages after a clock reset.
        """
        order = sorted(jumps, key=lambda jump: jump.take_off)
        omitted = set(without)

        def put(time: float, name: str, sample: Sample) -> None:
            if name not in omitted:
                self.add(time + offset, name, sample)

        config = json.dumps({"node": "/sim_node", "scenario": SCENARIO, "seed": 7})
        put(0.0, topics.CONFIG, TextSample(config))
        published = ""
        for count in range(round(until * rate) + 1):
            time = count / rate
            jump = next((j for j in reversed(order) if j.take_off <= time), order[0])
            pose, rates = jump.at(time, held=held)
            phase = jump.phase(time)
            put(time, topics.CLOCK, ClockSample(ns(time)))
            if phase != published:
                put(time, topics.TRUTH_PHASE, TextSample(phase))
                published = phase
            put(time, topics.TRUTH_BODY1, odometry(time, pose, rates))
            above = pose + np.array([-0.2 * math.sin(pose[2]), 0.2 * math.cos(pose[2]), 0.0])
            put(time, topics.TRUTH_BODY2, odometry(time, above, rates))
            stands = JointValue(0.0 if phase == PlantPhase.FLIGHT else 1.0)
            put(time, topics.CONTACT, JointSample(ns(time), {machine.FLOOR_SWITCH: stands}))
            put(time, topics.LOAD_CELL, WrenchSample(ns(time), (3.0, 0.0, -4.0)))
            # The balance drifts by 1 microjoule per second.
            energies = {name: JointValue() for name in machine.ENERGY_NAMES}
            energies["drift"] = JointValue(1e-6 * time)
            energies["kinetic"] = JointValue(2.5 * float(rates[0] ** 2 + rates[1] ** 2))
            put(time, topics.TRUTH_ENERGY, JointSample(ns(time), energies))
            if count % 2 == 0:
                tension = 7.5 if phase == PlantPhase.FLIGHT else 1.0
                put(time, topics.TRUTH_TETHER, tether(time, (4.0, -2.0), tension))

    def event(self, time: float, name: str, message: str, values: Mapping[str, str]) -> None:
        status = Status(name, message, hardware_id="sim_node", values=dict(values))
        self.add(time, topics.EVENTS, StatusSample(ns(time), (status,)))

    def refusal(self, time: float, subject: str, reason: str) -> None:
        status = RefusalReport("jump_node", subject, RefusalCode.NOT_FINITE, reason).status()
        self.add(time, topics.DIAGNOSTICS, StatusSample(ns(time), (status,)))

    def write(self, path: Path, *, prefix: str = "/", close: bool = True) -> Path:
        """Write the bag as a recorder would."""
        writer = BagWriter(path, sync=False, chunk_period=1e6, chunk_bytes=20_000)
        channels: dict[str, int] = {}
        for time, name, data in sorted(self.rows, key=lambda row: row[0]):
            full = name if name.startswith("/") else prefix + name
            if full not in channels:
                channels[full] = writer.add_topic(full, standard_type(TOPICS[name].message))
            sent = EPOCH_NS + ns(time)
            writer.write(channels[full], sent + LATENCY_NS, sent, data)
        if close:
            writer.close()
        else:
            writer.flush()
            writer.abandon()
        return path
