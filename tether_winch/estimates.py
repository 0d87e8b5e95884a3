"""Payout and tension from encoder, motor current and load cell alone. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

from msg_schemas.parameters import parameter
from tether_winch.drum_model import DrumModel


@dataclass(frozen=True)
class EstimateParameters:
    """Timeouts and plausibility limits of the sensors."""

    encoder_timeout: float = parameter(
        0.1, "s", "time without a drum state after which the drum is lost", 0.02, 1.0
    )
    load_cell_timeout: float = parameter(
        0.1, "s", "time without a load cell reading after which its tension is invalid", 0.02, 10.0
    )
    load_cell_range: float = parameter(
        500.0, "N", "largest valid reading of the load cell", 1.0, 1e6
    )
    drift_time: float = parameter(
        1.0,
        "s",
        "time over which the drum's length is compared with its integrated rate",
        0.1,
        60.0,
    )
    largest_drift: float = parameter(
        0.02, "m", "largest difference of the two in that time", 1e-3, 1.0
    )
    tension_mismatch: float = parameter(
        0.6, "-", "relative difference of load cell and motor beyond which both are invalid",
        0.05, 10.0,
    )  # fmt: skip
    mismatch_floor: float = parameter(
        6.0, "N", "difference of load cell and motor that is always allowed", 0.0, 1000.0
    )
    mismatch_time: float = parameter(
        1.5, "s", "time for which they must differ, in steady motion", 0.1, 60.0
    )


class PayoutEstimate:
    """Length, rate and acceleration of the payout, consistent with each other.

    The drum reports both length and rate. Their estimate is one motion: it is driven by the
    reported rate and drawn to the reported length, and their disagreement over `drift_time` tells
    an encoder or a drive that is not to be trusted.
    """

    _RATE_TIME = 0.01  # of the rate's low-pass [s]
    _ACCELERATION_TIME = 0.05
    _PULL = 5.0  # by which the length is drawn to the reported one [1/s]
    _LONGEST_AGE = 0.05  # that is made up for [s]

    def __init__(self, parameters: EstimateParameters) -> None:
        self.parameters = parameters
        self.length = math.nan
        self.rate = 0.0
        self.acceleration = 0.0
        self.drift = 0.0  # of the length against the integrated rate, forgotten over drift_time [m]
        self._reported = math.nan
        self._reported_rate = 0.0
        self._taken = 0.0
        self._heard: float | None = None

    @property
    def is_known(self) -> bool:
        """Whether the drum has ever spoken."""
        return self._heard is not None

    def hear(self, length: float, rate: float, taken: float, now: float) -> None:
        """Take what the drum reports.

        Args:
            length: paid out [m].
            rate: of payout [m/s].
            taken: when the drum measured it, by the drum's clock [s]: after a stall several
                samples are heard at once.
            now: when it is heard, by the controller's clock [s].
        """
        dt = taken - self._taken
        # A drum whose clock goes back begins anew; what only comes in the wrong order is left out.
        if self._heard is None or dt < -self.parameters.encoder_timeout:
            self.length, self.rate, self.acceleration = length, rate, 0.0
        elif dt <= 0.0:
            return
        else:
            mean = 0.5 * (rate + self._reported_rate)
            # Over a longer silence the drum may have stopped and started: nothing to compare.
            if dt <= self.parameters.encoder_timeout:
                self.drift += length - self._reported - mean * dt
            self.drift *= math.exp(-dt / self.parameters.drift_time)
            before = self.rate
            self.rate += (rate - self.rate) * -math.expm1(-dt / self._RATE_TIME)
            step = (self.rate - before) / dt
            self.acceleration += (step - self.acceleration) * -math.expm1(
                -dt / self._ACCELERATION_TIME
            )
            predicted = self.length + mean * dt
            self.length = predicted + (length - predicted) * -math.expm1(-dt * self._PULL)
        self._reported, self._reported_rate = length, rate
        self._taken, self._heard = taken, now

    def length_at(self, now: float) -> float:
        """Length now [m]: a sample that was under way for a tick is 3 mm old at 0.3 m/s."""
        return self.length + self.rate * min(max(now - self._taken, 0.0), self._LONGEST_AGE)

    def silence(self, now: float) -> float:
        """How long the drum has said nothing [s]."""
        return math.inf if self._heard is None else now - self._heard

    def fault(self, now: float) -> str:
        """Why the payout is not known; empty if it is."""
        p = self.parameters
        if self._heard is None:
            return "the drum's state was never heard"
        if self.silence(now) > p.encoder_timeout:
            return (
                f"the drum's state is silent for {self.silence(now):.3g} s, "
                f"it must come every {p.encoder_timeout:g} s"
            )
        if abs(self.drift) > p.largest_drift:
            return (
                f"length and rate of the drum came apart by {self.drift:.3g} m within "
                f"{p.drift_time:g} s, at most {p.largest_drift:g} m is right"
            )
        return ""


class TensionSource(StrEnum):
    """What a tension was taken from."""

    LOAD_CELL = "load_cell"
    MOTOR = "motor"
    NONE = "none"


class TensionEstimate:
    """Tension at the fairlead with its validity.

    The load cell is believed while it speaks, within its range. Without it the motor's current
    tells, less precisely, while the brake is open. In steady motion the two are compared.
    """

    def __init__(self, parameters: EstimateParameters, drum: DrumModel) -> None:
        self.parameters = parameters
        self._drum = drum
        self._cell = math.nan
        self._cell_heard: float | None = None
        self._motor = math.nan  # tether tension by the motor [N]
        self._motor_heard: float | None = None
        self._apart_since: float | None = None
        self.mismatch = ""
        self.cell_fault = "the load cell was never heard"

    def on_cell(self, tension: float, now: float) -> None:
        """Take a reading of the load cell [N]."""
        limit = self.parameters.load_cell_range
        if not abs(tension) <= limit:
            self._cell = math.nan
            self.cell_fault = f"the load cell reads {tension:.4g} N, its range is {limit:g} N"
            return
        self._cell, self._cell_heard, self.cell_fault = tension, now, ""

    def lose(self, reason: str) -> None:
        """Nothing is known any more until the load cell speaks again."""
        self._cell = math.nan
        self._motor_heard = None
        self.cell_fault = reason

    def retune(self, parameters: EstimateParameters, drum: DrumModel) -> None:
        """Go by other parameters."""
        self.parameters, self._drum = parameters, drum

    def on_motor(
        self, current: float, payout: PayoutEstimate, brake_is_open: bool, now: float
    ) -> None:
        """Take the motor's current [A], > 0 paying out; it says nothing behind a closed brake."""
        if not (brake_is_open and payout.is_known and math.isfinite(current)):
            self._motor_heard = self._apart_since = None
            return
        torque = -current * self._drum.parameters.torque_constant
        carried = self._drum.tension_of(torque, payout.length)
        self._motor = self._drum.tether_tension(
            carried, payout.length, payout.rate, payout.acceleration
        )
        self._motor_heard = now

    def step(self, payout: PayoutEstimate, now: float) -> None:
        """Let time pass: silence, and comparison of the two in steady motion."""
        p = self.parameters
        if self._cell_heard is not None and now - self._cell_heard > p.load_cell_timeout:
            silent = now - self._cell_heard
            self._cell = math.nan
            self.cell_fault = f"the load cell is silent for {silent:.3g} s"
        motor = self._fresh_motor(now)
        steady = abs(payout.acceleration) < 0.1 and abs(payout.rate) > 0.02
        if math.isnan(self._cell) or math.isnan(motor) or not steady:
            self._apart_since = None
            return
        allowed = max(p.mismatch_floor, p.tension_mismatch * max(abs(self._cell), abs(motor)))
        if abs(self._cell - motor) <= allowed:
            self._apart_since, self.mismatch = None, ""
            return
        if self._apart_since is None:
            self._apart_since = now
        if now - self._apart_since >= p.mismatch_time:
            self.mismatch = (
                f"load cell {self._cell:.4g} N and motor {motor:.4g} N disagree by more than "
                f"{allowed:.3g} N"
            )

    def value(self, now: float) -> tuple[float, TensionSource]:
        """Tension [N] and what it was taken from; NaN where nothing valid is known."""
        if self.mismatch:
            return math.nan, TensionSource.NONE
        if not math.isnan(self._cell):
            return self._cell, TensionSource.LOAD_CELL
        motor = self._fresh_motor(now)
        if not math.isnan(motor):
            return motor, TensionSource.MOTOR
        return math.nan, TensionSource.NONE

    def _fresh_motor(self, now: float) -> float:
        if self._motor_heard is None or now - self._motor_heard > self.parameters.load_cell_timeout:
            return math.nan
        return self._motor
