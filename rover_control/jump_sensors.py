"""What the rover's own sensors say to the jump's sequence. Pure.

What is heard holds for the time of its stamp, however late that is: the controller's clock may be
simulated, and topics may lag behind one another.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

from msg_schemas import topics
from msg_schemas.samples import ImuSample, JointSample, WrenchSample
from msg_schemas.table import FLOOR_SWITCH, JUMP_SCREW

_NANO = 1e9
_CLOSED = 0.5  # a contact's position from here on means closed


def seconds(later_ns: int, earlier_ns: int) -> float:
    """Time between two stamps [s]."""
    return (later_ns - earlier_ns) / _NANO


class Reading(NamedTuple):
    """A sensor's last value and when it was measured."""

    value: float
    stamp_ns: int


@dataclass(frozen=True)
class Sensors:
    """What the rover knows of itself; None = never heard."""

    contact: Reading | None = None  # 1 closed, 0 open
    opened_ns: int | None = None  # when the contact last opened,
    last_open_ns: int | None = None  # was last open,
    closed_ns: int | None = None  # and closed again
    compression: Reading | None = None  # where the nut stands [m]
    nut_force: Reading | None = None  # of the spring on it [N]
    specific_force: Reading | None = None  # magnitude [m/s^2]
    tilt: float = math.nan  # of base_link z from the specific force [rad]
    rate: float = math.nan  # angular, magnitude [rad/s]
    pull: Reading | None = None  # of the tether at the rover [N]

    def readings(self) -> tuple[tuple[str, Reading | None], ...]:
        """Return the topic and the last reading of each sensor that a jump cannot do without."""
        return (
            (topics.CONTACT, self.contact),
            (topics.JUMP_MOTOR_STATE, self.compression),
            (topics.IMU, self.specific_force),
        )

    def with_contact(self, sample: JointSample, now_ns: int) -> Sensors:
        """Take a sample of the contact switch."""
        value, stamp_ns = sample.joints[FLOOR_SWITCH].position, sample.stamp_ns or now_ns
        taken = replace(self, contact=Reading(value, stamp_ns))
        if taken.is_open:
            opened_ns = self.opened_ns if self.is_open else stamp_ns
            return replace(taken, opened_ns=opened_ns, last_open_ns=stamp_ns)
        return replace(taken, closed_ns=stamp_ns) if self.is_open else taken

    def with_jump_motor(self, sample: JointSample, now_ns: int) -> Sensors:
        """Take a sample of the jump motor's state."""
        nut, stamp_ns = sample.joints[JUMP_SCREW], sample.stamp_ns or now_ns
        return replace(
            self,
            compression=Reading(nut.position, stamp_ns),
            nut_force=Reading(nut.effort, stamp_ns),
        )

    def with_imu(self, sample: ImuSample, now_ns: int) -> Sensors:
        """Take a sample of the IMU."""
        x, y, z = sample.linear_acceleration
        return replace(
            self,
            specific_force=Reading(math.hypot(x, y, z), sample.stamp_ns or now_ns),
            tilt=math.atan2(math.hypot(x, y), z),
            rate=math.hypot(*sample.angular_velocity),
        )

    def with_load_cell(self, sample: WrenchSample, now_ns: int) -> Sensors:
        """Take a sample of the load cell at the tether's rover end."""
        return replace(self, pull=Reading(math.hypot(*sample.force), sample.stamp_ns or now_ns))

    @property
    def is_open(self) -> bool:
        """Whether the contact is known to be open."""
        return self.contact is not None and self.contact.value < _CLOSED

    @property
    def open_time(self) -> float:
        """How long the contact was open when it was so last [s]; nan if that is not known."""
        if self.opened_ns is None or self.closed_ns is None or self.closed_ns < self.opened_ns:
            return math.nan
        return seconds(self.closed_ns, self.opened_ns)

    def is_down(self, zero: float, now_ns: int, patience: float) -> bool:
        """Whether the nut is known to compress the spring by no more than `zero` [m]."""
        nut = self.compression
        return nut is not None and is_fresh(nut, now_ns, patience) and nut.value <= zero

    def lost(self, now_ns: int, patience: float) -> str:
        """Say which sensor is silent for longer than `patience` [s]; empty if none is."""
        silences = (silence(topic, r, now_ns, patience) for topic, r in self.readings())
        return next(filter(None, silences), "")

    def waiting_for(self, now_ns: int, patience: float) -> tuple[str, ...]:
        """Return the topics of the sensors that are silent."""
        return tuple(t for t, r in self.readings() if silence(t, r, now_ns, patience))


def is_fresh(reading: Reading, now_ns: int, patience: float) -> bool:
    """Whether a reading is no older than `patience` [s]."""
    return abs(seconds(now_ns, reading.stamp_ns)) <= patience


def silence(topic: str, reading: Reading | None, now_ns: int, patience: float) -> str:
    """Say that a sensor is silent; empty if it is not."""
    if reading is None:
        return f"{topic} was never heard"
    if is_fresh(reading, now_ns, patience):
        return ""
    age = seconds(now_ns, reading.stamp_ns)
    if age > 0.0:
        return f"{topic} is silent for {age:.3g} s"
    return f"{topic} is stamped {-age:.3g} s ahead: its sender follows another clock"
