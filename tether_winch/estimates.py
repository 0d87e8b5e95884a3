"""Estimates of payout and tension from encoder, motor current and load cell. Pure."""

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
    """Consistent estimate of payout length, rate and acceleration.

    A complementary filter integrates the reported rate and corrects it toward the reported length.
    A difference of the two over `drift_time` reveals a faulty encoder or drive.
    """

    _RATE_TIME = 0.01  # low-pass of the rate [s]
    _ACCELERATION_TIME = 0.05
    _PULL = 5.0  # gain of the correction toward the reported length [1/s]
    _LONGEST_AGE = 0.05  # that is extrapolated [s]

    def __init__(self, parameters: EstimateParameters) -> None:
        self.parameters = parameters
        self.length = math.nan
        self.rate = 0.0
        self.acceleration = 0.0
        self.drift = 0.0  # length less integrated rate, leaky over drift_time [m]
        self._reported = math.nan
        self._reported_rate = 0.0
        self._stamp = 0.0
        self._received: float | None = None

    @property
    def is_known(self) -> bool:
        """Whether a drum state has been received."""
        return self._received is not None

    def update(self, length: float, rate: float, taken: float, now: float) -> None:
        """Update with a drum state.

        Args:
            length: payout [m].
            rate: payout rate [m/s].
            taken: time of the measurement by the drum's clock [s]; after a stall several samples
                arrive at once.
            now: time of reception by the controller's clock [s].
        """
        dt = taken - self._stamp
        # Restart if the drum's clock jumps back; drop a sample that is merely out of order.
        if self._received is None or dt < -self.parameters.encoder_timeout:
            self.length, self.rate, self.acceleration = length, rate, 0.0
        elif dt <= 0.0:
            return
        else:
            mean = 0.5 * (rate + self._reported_rate)
            # After a longer gap the drum may have stopped and started: the drift is undefined.
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
        self._stamp, self._received = taken, now

    def length_at(self, now: float) -> float:
        """Length now [m]: a sample that was under way for a tick is 3 mm old at 0.3 m/s."""
        return self.length + self.rate * min(max(now - self._stamp, 0.0), self._LONGEST_AGE)

    def age(self, now: float) -> float:
        """Age of the last drum state [s]."""
        return math.inf if self._received is None else now - self._received

    def fault(self, now: float) -> str:
        """Why the payout is unknown; empty if it is known."""
        p = self.parameters
        if self._received is None:
            return "no drum state received"
        if self.age(now) > p.encoder_timeout:
            return (
                f"no drum state received for {self.age(now):.3g} s, "
                f"the limit is {p.encoder_timeout:g} s"
            )
        if abs(self.drift) > p.largest_drift:
            return (
                f"length and integrated rate of the drum differ by {self.drift:.3g} m within "
                f"{p.drift_time:g} s, the limit is {p.largest_drift:g} m"
            )
        return ""


class TensionSource(StrEnum):
    """Source of a tension."""

    LOAD_CELL = "load_cell"
    MOTOR = "motor"
    NONE = "none"


class TensionEstimate:
    """Tension at the fairlead with its validity.

    The load cell is the source while its readings are fresh and within range; otherwise the motor
    current, less precisely and only while the brake is open. In steady motion the two are compared.
    """

    def __init__(self, parameters: EstimateParameters, drum: DrumModel) -> None:
        self.parameters = parameters
        self._drum = drum
        self._cell = math.nan
        self._cell_received: float | None = None
        self._motor = math.nan  # tether tension from the motor current [N]
        self._motor_received: float | None = None
        self._mismatch_since: float | None = None
        self.mismatch = ""
        self.cell_fault = "no load cell reading received"

    def on_load_cell(self, tension: float, now: float) -> None:
        """Update with a reading of the load cell [N]."""
        limit = self.parameters.load_cell_range
        if not abs(tension) <= limit:
            self._cell = math.nan
            self.cell_fault = f"the load cell reads {tension:.4g} N, its range is {limit:g} N"
            return
        self._cell, self._cell_received, self.cell_fault = tension, now, ""

    def invalidate(self, reason: str) -> None:
        """Invalidate the tension until the next reading of the load cell."""
        self._cell = math.nan
        self._motor_received = None
        self.cell_fault = reason

    def retune(self, parameters: EstimateParameters, drum: DrumModel) -> None:
        """Apply other parameters."""
        self.parameters, self._drum = parameters, drum

    def on_motor(
        self, current: float, payout: PayoutEstimate, brake_is_open: bool, now: float
    ) -> None:
        """Update with the motor current [A], > 0 paying out; ignored behind a closed brake."""
        if not (brake_is_open and payout.is_known and math.isfinite(current)):
            self._motor_received = self._mismatch_since = None
            return
        torque = -current * self._drum.parameters.torque_constant
        carried = self._drum.tension_of(torque, payout.length)
        self._motor = self._drum.tether_tension(
            carried, payout.length, payout.rate, payout.acceleration
        )
        self._motor_received = now

    def step(self, payout: PayoutEstimate, now: float) -> None:
        """Check for a timeout, and compare the two sources in steady motion."""
        p = self.parameters
        if self._cell_received is not None and now - self._cell_received > p.load_cell_timeout:
            age = now - self._cell_received
            self._cell = math.nan
            self.cell_fault = f"no load cell reading for {age:.3g} s"
        motor = self._fresh_motor(now)
        steady = abs(payout.acceleration) < 0.1 and abs(payout.rate) > 0.02
        if math.isnan(self._cell) or math.isnan(motor) or not steady:
            self._mismatch_since = None
            return
        allowed = max(p.mismatch_floor, p.tension_mismatch * max(abs(self._cell), abs(motor)))
        if abs(self._cell - motor) <= allowed:
            self._mismatch_since, self.mismatch = None, ""
            return
        if self._mismatch_since is None:
            self._mismatch_since = now
        if now - self._mismatch_since >= p.mismatch_time:
            self.mismatch = (
                f"load cell {self._cell:.4g} N and motor {motor:.4g} N disagree by more than "
                f"{allowed:.3g} N"
            )

    def value(self, now: float) -> tuple[float, TensionSource]:
        """Tension [N] and its source; NaN where no source is valid."""
        if self.mismatch:
            return math.nan, TensionSource.NONE
        if not math.isnan(self._cell):
            return self._cell, TensionSource.LOAD_CELL
        motor = self._fresh_motor(now)
        if not math.isnan(motor):
            return motor, TensionSource.MOTOR
        return math.nan, TensionSource.NONE

    def _fresh_motor(self, now: float) -> float:
        if (
            self._motor_received is None
            or now - self._motor_received > self.parameters.load_cell_timeout
        ):
            return math.nan
        return self._motor
