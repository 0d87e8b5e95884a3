"""The ``winch_node`` executable: the mother machine's winch on topics and services."""

from __future__ import annotations

import math
import sys
import time
from dataclasses import dataclass

from msg_schemas import topics
from msg_schemas.machine import (
    ALARM_NAMES,
    WINCH_BRAKE,
    WINCH_DRUM,
    WINCH_LIMIT,
)
from msg_schemas.node import ContractNode
from msg_schemas.node_process import run
from msg_schemas.parameters import parameter
from msg_schemas.refusal import Refusal
from msg_schemas.samples import (
    JointSample,
    JointValue,
    Level,
    Status,
    TextSample,
    WrenchSample,
)
from tether_winch.drum_model import DrumParameters
from tether_winch.estimates import EstimateParameters, TensionSource
from tether_winch.guard import Fault, GuardParameters
from tether_winch.load_watch import LoadParameters, LoadState
from tether_winch.requests import Mode, RequestParameters
from tether_winch.servo import DriveCommand, ServoParameters
from tether_winch.winch import Winch, WinchParameters

_LISTENING_PERIOD = 0.1  # by the wall clock [s]
_SILENCE = 0.5  # by the wall clock [s]
_SENSORS = frozenset({topics.WINCH_STATE, topics.LOAD_CELL, topics.MOTOR_CURRENTS})
# What the tension watch says of a state of the load.
_WORDS = {
    LoadState.UNKNOWN: "unknown",
    LoadState.SLACK: "slack",
    LoadState.OVER_TENSION: "over_tension",
}


@dataclass(frozen=True)
class WinchNodeParameters:
    """Rates of the node."""

    command_rate: float = parameter(
        100.0, "Hz", "rate of control steps and drive commands", 20.0, 500.0,
        read_only=True,
    )  # fmt: skip
    estimate_rate: float = parameter(
        50.0, "Hz", "publishing rate of the estimates", 1.0, 200.0, read_only=True
    )


class WinchNode(ContractNode):
    """Moves the tether on request and keeps the rover safe, whatever else is alive."""

    NAME = "winch_node"
    PARAMETERS = (
        WinchNodeParameters,
        ServoParameters,
        RequestParameters,
        GuardParameters,
        LoadParameters,
        EstimateParameters,
        DrumParameters,
    )

    def setup(self) -> None:
        """Open topics and services."""
        self._command_publisher = self.publisher(topics.WINCH_COMMAND)
        self._estimate_publisher = self.publisher(topics.WINCH_ESTIMATE)
        self._mode_publisher = self.publisher(topics.WINCH_MODE)
        self._alarm_publisher = self.publisher(topics.WINCH_ALARMS)
        self._watch_publisher = self.publisher(topics.TENSION_WATCH)
        self._begin()
        self.subscribe(topics.WINCH_STATE, self._on_drum)
        self.subscribe(topics.LOAD_CELL, self._on_load_cell)
        self.subscribe(topics.MOTOR_CURRENTS, self._on_currents)
        self.subscribe(topics.JUMP_PHASE, self._on_jump)
        self.subscribe(topics.WINCH_TRIM, self._on_trim)
        self.serve(topics.WINCH_HOLD, self._on_hold)
        self.serve(topics.WINCH_RELAX, self._on_relax)
        self.serve(topics.WINCH_STOP, self._on_stop)
        self.serve(topics.WINCH_REARM, self._on_rearm)
        self.subscribe(topics.WINCH_REQUEST, self._on_request)

    def start(self) -> None:
        """Stand disarmed, with the brake closed."""
        self._begin()
        rates = self.parameters_of(WinchNodeParameters)
        self.every(1.0 / rates.command_rate, self._step)
        self.every(1.0 / rates.estimate_rate, self._publish_estimates)
        # Where simulated time stands still, the sensors are silent too.
        self.every(_LISTENING_PERIOD, self._listen, by_wall_clock=True)

    def stop(self) -> None:
        """Brake, motor off."""
        self._winch.stop("the node stops", self.now_ns())
        self._step()

    def parameters_changed(self) -> None:
        """Go by the new limits and thresholds at once."""
        if self.active:
            self._winch.retune(self._winch_parameters())

    def clock_jumped(self) -> None:
        """Brake: nothing that was timed means anything any more."""
        if self.active:
            self._winch.clock_jumped(self.now_ns())
            self._step()

    def refuse(self, refusal: Refusal) -> None:
        """Put a refusal on diagnostics; a sensor that talks nonsense ends every motion."""
        super().refuse(refusal)
        if self.active and refusal.subject in _SENSORS:
            reason = f"{refusal.subject}: {refusal.reason}"
            self._winch.latch(Fault.BAD_READING, reason, self.now_ns())
            self._step()

    def waiting_for(self) -> tuple[str, ...]:
        """The sensors that are silent."""
        return self._winch.waiting_for(self.now_ns())

    def health(self) -> tuple[Status, ...]:
        """Mode with its fault, and tension with its source."""
        if not self.active:
            return ()
        winch = self._winch
        level, text = Level.OK, winch.mode.value
        if winch.mode is Mode.FAULT:
            level, text = Level.ERROR, f"{winch.fault}: {winch.fault_reason}"
        value, source = winch.tension_now(self.now_ns())
        known = source is not TensionSource.NONE
        values = {"tension": repr(value) if known else "", "source": source.value}
        values["load_mean"] = repr(winch.load.mean)
        tension_level = Level.OK if source is TensionSource.LOAD_CELL else Level.WARN
        heat = {"motor_heat": repr(winch.heat.heat)}
        return (
            Status(f"{self.NAME}: mode", text, level, self.NAME, heat),
            Status(
                f"{self.NAME}: tension", self._winch.load.state.value, tension_level,
                self.NAME, values,
            ),
        )  # fmt: skip

    # --- what is heard ---------------------------------------------------------------------------

    def _on_drum(self, sample: JointSample) -> None:
        self._winch.on_drum(sample, self.now_ns())

    def _on_load_cell(self, sample: WrenchSample) -> None:
        self._heard = time.monotonic()
        self._winch.on_load_cell(sample, self.now_ns())

    def _on_currents(self, sample: JointSample) -> None:
        self._winch.on_currents(sample, self.now_ns())

    def _on_jump(self, sample: TextSample) -> None:
        self._winch.on_jump(sample.text, self.now_ns())

    def _on_trim(self, sample: JointSample) -> None:
        self._winch.trim(sample.joints[WINCH_DRUM].velocity, self.now_ns())

    def _on_request(self, sample: JointSample) -> None:
        self._winch.request(sample, self.now_ns())
        self._publish_changes()

    def _on_hold(self) -> tuple[bool, str]:
        done = self._winch.hold(self.now_ns())
        self._publish_changes()
        return True, done

    def _on_relax(self) -> tuple[bool, str]:
        done = self._winch.relax(self.now_ns())
        self._publish_changes()
        return True, done

    def _on_stop(self) -> tuple[bool, str]:
        self._winch.stop("asked to stop", self.now_ns())
        self._step()
        return True, f"braked, in {self._winch.mode}"

    def _on_rearm(self) -> tuple[bool, str]:
        done = self._winch.rearm(self.now_ns())
        self._publish_changes()
        return True, done

    # --- what is told ----------------------------------------------------------------------------

    def _begin(self) -> None:
        self._winch = Winch(self._winch_parameters())
        self._heard = time.monotonic()
        self._told_mode: Mode | None = None
        self._told_word = ""
        self._told_alarms: dict[str, bool] | None = None
        self._publish_changes()

    def _winch_parameters(self) -> WinchParameters:
        return WinchParameters(
            self.parameters_of(DrumParameters),
            self.parameters_of(EstimateParameters),
            self.parameters_of(LoadParameters),
            self.parameters_of(ServoParameters),
            self.parameters_of(GuardParameters),
            self.parameters_of(RequestParameters),
        )

    def _step(self) -> None:
        now_ns = self.now_ns()
        command = self._winch.step(now_ns)
        if command is not None:
            self._command_publisher.send(_told(command, now_ns))
        self._publish_changes()

    def _listen(self) -> None:
        silent = time.monotonic() - self._heard
        if silent > _SILENCE:
            self._winch.note_silence(f"the load cell is silent for {silent:.2g} s")
            self._publish_changes()

    def _publish_changes(self) -> None:
        winch = self._winch
        if winch.mode is not self._told_mode:
            self._told_mode = winch.mode
            self._mode_publisher.send(TextSample(winch.mode.value))
        word = _WORDS.get(winch.load.state, "normal")
        if word != self._told_word:
            self._told_word = word
            self._watch_publisher.send(TextSample(word))
        alarms = dict(winch.alarms)
        if alarms != self._told_alarms:
            self._told_alarms = alarms
            tension, _ = winch.tension_now(self.now_ns())
            effort = 0.0 if math.isnan(tension) else max(tension, 0.0)
            values = {n: JointValue(float(alarms[n]), 0.0, effort) for n in ALARM_NAMES}
            self._alarm_publisher.send(JointSample(self.now_ns(), values))
        for change in winch.take_transitions():
            self.event(change.name, change.reason, change.level, change.values)
            if change.level is not Level.OK:
                name = f"{self.NAME}: {change.name}"
                self.report(Status(name, change.reason, change.level, self.NAME))

    def _publish_estimates(self) -> None:
        made = self._winch.estimate(self.now_ns())
        if made is not None:
            self._estimate_publisher.send(made)


def _told(command: DriveCommand, now_ns: int) -> JointSample:
    return JointSample(
        now_ns,
        {
            WINCH_DRUM: JointValue(command.length, command.rate, command.feed_forward),
            WINCH_BRAKE: JointValue(float(command.release_brake), 0.0, 0.0),
            WINCH_LIMIT: JointValue(0.0, 0.0, command.limit),
        },
    )


def main() -> int:
    """Run the node."""
    return run(WinchNode)


if __name__ == "__main__":
    sys.exit(main())
