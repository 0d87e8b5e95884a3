"""``mission_node``: supervises a whole mission, on request."""

from __future__ import annotations

import hashlib
import json
import os
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from msg_schemas import machine, qos, topics
from msg_schemas.commands import read_command, split_name
from msg_schemas.configuration import to_mapping
from msg_schemas.events import EventReport, MissionEvent
from msg_schemas.parameters import parameter
from msg_schemas.phases import MissionPhase
from msg_schemas.regular_files import file_problem, read_text, writing_problem
from msg_schemas.samples import (
    JointSample,
    Level,
    PoseEstimateSample,
    PoseSample,
    Sample,
    Status,
    StatusSample,
    TextSample,
)
from rover_control.mission.mission_checkpoint import checkpoint_of, restore
from rover_control.mission.mission_legs import LegRequest
from rover_control.mission.mission_parameters import MissionSettings
from rover_control.mission.mission_plan import load_plan
from rover_control.mission.mission_report import state_sample
from rover_control.mission.mission_supervisor import Mission
from rover_control.mission.observed_state import OBSERVED_TOPICS
from rover_control.mission.operator_commands import OperatorCommands
from rover_runtime.component import Component, parts_of

_ENDS = (
    MissionEvent.COMPLETED,
    MissionEvent.HOLDING,
    MissionEvent.INTERRUPTED,
    MissionEvent.BLOCKED,
    MissionEvent.ABORTED,
)
"""Events that end a command."""
_CHECKPOINT_PERIOD = 1.0  # wall time [s]
# Wait for the plant's configuration, which names the run; a busy machine discovers it late.
_RUN_TIMEOUT_NS = 30_000_000_000
_REQUESTS = (
    topics.WINCH_REQUEST,
    topics.DESCENT_REQUEST,
    topics.DRIVE_GOAL,
    topics.DRIVE_START,
    topics.JUMP_REQUEST,
)


@dataclass(frozen=True)
class MissionNodeParameters:
    """Plan, checkpoint and rates of the node."""

    plan: str = parameter(
        "marius_hills", "-", "name of a shipped plan, or path of a .yaml file", read_only=True
    )
    checkpoint: str = parameter(
        "auto", "-", "checkpoint file for a restart; auto: in ~/.ros; none: no checkpoint",
        read_only=True,
    )  # fmt: skip
    supervision_rate: float = parameter(
        10.0, "Hz", "rate of the supervisor's steps", 1.0, 50.0, read_only=True
    )
    state_rate: float = parameter(
        2.0, "Hz", "publishing rate of the mission state", 0.1, 50.0, read_only=True
    )


class MissionNode(Component):
    """ROS node of the mission supervisor."""

    NAME = "mission_node"
    PARAMETERS = (MissionNodeParameters, *parts_of(MissionSettings).values())

    def setup(self) -> None:
        """Read the plan; create publishers, subscriptions and services."""
        parameters = self.parameters_of(MissionNodeParameters)
        self._plan = load_plan(parameters.plan)
        self._file = self._checkpoint_file(parameters.checkpoint)
        self._request_publishers = {name: self.publisher(name) for name in _REQUESTS}
        self._phase_publisher = self.publisher(topics.MISSION_PHASE)
        self._state_publisher = self.publisher(topics.MISSION_STATE)
        self._sent: dict[str, tuple[str, str]] = {}  # sender and id of the last request by topic
        self._request_count = 0
        self._last_request: JointSample | None = None
        self._begin()
        for name in OBSERVED_TOPICS:
            if name not in (topics.COMMANDS, topics.EVENTS):
                self.subscribe(name, self._receiver(name))
        self.subscribe(topics.EVENTS, self._on_events, depth=200)
        self.subscribe(topics.COMMANDS, self._on_commands, depth=200)
        self.subscribe(topics.CONFIG, self._on_configuration, depth=qos.LATCHED_NODES)
        self.serve(topics.MISSION_GO, self._on_go)
        self.serve(topics.MISSION_HOLD, lambda: self._execute(self._operator.hold))
        self.serve(topics.MISSION_RESUME, self._on_resume)
        self.serve(topics.MISSION_SKIP, lambda: self._execute(self._operator.skip))
        self.serve(topics.MISSION_ABORT, lambda: self._execute(self._operator.abort))

    def configuration(self) -> Mapping[str, Any]:
        """The plan, in addition to the parameters."""
        return {"mission": to_mapping(self._plan)}

    def start(self) -> None:
        """Restore a valid checkpoint; otherwise start in standby."""
        self._begin()
        self._run_deadline_ns = self.port.steady_ns() + _RUN_TIMEOUT_NS
        rates = self.parameters_of(MissionNodeParameters)
        self.every(1.0 / rates.supervision_rate, self._step)
        self.every(1.0 / rates.state_rate, self._publish_state)
        self.every(_CHECKPOINT_PERIOD, self._save_checkpoint, by_wall_clock=True)

    @property
    def mission(self) -> Mission:
        """The supervisor; only ``mission_node`` may step it."""
        return self._mission

    def stop(self) -> None:
        """Bring the mission's motions to rest; only an operator resumes it."""
        if self._mission.is_active:
            self._operator.hold(self.now_ns())
            self._step()
        self._save_checkpoint()

    def parameters_changed(self) -> None:
        """Apply new parameters at once."""
        self._mission.settings = self.parameters_of(MissionSettings)

    def clock_jumped(self) -> None:
        """Restart the supervisor: all its times are invalid."""
        if self._mission.is_active or self._mission.phase is not MissionPhase.STANDBY:
            text = f"the clock jumped in phase {self._mission.phase}; the mission has ended"
            self.event(EventReport(MissionEvent.CHECKPOINT_DISCARDED, text))
        previous = self._published_phase
        self._begin()
        self._is_restored = True
        if previous == self._mission.phase.value:
            self._published_phase = previous

    def waiting_for(self) -> tuple[str, ...]:
        """The winch estimate, if stale; no mission begins without it."""
        now = self.now_ns() * 1e-9
        silent = self._mission.observed.is_stale(topics.WINCH_ESTIMATE, now)
        return (topics.WINCH_ESTIMATE,) if silent else ()

    def health(self) -> tuple[Status, ...]:
        """Phase, and what the mission is waiting for."""
        if not self.active:
            return ()
        mission = self._mission
        waits = f", waiting: {mission.waiting_on}" if mission.waiting_on else ""
        leg = f": {mission.leg.name}" if mission.leg is not None and mission.is_active else ""
        reason = "" if mission.is_active else f": {mission.reason}" * bool(mission.reason)
        held = mission.phase in (MissionPhase.HOLDING, MissionPhase.ABORTED)
        text = f"{mission.phase}{leg}{reason}{waits}"
        level = Level.WARN if held else Level.OK
        return (Status(f"{self.NAME}: mission", text, level, self.NAME),)

    # --- inputs ----------------------------------------------------------------------------------

    def _receiver(self, name: str) -> Any:
        def receive(sample: Sample) -> None:
            self._last_samples[name] = sample
            self._mission.observed.receive(name, sample, self.now_ns())

        return receive

    def _on_events(self, sample: StatusSample) -> None:
        others = tuple(each for each in sample.statuses if each.hardware_id != self.NAME)
        if others:
            filtered = StatusSample(sample.stamp_ns, others)
            self._mission.observed.receive(topics.EVENTS, filtered, self.now_ns())

    def _on_commands(self, sample: StatusSample) -> None:
        """Process the records of the mission's own requests."""
        ours = tuple(
            each
            for each in sample.statuses
            if (record := read_command(each)) is not None
            and self._sent.get(record.subject) == (record.sender, record.identifier)
        )
        if ours:
            filtered = StatusSample(sample.stamp_ns, ours)
            self._mission.observed.receive(topics.COMMANDS, filtered, self.now_ns())

    def _on_configuration(self, sample: TextSample) -> None:
        """Learn which run of a simulation this is: the plant's configuration names it."""
        run = json.loads(sample.text).get("run")
        if isinstance(run, str):
            self._run = run

    def _on_go(self) -> tuple[bool, str]:
        if self._knows_run():
            self._restore(resumes=False)
        text = self._operator.go(self.now_ns())
        self._is_restored = True
        self.commands.begin()
        self._step()
        return True, text

    def _on_resume(self) -> tuple[bool, str]:
        self._restore(resumes=False)
        text = self._operator.resume(self.now_ns())
        self.commands.begin()
        self._step()
        return True, text

    def _execute(self, command: Callable[[int], str]) -> tuple[bool, str]:
        """Execute a command that ends at once; a mission just restarted does not go on before."""
        self._restore(resumes=False)
        text = command(self.now_ns())
        self._step()
        return True, text

    # --- outputs and requests --------------------------------------------------------------------

    _last_samples: dict[str, Sample]
    _published_phase = ""
    _run = ""  # of the simulation, as its plant names it; empty = hardware, or not yet known

    def _begin(self) -> None:
        last_samples = getattr(self, "_last_samples", {})
        self._mission = Mission(self._plan, self.parameters_of(MissionSettings))
        self._operator = OperatorCommands(self._mission)
        self._last_samples = last_samples
        # Latched topics are not sent again.
        for name, sample in last_samples.items():
            if isinstance(sample, TextSample) or name == topics.WINCH_ALARMS:
                self._mission.observed.receive(name, sample, self.now_ns())
        self._published_phase = ""
        self._is_restored = False

    def _step(self) -> None:
        now_ns = self.now_ns()
        if not self._is_restored and self.knows_time() and self._knows_run():
            self._restore(resumes=bool(self._run))
            if self._mission.is_active and not self.commands.open:
                self.commands.take(topics.MISSION_RESUME, self.full_name)
                self.commands.begin()
        for request in self._mission.step(now_ns):
            self._send_request(request, now_ns)
        for change in self._mission.take_changes():
            self.event(change)
            if change.name in _ENDS:
                self.end_command(change)
        mission = self._mission
        if mission.leg is not None:
            left = len(mission.route.legs) - mission.route.number + 1
            self.commands.progress(mission.leg.name, left)
        phase = mission.phase.value
        if phase != self._published_phase:
            self._published_phase = phase
            self._phase_publisher.send(TextSample(phase))
            self._save_checkpoint()

    def _send_request(self, request: LegRequest, now_ns: int) -> None:
        sample = request.sample
        if sample is None:
            self.call_service(
                request.name, lambda success, text: self._answered(request.name, success, text)
            )
            return
        if isinstance(sample, PoseSample | PoseEstimateSample):
            # A pose carries no sender's name: its record is found by the stamp.
            self._sent[request.name] = "", str(now_ns)
            self._request_publishers[request.name].send(replace(sample, stamp_ns=now_ns))
            return
        assert isinstance(sample, JointSample)
        renews = machine.WINCH_WHILE_RENEWED in sample.joints and sample == self._last_request
        if not renews:
            self._request_count += 1
        self._last_request = sample
        identifier = str(self._request_count)
        self._sent[request.name] = split_name(f"{self.full_name}#{identifier}")
        self._request_publishers[request.name].send(sample, identifier)

    def _answered(self, service: str, success: bool, text: str) -> None:
        if not success:
            self.report(Status(f"{self.NAME}: {service}", text, Level.WARN, self.NAME))

    def _publish_state(self) -> None:
        self._state_publisher.send(state_sample(self._mission, self.now_ns()))

    # --- checkpoint ------------------------------------------------------------------------------

    def _checkpoint_file(self, word: str) -> Path | None:
        if word == "none":
            return None
        if word != "auto":
            return Path(word).expanduser()
        home = Path(os.environ.get("ROS_HOME") or Path.home() / ".ros")
        name = self.full_name.strip("/").replace("/", "_")
        domain = os.environ.get("ROS_DOMAIN_ID", "0")
        return home / "mother_rover" / f"{name}_{domain}.json"

    def _knows_run(self) -> bool:
        """Whether the run is known, or is that of hardware or of a plant that names none."""
        is_late = self.port.steady_ns() > self._run_deadline_ns
        return not self.port.is_simulated or bool(self._run) or is_late

    def _save_checkpoint(self) -> None:
        """Write the checkpoint atomically: a kill leaves either the old or the new one."""
        if self._file is None or not self._is_restored:
            return
        saved = {
            **checkpoint_of(self._mission, self.now_ns()), "wall": time.time(), "run": self._run,
        }  # fmt: skip
        partial = self._file.with_suffix(".partial")
        try:
            self._file.parent.mkdir(parents=True, exist_ok=True)
            content = json.dumps(saved)
            partial.write_text(f"{_digest(content)}\n{content}\n", encoding="utf-8")
            partial.replace(self._file)
        except OSError as error:
            name = f"{self.NAME}: checkpoint"
            text = f"not written: {writing_problem(error, self._file)}"
            self.report(Status(name, text, Level.WARN, self.NAME))

    def _restore(self, *, resumes: bool) -> None:
        """Restore the checkpoint file, once; a file that cannot be read is reported and ignored.

        Within one run of a simulation the mission goes on by itself, a new run begins anew, and on
        hardware only an operator resumes it.

        Args:
            resumes: whether an active mission goes on; otherwise it is held.
        """
        if self._is_restored:
            return
        self._is_restored = True
        if self._file is None or not self._file.exists():
            return
        now_ns = self.now_ns()
        try:
            digest, _, content = read_text(self._file).partition("\n")
            if digest != _digest(content.removesuffix("\n")):
                self._discard("it is damaged, its checksum is not that of its content")
                return
            saved = json.loads(content)
            if saved["run"] != self._run and self._knows_run():
                text = "the checkpoint is of another run, the mission starts anew"
                self.event(EventReport(MissionEvent.CHECKPOINT_DISCARDED, text))
                return
            # Simulated time may have stood still during the downtime, or belong to another run.
            age = max(time.time() - float(saved["wall"]), 0.0)
            within = self._mission.settings.mission.resume_window
            if age > within:
                saved["stamp_ns"] = min(int(saved["stamp_ns"]), now_ns - round(age * 1e9))
            restore(self._mission, saved, now_ns, resumes=resumes)
        except OSError as error:
            self._discard(file_problem(error))
        except (ValueError, KeyError, TypeError) as error:
            self._discard(repr(error))

    def _discard(self, reason: str) -> None:
        text = f"cannot read {self._file}, the mission starts anew: {reason}"
        self.event(EventReport(MissionEvent.CHECKPOINT_DISCARDED, text))


def _digest(content: str) -> str:
    return hashlib.sha256(content.encode()).hexdigest()


def main() -> int:
    """Run the node."""
    from rover_runtime.ros.process import run  # noqa: PLC0415 - the loop host needs no ROS

    return run(MissionNode)


if __name__ == "__main__":
    sys.exit(main())
