"""The ``mission_node`` executable: takes the rover through a whole mission, on request."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from msg_schemas import topics
from msg_schemas.configuration import to_mapping
from msg_schemas.machine import WINCH_WHILE_RENEWED
from msg_schemas.node import ContractNode
from msg_schemas.node_process import run
from msg_schemas.parameters import parameter
from msg_schemas.samples import (
    JointSample,
    Level,
    PoseSample,
    Sample,
    Status,
    StatusSample,
    TextSample,
)
from rover_control.mission import Mission, MissionSettings
from rover_control.mission_legs import MissionPhase, Request
from rover_control.mission_plan import load_plan
from rover_control.mission_report import state_sample
from rover_control.observed_state import OBSERVED_TOPICS

# The controller's parameters are parts of its own, by their name there.
_PARTS: Mapping[str, type[Any]] = {
    part.name: type(getattr(MissionSettings(), part.name)) for part in fields(MissionSettings)
}
_CHECKPOINT_PERIOD = 1.0  # by the wall clock [s]
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


class MissionNode(ContractNode):
    """Takes the rover through a mission by asking the other nodes."""

    NAME = "mission_node"
    PARAMETERS = (MissionNodeParameters, *_PARTS.values())

    def setup(self) -> None:
        """Read the plan; open topics and services."""
        own = self.parameters_of(MissionNodeParameters)
        self._plan = load_plan(own.plan)
        self._file = self._checkpoint_file(own.checkpoint)
        self._request_publishers = {name: self.publisher(name) for name in _REQUESTS}
        self._phase_publisher = self.publisher(topics.MISSION_PHASE)
        self._state_publisher = self.publisher(topics.MISSION_STATE)
        self._requesters: dict[str, str] = {}  # by what name each topic's last request is answered
        self._request_count = 0
        self._begin()
        for name in OBSERVED_TOPICS:
            if name not in (topics.DIAGNOSTICS, topics.EVENTS):
                self.subscribe(name, self._receiver(name))
        self.subscribe(topics.EVENTS, self._on_events, depth=200)
        self.subscribe(topics.DIAGNOSTICS, self._on_diagnostics, depth=200)
        self.serve(topics.MISSION_GO, lambda: self._respond(self._mission.go(self.now_ns())))
        self.serve(topics.MISSION_HOLD, lambda: self._respond(self._mission.hold(self.now_ns())))
        self.serve(
            topics.MISSION_RESUME, lambda: self._respond(self._mission.resume(self.now_ns()))
        )
        self.serve(topics.MISSION_SKIP, lambda: self._respond(self._mission.skip(self.now_ns())))
        self.serve(topics.MISSION_ABORT, lambda: self._respond(self._mission.abort(self.now_ns())))

    def configuration(self) -> Mapping[str, Any]:
        """The plan, beside the parameters."""
        return {"mission": to_mapping(self._plan)}

    def start(self) -> None:
        """Go on from where it was kept, where that is of this run; else stand by."""
        self._begin()
        rates = self.parameters_of(MissionNodeParameters)
        self.every(1.0 / rates.supervision_rate, self._step)
        self.every(1.0 / rates.state_rate, self._publish_state)
        self.every(_CHECKPOINT_PERIOD, self._save_checkpoint, by_wall_clock=True)

    def stop(self) -> None:
        """Bring to rest what the mission has set going; it is resumed by people alone."""
        if self._mission.is_active:
            self._mission.hold(self.now_ns())
            self._step()
        self._save_checkpoint()

    def parameters_changed(self) -> None:
        """Take new patience at once."""
        if self.active:
            self._mission.settings = self._settings()

    def clock_jumped(self) -> None:
        """Start over: what was timed means nothing any more."""
        if not self.active:
            return
        if self._mission.is_active or self._mission.phase is not MissionPhase.STANDBY:
            text = f"the clock has jumped in {self._mission.phase}: the mission is over"
            self.event("mission_forgotten", text, Level.WARN)
        previous = self._published_phase
        self._begin()
        self._is_restored = True
        if previous == self._mission.phase.value:
            self._published_phase = previous

    def waiting_for(self) -> tuple[str, ...]:
        """The winch, without which no mission begins."""
        now = self.now_ns() * 1e-9
        silent = self._mission.observed.is_stale(topics.WINCH_ESTIMATE, now)
        return (topics.WINCH_ESTIMATE,) if silent else ()

    def health(self) -> tuple[Status, ...]:
        """The phase, and what keeps it from going on."""
        if not self.active:
            return ()
        mission = self._mission
        waits = f", waiting: {mission.waiting_on}" if mission.waiting_on else ""
        leg = f": {mission.leg.name}" if mission.leg is not None and mission.is_active else ""
        still = "" if mission.is_active else f": {mission.reason}" * bool(mission.reason)
        held = mission.phase.value in ("holding", "aborted")
        text = f"{mission.phase}{leg}{still}{waits}"
        level = Level.WARN if held else Level.OK
        return (Status(f"{self.NAME}: mission", text, level, self.NAME),)

    # --- inputs ----------------------------------------------------------------------------------

    def _receiver(self, name: str) -> Any:
        def receive(sample: Sample) -> None:
            self._last_samples[name] = sample
            self._mission.receive(name, sample, self.now_ns())

        return receive

    def _on_events(self, sample: StatusSample) -> None:
        others = tuple(each for each in sample.statuses if each.hardware_id != self.NAME)
        if others:
            previous = StatusSample(sample.stamp_ns, others)
            self._mission.receive(topics.EVENTS, previous, self.now_ns())

    def _on_diagnostics(self, sample: StatusSample) -> None:
        """Refusals of what the mission has asked for; others' are theirs."""
        ours = tuple(
            each
            for each in sample.statuses
            if each.values.get("commander") in self._requesters.values()
        )
        if ours:
            previous = StatusSample(sample.stamp_ns, ours)
            self._mission.receive(topics.DIAGNOSTICS, previous, self.now_ns())

    # --- outputs and requests --------------------------------------------------------------------

    _last_samples: dict[str, Sample]
    _published_phase = ""

    def _settings(self) -> MissionSettings:
        return MissionSettings(**{name: self.parameters_of(part) for name, part in _PARTS.items()})

    def _begin(self) -> None:
        last_samples = getattr(self, "_last_samples", {})
        self._mission = Mission(self._plan, self._settings())
        self._last_samples = last_samples
        # What is latched is not said again.
        for name, sample in last_samples.items():
            if isinstance(sample, TextSample) or name == topics.WINCH_ALARMS:
                self._mission.receive(name, sample, self.now_ns())
        self._published_phase = ""
        self._is_restored = False

    def _step(self) -> None:
        now_ns = self.now_ns()
        if not self._is_restored and self.knows_time():
            self._is_restored = True
            self._restore(now_ns)
        for request in self._mission.step(now_ns):
            self._send_request(request, now_ns)
        for change in self._mission.take_changes():
            self.event(change.name, change.reason, change.level, change.values)
        phase = self._mission.phase.value
        if phase != self._published_phase:
            self._published_phase = phase
            self._phase_publisher.send(TextSample(phase))
            self._save_checkpoint()

    def _send_request(self, request: Request, now_ns: int) -> None:
        sample = request.sample
        if sample is None:
            self.call_service(
                request.name, lambda success, text: self._answered(request.name, success, text)
            )
            return
        if isinstance(sample, PoseSample):
            # In a frame there is no room for a name: it is answered by its stamp.
            self._requesters[request.name] = f"{now_ns} ns"
            pose = PoseSample(now_ns, sample.position, sample.orientation)
            self._request_publishers[request.name].send(pose)
            return
        assert isinstance(sample, JointSample)
        requester = ""
        if WINCH_WHILE_RENEWED not in sample.joints:
            self._request_count += 1
            requester = self._requesters[request.name] = (
                f"{self.get_fully_qualified_name()}#{self._request_count}"
            )
        self._request_publishers[request.name].send(sample, requester)

    def _answered(self, service: str, success: bool, text: str) -> None:
        if not success:
            self.report(Status(f"{self.NAME}: {service}", text, Level.WARN, self.NAME))

    def _respond(self, answer: str) -> tuple[bool, str]:
        self._step()
        return True, answer

    def _publish_state(self) -> None:
        self._state_publisher.send(state_sample(self._mission, self.now_ns()))

    # --- over a restart --------------------------------------------------------------------------

    def _checkpoint_file(self, word: str) -> Path | None:
        if word == "none":
            return None
        if word != "auto":
            return Path(word)
        home = Path(os.environ.get("ROS_HOME") or Path.home() / ".ros")
        name = self.get_fully_qualified_name().strip("/").replace("/", "_")
        return home / "mother_rover" / f"{name}.json"

    def _save_checkpoint(self) -> None:
        """Write how far the mission is, so that a kill at any moment leaves the last or this."""
        if self._file is None or not self._is_restored:
            return
        saved = {**self._mission.checkpoint(self.now_ns()), "wall": time.time()}
        partial = self._file.with_suffix(".partial")
        try:
            self._file.parent.mkdir(parents=True, exist_ok=True)
            partial.write_text(json.dumps(saved), encoding="utf-8")
            partial.replace(self._file)
        except OSError as error:
            name = f"{self.NAME}: checkpoint"
            self.report(Status(name, f"not kept: {error}", Level.WARN, self.NAME))

    def _restore(self, now_ns: int) -> None:
        """Go on from what was kept; what cannot be read is previous and left."""
        if self._file is None or not self._file.exists():
            return
        try:
            saved = json.loads(self._file.read_text(encoding="utf-8"))
            # Simulated time may have stood still meanwhile, or be another run's.
            age = max(time.time() - float(saved["wall"]), 0.0)
            within = self._mission.settings.mission.resume_window
            if age > within:
                saved["stamp_ns"] = min(int(saved["stamp_ns"]), now_ns - round(age * 1e9))
            self._mission.restore(saved, now_ns)
        except (OSError, ValueError, KeyError, TypeError) as error:
            text = f"{self._file} cannot be read, the mission begins anew: {error!r}"
            self.event("mission_forgotten", text, Level.WARN)


def main() -> int:
    """Run the node."""
    return run(MissionNode)


if __name__ == "__main__":
    sys.exit(main())
