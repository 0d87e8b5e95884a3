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
from rover_control.mission_legs import Ask, MissionPhase
from rover_control.mission_plan import load_plan
from rover_control.mission_report import state_sample
from rover_control.observed_state import HEARD

# The controller's parameters are parts of its own, by their name there.
_PARTS: Mapping[str, type[Any]] = {
    part.name: type(getattr(MissionSettings(), part.name)) for part in fields(MissionSettings)
}
_KEPT_EVERY = 1.0  # by the wall clock [s]
_REQUESTS = (
    topics.WINCH_REQUEST,
    topics.DESCENT_REQUEST,
    topics.DRIVE_GOAL,
    topics.DRIVE_START,
    topics.JUMP_REQUEST,
)


@dataclass(frozen=True)
class MissionNodeParameters:
    """What is to be done, and where it is kept how far it is."""

    plan: str = parameter(
        "marius_hills", "-", "name of a plan of the package, or path of a .yaml file",
        read_only=True,
    )  # fmt: skip
    checkpoint: str = parameter(
        "auto", "-", "file that the mission goes on from when it was killed; auto: in ~/.ros; "
        "none: it is not kept", read_only=True,
    )  # fmt: skip
    supervision_rate: float = parameter(
        10.0, "Hz", "how often the mission is stepped", 1.0, 50.0, read_only=True
    )
    state_rate: float = parameter(
        2.0, "Hz", "how often it is told how far it is", 0.1, 50.0, read_only=True
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
        self._requests = {name: self.publisher(name) for name in _REQUESTS}
        self._phase_publisher = self.publisher(topics.MISSION_PHASE)
        self._state_publisher = self.publisher(topics.MISSION_STATE)
        self._askers: dict[str, str] = {}  # by what name each topic's last request is answered
        self._asked = 0
        self._begin()
        for name in HEARD:
            if name not in (topics.DIAGNOSTICS, topics.EVENTS):
                self.subscribe(name, self._hearer(name))
        self.subscribe(topics.EVENTS, self._on_events, depth=200)
        self.subscribe(topics.DIAGNOSTICS, self._on_diagnostics, depth=200)
        self.serve(topics.MISSION_GO, lambda: self._done(self._mission.go(self.now_ns())))
        self.serve(topics.MISSION_HOLD, lambda: self._done(self._mission.hold(self.now_ns())))
        self.serve(topics.MISSION_RESUME, lambda: self._done(self._mission.resume(self.now_ns())))
        self.serve(topics.MISSION_SKIP, lambda: self._done(self._mission.skip(self.now_ns())))
        self.serve(topics.MISSION_ABORT, lambda: self._done(self._mission.abort(self.now_ns())))

    def configuration(self) -> Mapping[str, Any]:
        """The plan, beside the parameters."""
        return {"mission": to_mapping(self._plan)}

    def start(self) -> None:
        """Go on from where it was kept, where that is of this run; else stand by."""
        self._begin()
        rates = self.parameters_of(MissionNodeParameters)
        self.every(1.0 / rates.supervision_rate, self._step)
        self.every(1.0 / rates.state_rate, self._publish_state)
        self.every(_KEPT_EVERY, self._keep, by_wall_clock=True)

    def stop(self) -> None:
        """Bring to rest what the mission has set going; it is resumed by people alone."""
        if self._mission.is_active:
            self._mission.hold(self.now_ns())
            self._step()
        self._keep()

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
        told = self._told_phase
        self._begin()
        self._is_restored = True
        if told == self._mission.phase.value:
            self._told_phase = told

    def waiting_for(self) -> tuple[str, ...]:
        """The winch, without which no mission begins."""
        now = self.now_ns() * 1e-9
        silent = self._mission.observed.silent(topics.WINCH_ESTIMATE, now)
        return (topics.WINCH_ESTIMATE,) if silent else ()

    def health(self) -> tuple[Status, ...]:
        """The phase, and what keeps it from going on."""
        if not self.active:
            return ()
        mission = self._mission
        waits = f", waiting: {mission.waits_for}" if mission.waits_for else ""
        leg = f": {mission.leg.name}" if mission.leg is not None and mission.is_active else ""
        still = "" if mission.is_active else f": {mission.reason}" * bool(mission.reason)
        held = mission.phase.value in ("holding", "aborted")
        text = f"{mission.phase}{leg}{still}{waits}"
        level = Level.WARN if held else Level.OK
        return (Status(f"{self.NAME}: mission", text, level, self.NAME),)

    # --- what is heard ---------------------------------------------------------------------------

    def _hearer(self, name: str) -> Any:
        def hear(sample: Sample) -> None:
            self._heard[name] = sample
            self._mission.hear(name, sample, self.now_ns())

        return hear

    def _on_events(self, sample: StatusSample) -> None:
        others = tuple(each for each in sample.statuses if each.hardware_id != self.NAME)
        if others:
            told = StatusSample(sample.stamp_ns, others)
            self._mission.hear(topics.EVENTS, told, self.now_ns())

    def _on_diagnostics(self, sample: StatusSample) -> None:
        """Refusals of what the mission has asked for; others' are theirs."""
        ours = tuple(
            each
            for each in sample.statuses
            if each.values.get("commander") in self._askers.values()
        )
        if ours:
            told = StatusSample(sample.stamp_ns, ours)
            self._mission.hear(topics.DIAGNOSTICS, told, self.now_ns())

    # --- what is told and asked ------------------------------------------------------------------

    _heard: dict[str, Sample]
    _told_phase = ""

    def _settings(self) -> MissionSettings:
        return MissionSettings(**{name: self.parameters_of(part) for name, part in _PARTS.items()})

    def _begin(self) -> None:
        heard = getattr(self, "_heard", {})
        self._mission = Mission(self._plan, self._settings())
        self._heard = heard
        # What is latched is not said again.
        for name, sample in heard.items():
            if isinstance(sample, TextSample) or name == topics.WINCH_ALARMS:
                self._mission.hear(name, sample, self.now_ns())
        self._told_phase = ""
        self._is_restored = False

    def _step(self) -> None:
        now_ns = self.now_ns()
        if not self._is_restored and self.knows_time():
            self._is_restored = True
            self._restore(now_ns)
        for ask in self._mission.step(now_ns):
            self._ask(ask, now_ns)
        for change in self._mission.take_changes():
            self.event(change.name, change.reason, change.level, change.values)
        phase = self._mission.phase.value
        if phase != self._told_phase:
            self._told_phase = phase
            self._phase_publisher.send(TextSample(phase))
            self._keep()

    def _ask(self, ask: Ask, now_ns: int) -> None:
        sample = ask.sample
        if sample is None:
            self.call_service(
                ask.name, lambda success, text: self._answered(ask.name, success, text)
            )
            return
        if isinstance(sample, PoseSample):
            # In a frame there is no room for a name: it is answered by its stamp.
            self._askers[ask.name] = f"{now_ns} ns"
            pose = PoseSample(now_ns, sample.position, sample.orientation)
            self._requests[ask.name].send(pose)
            return
        assert isinstance(sample, JointSample)
        asker = ""
        if WINCH_WHILE_RENEWED not in sample.joints:
            self._asked += 1
            asker = self._askers[ask.name] = f"{self.get_fully_qualified_name()}#{self._asked}"
        self._requests[ask.name].send(sample, asker)

    def _answered(self, service: str, success: bool, text: str) -> None:
        if not success:
            self.report(Status(f"{self.NAME}: {service}", text, Level.WARN, self.NAME))

    def _done(self, answer: str) -> tuple[bool, str]:
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

    def _keep(self) -> None:
        """Write how far the mission is, so that a kill at any moment leaves the last or this."""
        if self._file is None or not self._is_restored:
            return
        kept = {**self._mission.checkpoint(self.now_ns()), "wall": time.time()}
        partial = self._file.with_suffix(".partial")
        try:
            self._file.parent.mkdir(parents=True, exist_ok=True)
            partial.write_text(json.dumps(kept), encoding="utf-8")
            partial.replace(self._file)
        except OSError as error:
            name = f"{self.NAME}: checkpoint"
            self.report(Status(name, f"not kept: {error}", Level.WARN, self.NAME))

    def _restore(self, now_ns: int) -> None:
        """Go on from what was kept; what cannot be read is told and left."""
        if self._file is None or not self._file.exists():
            return
        try:
            kept = json.loads(self._file.read_text(encoding="utf-8"))
            # Simulated time may have stood still meanwhile, or be another run's.
            age = max(time.time() - float(kept["wall"]), 0.0)
            within = self._mission.settings.mission.resumes_within
            if age > within:
                kept["stamp_ns"] = min(int(kept["stamp_ns"]), now_ns - round(age * 1e9))
            self._mission.restore(kept, now_ns)
        except (OSError, ValueError, KeyError, TypeError) as error:
            text = f"{self._file} cannot be read, the mission begins anew: {error!r}"
            self.event("mission_forgotten", text, Level.WARN)


def main() -> int:
    """Run the node."""
    return run(MissionNode)


if __name__ == "__main__":
    sys.exit(main())
