"""The ``winch_node`` executable: the mother machine's winch on topics and services."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass

from msg_schemas import machine, topics
from msg_schemas.events import WinchEvent
from msg_schemas.faults import Reason, WinchFault
from msg_schemas.parameters import parameter
from msg_schemas.phases import WinchMode
from msg_schemas.refusal import Refusal
from msg_schemas.samples import JointSample, JointValue, Level, Status, TextSample, WrenchSample
from rover_runtime.component import Component, parts_of
from tether_winch.estimates import TensionSource
from tether_winch.fault_monitor import FaultParameters
from tether_winch.servo import GoalKind, ServoCommand
from tether_winch.winch import WinchController
from tether_winch.winch_parameters import WinchParameters

_CHECK_PERIOD = 0.1  # wall clock [s]
_LOAD_CELL_TIMEOUT = 0.5  # wall clock [s]
_ENDS = frozenset(
    {
        WinchEvent.HOLD,
        WinchEvent.MOTION_ABORTED,
        WinchEvent.SLACK_REACHED,
        WinchEvent.STOP,
        WinchEvent.FAULT,
    }
)
"""Events that end a command."""
_RENEWED = frozenset({machine.WINCH_WHILE_RENEWED, machine.WINCH_AT_RATE, machine.WINCH_AT_TENSION})
"""Requests that last while they are renewed."""
_SENSORS = frozenset({topics.WINCH_STATE, topics.LOAD_CELL, topics.MOTOR_CURRENTS})


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


class WinchNode(Component):
    """Moves the tether on request, and stays safe without any other node."""

    NAME = "winch_node"
    PARAMETERS = (WinchNodeParameters, *parts_of(WinchParameters).values())

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
        """Start disarmed, with the brake closed."""
        self._begin()
        rates = self.parameters_of(WinchNodeParameters)
        self.every(1.0 / rates.command_rate, self._step)
        self.every(1.0 / rates.estimate_rate, self._publish_estimates)
        # Simulated time may stop together with the sensors.
        self.every(_CHECK_PERIOD, self._check_load_cell, by_wall_clock=True)

    def stop(self) -> None:
        """Close the brake and switch the motor off."""
        self._winch.stop("the node stops", self.now_ns(), Reason.SHUTDOWN)
        self._step()

    def parameters_changed(self) -> None:
        """Apply new parameters at once."""
        self._winch.retune(self.parameters_of(WinchParameters))

    def clock_jumped(self) -> None:
        """Latch a fault: all times are invalid."""
        self._winch.clock_jumped(self.now_ns())
        self._step()

    def refuse(self, refusal: Refusal) -> bool:
        """Report a refusal; an invalid sensor message latches a fault."""
        is_reported = super().refuse(refusal)
        if self.active and refusal.subject in _SENSORS:
            reason = f"{refusal.subject}: {refusal.reason}"
            self._winch.latch(WinchFault.BAD_READING, reason, self.now_ns())
            self._step()
        return is_reported

    def waiting_for(self) -> tuple[str, ...]:
        """Sensors that have timed out."""
        return self._winch.sensing.silent_topics(self.now_ns())

    def health(self) -> tuple[Status, ...]:
        """Status of the mode with its fault, and of the tension with its source."""
        if not self.active:
            return ()
        winch = self._winch
        level, text = Level.OK, winch.mode.value
        if winch.mode is WinchMode.FAULT:
            level, text = Level.ERROR, f"{winch.fault}: {winch.fault_reason}"
        value, source = winch.sensing.tension_now(self.now_ns())
        known = source is not TensionSource.NONE
        values = {"tension": repr(value) if known else "", "source": source.value}
        values["load_mean"] = repr(winch.sensing.load.mean)
        tension_level = Level.OK if source is TensionSource.LOAD_CELL else Level.WARN
        heat = {"motor_heat": repr(winch.sensing.heat.heat)}
        return (
            Status(f"{self.NAME}: mode", text, level, self.NAME, heat),
            Status(
                f"{self.NAME}: tension", self._winch.sensing.load.state.value, tension_level,
                self.NAME, values,
            ),
        )  # fmt: skip

    @property
    def winch(self) -> WinchController:
        """The controller, for checks to read."""
        return self._winch

    # --- inputs ----------------------------------------------------------------------------------

    def _on_drum(self, sample: JointSample) -> None:
        self._winch.sensing.on_drum(sample, self.now_ns())

    def _on_load_cell(self, sample: WrenchSample) -> None:
        self._load_cell_received_ns = self.port.steady_ns()
        self._winch.sensing.on_load_cell(sample, self.now_ns())

    def _on_currents(self, sample: JointSample) -> None:
        self._winch.sensing.on_currents(sample, self.now_ns())

    def _on_jump(self, sample: TextSample) -> None:
        self._winch.on_jump(sample.text, self.now_ns())

    def _on_trim(self, sample: JointSample) -> None:
        self._winch.trim(sample.joints[machine.WINCH_DRUM].velocity, self.now_ns())

    def _on_request(self, sample: JointSample) -> None:
        renews = self._winch.request(sample, self.now_ns())
        needs_renewal = not _RENEWED.isdisjoint(sample.joints)
        timeout = self.parameters_of(FaultParameters).command_timeout
        self.commands.begin(expiry=timeout if needs_renewal else math.inf, renews=renews)
        self._publish_changes()

    def _on_hold(self) -> tuple[bool, str]:
        done = self._winch.hold(self.now_ns())
        self._publish_changes()
        return True, done

    def _on_relax(self) -> tuple[bool, str]:
        done = self._winch.relax(self.now_ns())
        self.commands.begin()
        self._publish_changes()
        return True, done

    def _on_stop(self) -> tuple[bool, str]:
        self._winch.stop("stop requested", self.now_ns())
        self._step()
        return True, f"brake closed, in {self._winch.mode}"

    def _on_rearm(self) -> tuple[bool, str]:
        done = self._winch.rearm(self.now_ns())
        self._publish_changes()
        return True, done

    # --- outputs ---------------------------------------------------------------------------------

    def _begin(self) -> None:
        self._winch = WinchController(self.parameters_of(WinchParameters))
        self._load_cell_received_ns = self.port.steady_ns()
        self._published_mode: WinchMode | None = None
        self._published_state = ""
        self._published_alarms: dict[str, bool] | None = None
        self._publish_changes()

    def _step(self) -> None:
        now_ns = self.now_ns()
        command = self._winch.step(now_ns)
        if command is not None:
            self._command_publisher.send(_command_sample(command, now_ns))
        self._publish_changes()
        self.commands.progress(self._winch.mode.value, self._distance())

    def _distance(self) -> float:
        """Length left to the goal of the motion [m]; NaN where it has none."""
        goal, length = self._winch.motion.goal, self._winch.sensing.payout.length
        return abs(goal.length - length) if goal.kind is GoalKind.LENGTH else math.nan

    def _check_load_cell(self) -> None:
        age = (self.port.steady_ns() - self._load_cell_received_ns) * 1e-9
        if age > _LOAD_CELL_TIMEOUT:
            self._winch.sensing.on_timeout(f"no load cell reading for {age:.2g} s")
            self._publish_changes()

    def _publish_changes(self) -> None:
        winch = self._winch
        if winch.mode is not self._published_mode:
            self._published_mode = winch.mode
            self._mode_publisher.send(TextSample(winch.mode.value))
        state = winch.sensing.load.state.tension_state
        if state != self._published_state:
            self._published_state = state
            self._watch_publisher.send(TextSample(state))
        alarms = dict(winch.sensing.load.alarms)
        if alarms != self._published_alarms:
            self._published_alarms = alarms
            tension, _ = winch.sensing.tension_now(self.now_ns())
            effort = 0.0 if math.isnan(tension) else max(tension, 0.0)
            values = {n: JointValue(float(alarms[n]), 0.0, effort) for n in machine.ALARM_NAMES}
            self._alarm_publisher.send(JointSample(self.now_ns(), values))
        for change in winch.take_transitions():
            self.event(change, diagnoses=True)
            if change.name in _ENDS:
                self.end_command(change)

    def _publish_estimates(self) -> None:
        sample = self._winch.sensing.estimate(self._winch.servo, self.now_ns())
        if sample is not None:
            self._estimate_publisher.send(sample)


def _command_sample(command: ServoCommand, now_ns: int) -> JointSample:
    return JointSample(
        now_ns,
        {
            machine.WINCH_DRUM: JointValue(command.length, command.rate, command.feed_forward),
            machine.WINCH_BRAKE: JointValue(float(command.release_brake), 0.0, 0.0),
            machine.WINCH_LIMIT: JointValue(0.0, 0.0, command.limit),
        },
    )


def main() -> int:
    """Run the node."""
    from rover_runtime.ros.process import run  # noqa: PLC0415 - the loop host needs no ROS

    return run(WinchNode)


if __name__ == "__main__":
    sys.exit(main())
