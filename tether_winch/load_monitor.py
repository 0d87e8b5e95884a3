"""Detection of touchdown, slack, snag and over-tension from the tension. Pure.

The load is the tension at the fairlead less the weight of the paid-out tether. Its thresholds are
relative to its running mean, so that neither the payload nor the load cell's scale must be known
well. A bounce after a hard stop removes or doubles the load for up to half the rover's bounce
period (0.5 s at 45 m and 10 kg); contact with a wall does so for a few tenths of a second. Each
condition is therefore debounced for longer, and longer still while the drum stands or has just
braked, where the delay costs no slack.

touchdown     the floor or a ledge carries most of the rover
slack         the tether carries only its own weight
snag          the load is well above the mean: rover or tether is caught while reeling in;
              suppressed after own braking, and cleared while the drum stands and carries
              its earlier standing load
over_tension  the tension is too high
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from msg_schemas.parameters import ParameterError, parameter
from msg_schemas.phases import LoadState
from tether_winch.debounce import Debounce

_STANDING_RATE = 1e-3  # payout rate below which the drum stands [m/s]


@dataclass(frozen=True)
class LoadParameters:
    """Thresholds of touchdown, slack, snag and over-tension, relative to the mean load."""

    reference_weight: float = parameter(
        16.2, "N", "weight of the rover before the load is measured: 10 kg on the Moon",
        1e-3, 5000.0,
    )  # fmt: skip
    mean_time_constant: float = parameter(5.0, "s", "time constant of the mean load", 0.5, 120.0)
    mean_range: float = parameter(
        0.5, "-", "largest relative deviation of the mean load from reference_weight", 0.0, 0.95
    )
    hysteresis: float = parameter(
        0.1, "-", "hysteresis of the thresholds, as a fraction of the mean load", 0.0, 0.4
    )
    touchdown_threshold: float = parameter(
        0.5, "-", "fraction of the mean load below which the rover is supported", 0.1, 0.9
    )
    slack_threshold: float = parameter(
        0.1, "-", "fraction of the mean load below which the tether is slack", 0.0, 0.5
    )
    snag_threshold: float = parameter(
        1.35, "-", "fraction of the mean load above which the tether or rover is snagged", 1.1, 10.0
    )
    lifted_threshold: float = parameter(
        0.85,
        "-",
        "fraction of the mean load above which a rover that stood hangs again; below, it may lean "
        "on the ground, and the mean does not follow",
        0.5,
        1.0,
    )
    lifted_length: float = parameter(
        0.5,
        "m",
        "length reeled in after which a rover that stood hangs again at any load",
        0.05,
        10.0,
    )
    debounce_time: float = parameter(
        0.6, "s", "time for which a threshold must be exceeded", 0.05, 10.0
    )
    bounce_fraction: float = parameter(
        0.9, "-", "shortest debounce time, as a fraction of the rover's bounce period", 0.0, 10.0
    )
    unsteady_debounce_time: float = parameter(
        1.5, "s", "debounce time while the drum stands, reels in or has just braked", 0.05, 30.0
    )
    release_debounce_time: float = parameter(
        0.3, "s", "time for which a condition must have ended before it is cleared", 0.0, 10.0
    )
    brake_blanking_time: float = parameter(
        2.0,
        "s",
        "time after own braking without snag detection and with the longer debounce",
        0.0,
        30.0,
    )
    over_tension_threshold: float = parameter(
        3.5, "-", "fraction of reference_weight above which the tension is too high", 1.1, 100.0
    )
    over_tension_debounce_time: float = parameter(
        0.02, "s", "time for which the tension must be too high", 0.0, 10.0
    )

    def __post_init__(self) -> None:
        """Refuse thresholds that overlap.

        Raises:
            ParameterError: two thresholds are closer than the hysteresis.
        """
        if self.slack_threshold + self.hysteresis > self.touchdown_threshold:
            msg = (
                f"slack_threshold is {self.slack_threshold:g} and touchdown_threshold "
                f"{self.touchdown_threshold:g}, they must be further apart than the hysteresis, "
                f"{self.hysteresis:g}"
            )
            raise ParameterError(msg)
        if self.touchdown_threshold + self.hysteresis >= self.snag_threshold - self.hysteresis:
            msg = (
                f"touchdown_threshold is {self.touchdown_threshold:g} and snag_threshold "
                f"{self.snag_threshold:g}, they must be further apart than twice the hysteresis, "
                f"{self.hysteresis:g}"
            )
            raise ParameterError(msg)


class LoadMonitor:
    """Monitors the load of one tether.

    Args:
        parameters: thresholds.
    """

    _FILTER = 0.03  # low-pass of the load [s]
    _INITIAL_WEIGHT = 1.0  # initial averaging time of the mean [s]

    def __init__(self, parameters: LoadParameters) -> None:
        self.parameters = parameters
        self.state = LoadState.UNKNOWN
        self.mean = parameters.reference_weight  # [N]
        self.load = math.nan  # [N]
        self._mean_weight = self._INITIAL_WEIGHT  # [s]
        self._pending_integral = 0.0  # of the load while a change is pending [N s]
        self._pending_time = 0.0  # [s]
        self._standing_time = 0.0  # time for which the drum has stood [s]
        self._standing_load = math.nan  # load when the drum last stood [N]
        self._braked_at: float | None = None
        self._paying_out_since: float | None = None
        self._reeled_in_at: float | None = None
        self._last: float | None = None
        self._touchdown, self._slack = Debounce(), Debounce()
        self._stood = Debounce()  # since then the rover has not hung freely
        self._reeled_in = 0.0  # since the rover stood [m]
        self._snag, self._over_tension = Debounce(), Debounce()

    @property
    def is_supported(self) -> bool:
        """Whether the ground carries most of the rover."""
        return self._touchdown.is_on

    @property
    def is_snagged(self) -> bool:
        """Whether rover or tether is snagged."""
        return self._snag.is_on

    @property
    def alarms(self) -> Mapping[str, bool]:
        """Whether each condition holds; several may at once."""
        return {
            LoadState.TOUCHDOWN: self._touchdown.is_on,
            LoadState.SLACK: self._slack.is_on,
            LoadState.SNAG: self._snag.is_on,
            LoadState.OVER_TENSION: self._over_tension.is_on,
        }

    def on_braking(self, now: float) -> None:
        """Note that the brake has closed on a moving drum."""
        self._braked_at = now

    def invalidate(self) -> None:
        """Invalidate the load: the tension is unknown."""
        self.load = math.nan
        self._paying_out_since = None
        self.state = LoadState.UNKNOWN

    def step(
        self,
        tension: float,
        own_weight: float,
        rate: float,
        bounce_period: float,
        now: float,
    ) -> LoadState:
        """Update with the estimates of one instant; returns the state of the load.

        Args:
            tension: at the fairlead [N]; NaN = unknown.
            own_weight: weight of the paid-out tether [N].
            rate: payout rate [m/s].
            bounce_period: of the rover on its tether [s].
            now: controller's clock [s].
        """
        p = self.parameters
        dt = 0.0 if self._last is None else max(now - self._last, 0.0)  # the clock may go back
        self._last = now
        if math.isnan(tension):
            self.invalidate()
            return self.state
        load = tension - own_weight
        if math.isnan(self.load):
            self.load = load
        else:
            self.load += (load - self.load) * -math.expm1(-dt / self._FILTER)
        if rate <= 0.01:
            self._paying_out_since = None
        elif self._paying_out_since is None:
            self._paying_out_since = now
        if rate < -0.01:
            self._reeled_in_at = now
        self._standing_time = self._standing_time + dt if abs(rate) < _STANDING_RATE else 0.0
        lasting = max(p.debounce_time, p.bounce_fraction * bounce_period)
        self._update_conditions(tension, lasting, now)
        self._reeled_in = 0.0 if self._touchdown.is_on else self._reeled_in - min(rate, 0.0) * dt
        hangs = self.load > p.lifted_threshold * self.mean or self._reeled_in > p.lifted_length
        self._stood.step(self._touchdown.is_on, hangs, now, 0.0, lasting)
        self._update_mean(dt, now)
        return self.state

    def _update_conditions(self, tension: float, lasting: float, now: float) -> None:
        p = self.parameters
        ratio, h = self.load / self.mean, p.hysteresis
        steady = (
            not self._just_braked(now)
            and self._paying_out_since is not None
            and now - self._paying_out_since > lasting
        )
        hold = lasting if steady else max(lasting, p.unsteady_debounce_time)
        self._touchdown.step(
            ratio < p.touchdown_threshold,
            ratio > p.touchdown_threshold + h,
            now,
            hold,
            p.release_debounce_time,
        )
        self._slack.step(
            ratio < p.slack_threshold,
            ratio > p.slack_threshold + h,
            now,
            hold,
            p.release_debounce_time,
        )
        free = not self._just_braked(now)
        over = tension / p.reference_weight
        self._over_tension.step(
            over > p.over_tension_threshold,
            over < p.over_tension_threshold - h,
            now,
            p.over_tension_debounce_time,
            p.release_debounce_time,
        )
        # Over-tension while reeling in is a snag without debounce: the winch brakes now.
        snags_reeling = (
            self._over_tension.is_on
            and self._reeled_in_at is not None
            and now - self._reeled_in_at < p.debounce_time
        )
        was_on = self._snag.is_on
        hangs = self._carries_standing_load
        self._snag.step(
            ratio > p.snag_threshold and free and not hangs,
            ratio < p.snag_threshold - h or not free or hangs,
            now,
            0.0 if snags_reeling else lasting,
            p.release_debounce_time,
        )
        if was_on and hangs and not self._snag.is_on:
            self.mean = self._standing_load
        if self._over_tension.is_on:
            self.state = LoadState.OVER_TENSION
        elif self._snag.is_on:
            self.state = LoadState.SNAG
        elif self._slack.is_on:
            self.state = LoadState.SLACK
        elif self._touchdown.is_on:
            self.state = LoadState.TOUCHDOWN
        else:
            self.state = LoadState.NORMAL

    @property
    def _carries_standing_load(self) -> bool:
        """Whether the drum stands and carries no more than its earlier standing load."""
        p = self.parameters
        return self._standing_time > p.brake_blanking_time and self.load < (
            p.snag_threshold - p.hysteresis
        ) * (self._standing_load)

    def _update_mean(self, dt: float, now: float) -> None:
        """Update the running mean while the rover hangs freely.

        A rover that leans on the ground is not weighed: with the mean of its part of the load, the
        whole load would count as a snag when the rover is lifted. Loads during a pending change are
        held back, and added to the mean if the change is not confirmed: without them the mean of an
        oscillating load would be biased low.
        """
        conditions = (self._touchdown, self._snag, self._over_tension)
        stands = self._stood.is_on or any(each.is_on for each in conditions)
        if stands or self._just_braked(now):
            self._pending_integral = self._pending_time = 0.0
            return
        self._pending_integral += self.load * dt
        self._pending_time += dt
        if any(each.is_pending for each in conditions):
            return
        p, time = self.parameters, self._pending_time
        load = self._pending_integral / time if time > 0.0 else self.load
        self._pending_integral = self._pending_time = 0.0
        self._mean_weight = min(self._mean_weight + time, p.mean_time_constant)
        self.mean = self._clipped(
            self.mean + (load - self.mean) * min(time / self._mean_weight, 1.0)
        )
        if self._standing_time > p.brake_blanking_time:
            before = self.mean if math.isnan(self._standing_load) else self._standing_load
            self._standing_load = self._clipped(
                before + (load - before) * min(time / p.mean_time_constant, 1.0)
            )

    def _clipped(self, load: float) -> float:
        """Load [N], clipped to the range that the rover can weigh."""
        p = self.parameters
        low, high = 1.0 - p.mean_range, 1.0 + p.mean_range
        return min(max(load, low * p.reference_weight), high * p.reference_weight)

    def _just_braked(self, now: float) -> bool:
        return (
            self._braked_at is not None
            and now - self._braked_at < self.parameters.brake_blanking_time
        )
