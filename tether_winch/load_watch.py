"""What the tension says about the rover: touchdown, slack, snag, over-tension. Pure.

The load is the tension at the fairlead less the weight of the tether that is out. It is compared
with its own running mean, so that neither payload nor load cell need be known well. A bounce after
a hard stop takes the load away, or doubles it, for up to half the period of the rover on its
tether (0.5 s at 45 m and 10 kg); a wall that the rover scrapes does so for a few tenths. So a
change is believed only after it has lasted longer, and later still when the drum has just braked
or stands still, where waiting costs no slack.

touchdown     something carries most of the rover: the floor, or a ledge on which it sits
slack         the tether carries nothing but itself
snag          the load is well above the mean: something holds the rover or tether while it is
              reeled in; not looked for after own braking, and ended where the drum stands and
              carries what it did when it stood before
over_tension  the tension is too high, whatever the reason
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from msg_schemas.parameters import ParameterError, parameter
from tether_winch.debounce import Debounce

_STANDING_RATE = 1e-3  # of payout, below which the drum stands [m/s]


class LoadState(StrEnum):
    """What the tension says; the gravest that holds."""

    UNKNOWN = "unknown"
    NORMAL = "normal"
    TOUCHDOWN = "touchdown"
    SLACK = "slack"
    SNAG = "snag"
    OVER_TENSION = "over_tension"


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
        """Refuse thresholds that leave nothing between them."""
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


class LoadWatch:
    """Follows the load of one tether.

    Args:
        parameters: thresholds.
    """

    _FILTER = 0.03  # low-pass of the load [s]
    _LEARNT_AT_ONCE = 1.0  # weight of reference_weight in the mean's beginning [s]

    def __init__(self, parameters: LoadParameters) -> None:
        self.parameters = parameters
        self.state = LoadState.UNKNOWN
        self.mean = parameters.reference_weight  # [N]
        self.load = math.nan  # [N]
        self._learnt = self._LEARNT_AT_ONCE  # [s]
        self._set_aside = 0.0  # integral of the load while a change is pending [N s]
        self._pended = 0.0  # for so long [s]
        self._stood = 0.0  # for so long the drum has stood [s]
        self._hung = math.nan  # load that hung on the drum when it stood last [N]
        self._braked: float | None = None
        self._paying_since: float | None = None
        self._reeled: float | None = None
        self._last: float | None = None
        self._touchdown, self._slack = Debounce(), Debounce()
        self._snag, self._over_tension = Debounce(), Debounce()

    @property
    def is_supported(self) -> bool:
        """Whether something else than the tether carries most of the rover."""
        return self._touchdown.is_on

    @property
    def is_snagged(self) -> bool:
        """Whether something holds on to rover or tether."""
        return self._snag.is_on

    @property
    def alarms(self) -> Mapping[str, bool]:
        """Each condition, whether it holds; several may."""
        return {
            LoadState.TOUCHDOWN: self._touchdown.is_on,
            LoadState.SLACK: self._slack.is_on,
            LoadState.SNAG: self._snag.is_on,
            LoadState.OVER_TENSION: self._over_tension.is_on,
        }

    def note_braking(self, now: float) -> None:
        """The brake has closed on a moving drum."""
        self._braked = now

    def lose(self) -> None:
        """The tension is not known now."""
        self.load = math.nan
        self._paying_since = None
        self.state = LoadState.UNKNOWN

    def step(
        self,
        tension: float,
        own_weight: float,
        rate: float,
        bounce_period: float,
        now: float,
    ) -> LoadState:
        """Take the estimates of one instant.

        Args:
            tension: at the fairlead [N]; NaN = not known.
            own_weight: of the tether that is out [N].
            rate: of payout [m/s].
            bounce_period: of the rover on its tether [s].
            now: controller's clock [s].
        """
        p = self.parameters
        dt = 0.0 if self._last is None else now - self._last
        self._last = now
        if math.isnan(tension):
            self.lose()
            return self.state
        load = tension - own_weight
        if math.isnan(self.load):
            self.load = load
        else:
            self.load += (load - self.load) * -math.expm1(-dt / self._FILTER)
        if rate <= 0.01:
            self._paying_since = None
        elif self._paying_since is None:
            self._paying_since = now
        if rate < -0.01:
            self._reeled = now
        self._stood = self._stood + dt if abs(rate) < _STANDING_RATE else 0.0
        self._judge(tension, max(p.debounce_time, p.bounce_fraction * bounce_period), now)
        self._learn(dt, now)
        return self.state

    def _judge(self, tension: float, lasting: float, now: float) -> None:
        p = self.parameters
        ratio, h = self.load / self.mean, p.hysteresis
        steady = (
            not self._just_braked(now)
            and self._paying_since is not None
            and now - self._paying_since > lasting
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
        # Too much tension while reeling in is a snag at once: the winch will now brake.
        caught = (
            self._over_tension.is_on
            and self._reeled is not None
            and now - self._reeled < p.debounce_time
        )
        was_on = self._snag.is_on
        hangs = self._hangs_as_before
        self._snag.step(
            ratio > p.snag_threshold and free and not hangs,
            ratio < p.snag_threshold - h or not free or hangs,
            now,
            0.0 if caught else lasting,
            p.release_debounce_time,
        )
        if was_on and hangs and not self._snag.is_on:
            self.mean = self._hung
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
    def _hangs_as_before(self) -> bool:
        """Whether the drum stands, and carries no more than when it stood last."""
        p = self.parameters
        return self._stood > p.brake_blanking_time and self.load < (
            p.snag_threshold - p.hysteresis
        ) * (self._hung)

    def _learn(self, dt: float, now: float) -> None:
        """Move the running mean, while the rover hangs and nothing else is going on.

        What passed a threshold and was not believed was part of the motion as much as what did
        not: it is learnt belatedly, as the mean of a load that goes up and down would otherwise
        be that of its lower half.
        """
        watched = (self._touchdown, self._snag, self._over_tension)
        if any(held.is_on for held in watched) or self._just_braked(now):
            self._set_aside = self._pended = 0.0
            return
        self._set_aside += self.load * dt
        self._pended += dt
        if any(held.is_pending for held in watched):
            return
        p, time = self.parameters, self._pended
        load = self._set_aside / time if time > 0.0 else self.load
        self._set_aside = self._pended = 0.0
        self._learnt = min(self._learnt + time, p.mean_time_constant)
        self.mean = self._believed(self.mean + (load - self.mean) * min(time / self._learnt, 1.0))
        if self._stood > p.brake_blanking_time:
            before = self.mean if math.isnan(self._hung) else self._hung
            self._hung = self._believed(
                before + (load - before) * min(time / p.mean_time_constant, 1.0)
            )

    def _believed(self, load: float) -> float:
        """A load, as far as the rover can weigh as much [N]."""
        p = self.parameters
        low, high = 1.0 - p.mean_range, 1.0 + p.mean_range
        return min(max(load, low * p.reference_weight), high * p.reference_weight)

    def _just_braked(self, now: float) -> bool:
        return self._braked is not None and now - self._braked < self.parameters.brake_blanking_time
