"""Sensor state of the jump sequence. Pure.

Each reading is valid at its own time stamp, however late it arrives: the clock may be simulated,
and topics may lag behind each other.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from msg_schemas import machine, topics
from msg_schemas.samples import ImuSample, JointSample, WrenchSample

_NANO = 1e9
_CLOSED = 0.5  # contact position from which on the contact is closed


def seconds(later_ns: int, earlier_ns: int) -> float:
    """Time between two stamps [s]."""
    return (later_ns - earlier_ns) / _NANO


class Reading(NamedTuple):
    """Last value of a sensor and its time stamp."""

    value: float
    stamp_ns: int


class Sensors(NamedTuple):
    """Last readings of all sensors; None = never received."""

    contact: Reading | None = None  # 1 closed, 0 open
    opened_ns: int | None = None  # time when the contact last opened
    last_open_ns: int | None = None  # time when it was last open
    closed_ns: int | None = None  # time when it closed again
    compression: Reading | None = None  # position of the nut [m]
    nut_force: Reading | None = None  # of the spring on the nut [N]
    specific_force: Reading | None = None  # magnitude [m/s^2]
    tilt: float = math.nan  # of base_link z, from the specific force [rad]
    rate: float = math.nan  # magnitude of the angular rate [rad/s]
    tether_tension: Reading | None = None  # at the rover [N]

    def readings(self) -> tuple[tuple[str, Reading | None], ...]:
        """Topic and last reading of each sensor that a jump requires."""
        return (
            (topics.CONTACT, self.contact),
            (topics.JUMP_MOTOR_STATE, self.compression),
            (topics.IMU, self.specific_force),
        )

    def with_contact(self, sample: JointSample, now_ns: int) -> Sensors:
        """Process a contact switch sample."""
        value, stamp_ns = sample.joints[machine.FLOOR_SWITCH].position, sample.stamp_ns or now_ns
        contact = Reading(value, stamp_ns)
        if value < _CLOSED:
            opened_ns = self.opened_ns if self.is_open else stamp_ns
            return self._replace(contact=contact, opened_ns=opened_ns, last_open_ns=stamp_ns)
        closed_ns = stamp_ns if self.is_open else self.closed_ns
        return self._replace(contact=contact, closed_ns=closed_ns)

    def with_jump_motor(self, sample: JointSample, now_ns: int) -> Sensors:
        """Process a jump motor sample."""
        nut, stamp_ns = sample.joints[machine.JUMP_SCREW], sample.stamp_ns or now_ns
        return self._replace(
            compression=Reading(nut.position, stamp_ns),
            nut_force=Reading(nut.effort, stamp_ns),
        )

    def with_imu(self, sample: ImuSample, now_ns: int) -> Sensors:
        """Process an IMU sample."""
        x, y, z = sample.linear_acceleration
        return self._replace(
            specific_force=Reading(math.hypot(x, y, z), sample.stamp_ns or now_ns),
            tilt=math.atan2(math.hypot(x, y), z),
            rate=math.hypot(*sample.angular_velocity),
        )

    def with_load_cell(self, sample: WrenchSample, now_ns: int) -> Sensors:
        """Process a sample of the load cell at the tether's rover end."""
        tension = Reading(math.hypot(*sample.force), sample.stamp_ns or now_ns)
        return self._replace(tether_tension=tension)

    @property
    def is_open(self) -> bool:
        """Whether the contact is known to be open."""
        return self.contact is not None and self.contact.value < _CLOSED

    @property
    def open_time(self) -> float:
        """Duration of the last opening of the contact [s]; nan = unknown."""
        if self.opened_ns is None or self.closed_ns is None or self.closed_ns < self.opened_ns:
            return math.nan
        return seconds(self.closed_ns, self.opened_ns)

    def is_let_down(self, zero: float, now_ns: int, timeout: float) -> bool:
        """Whether the nut is known to compress the spring by at most `zero` [m]."""
        nut = self.compression
        return nut is not None and is_fresh(nut, now_ns, timeout) and nut.value <= zero

    def stale(self, now_ns: int, timeout: float) -> str:
        """Describe the first sensor that is older than `timeout` [s]; empty = none."""
        reasons = (staleness(topic, r, now_ns, timeout) for topic, r in self.readings())
        return next(filter(None, reasons), "")

    def waiting_for(self, now_ns: int, timeout: float) -> tuple[str, ...]:
        """Topics of the stale sensors."""
        return tuple(t for t, r in self.readings() if staleness(t, r, now_ns, timeout))


def is_fresh(reading: Reading, now_ns: int, timeout: float) -> bool:
    """Whether a reading is no older than `timeout` [s]."""
    return abs(seconds(now_ns, reading.stamp_ns)) <= timeout


def staleness(topic: str, reading: Reading | None, now_ns: int, timeout: float) -> str:
    """Describe why a reading is stale; empty = it is fresh."""
    if reading is None:
        return f"{topic} was never received"
    if is_fresh(reading, now_ns, timeout):
        return ""
    age = seconds(now_ns, reading.stamp_ns)
    if age > 0.0:
        return f"the last sample of {topic} is {age:.3g} s old"
    return f"{topic} is stamped {-age:.3g} s ahead: its sender uses another clock"
