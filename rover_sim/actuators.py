"""The drives' side of the plant: commands judged against it, and stopped when they cease.

The contract has already refused what is no number, out of limits or out of date. Here is refused
what only the plant can judge, such as a compression during the flight. Time is simulated time.
"""

from __future__ import annotations

from msg_schemas import topics
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import JointSample
from msg_schemas.table import JUMP_SCREW, TOPICS, WINCH_BRAKE, WINCH_DRUM
from rover_sim.plant import Command, JumpMotorCommand, Phase
from rover_sim.scenario import Scenario

_NANO = 1e9
# A drum without a motor is told to hold the length that it has; so near counts as that.
_SAME_LENGTH = 1e-3
# A command that was on its way when the latch tripped is no mistake of its sender's.
_ON_THE_WAY_NS = 100_000_000


class Actuators:
    """What the drives were last told, while it holds.

    Args:
        scenario: what is simulated.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._silence_ns = round(TOPICS[topics.JUMP_MOTOR_COMMAND].stale.silence * _NANO)
        self._took_off_ns: int | None = None
        self._jump: JumpMotorCommand | None = None
        self._jump_heard_ns = 0

    @property
    def command(self) -> Command:
        """What the plant is to do in the next tick."""
        return Command(jump=self._jump)

    def clear(self) -> None:
        """Forget everything: the plant starts again."""
        self._jump = None
        self._took_off_ns = None

    def note_take_off(self, now_ns: int) -> None:
        """The latch has tripped: what was commanded is done."""
        self._jump = None
        self._took_off_ns = now_ns

    def command_jump(
        self, sample: JointSample, phase: Phase, compression: float, now_ns: int
    ) -> None:
        """Take a command for the nut of the jump motor.

        Args:
            sample: an accepted sample of the jump motor's command.
            phase: the plant's.
            compression: present compression of the spring [m].
            now_ns: simulated time of arrival.

        Raises:
            Refusal: the plant cannot do it now, or not at all.
        """
        topic = topics.JUMP_MOTOR_COMMAND
        rover = self._scenario.rover
        if rover is None:
            raise Refusal(
                topic,
                RefusalCode.NOT_SUPPORTED,
                f"the scenario {self._scenario.name} has no rover, so it has no jump motor",
            )
        if phase.final:
            raise Refusal(topic, RefusalCode.WRONG_PHASE, stopped(phase))
        taken_off = self._took_off_ns
        if taken_off is not None and sample.stamp_ns <= taken_off + _ON_THE_WAY_NS:
            return
        if phase not in (Phase.HELD, Phase.LANDED):
            raise Refusal(
                topic,
                RefusalCode.WRONG_PHASE,
                f"the nut cannot be driven in phase {phase.value}, the rover must stand",
            )
        setpoint, rate, effort = sample.joints[JUMP_SCREW]
        if setpoint < 0.0:
            raise Refusal(
                topic,
                RefusalCode.NOT_SUPPORTED,
                f"{JUMP_SCREW}.position is {setpoint!r} m, this plant's nut has no free travel: "
                "it must be at least 0",
            )
        if 0.0 < setpoint < compression:
            raise Refusal(
                topic,
                RefusalCode.OUT_OF_LIMITS,
                f"{JUMP_SCREW}.position is {setpoint!r} m, the spring is compressed by "
                f"{compression:.4g} m already: it must be at least that, or 0 to let it down",
            )
        force = rover.spring_rate * setpoint
        if force > effort:
            raise Refusal(
                topic,
                RefusalCode.OUT_OF_LIMITS,
                f"{JUMP_SCREW}.effort is {effort!r} N, holding the spring at {setpoint:.4g} m "
                f"takes {force:.4g} N: the setpoint cannot be reached",
            )
        self._jump = JumpMotorCommand(setpoint, rate)
        self._jump_heard_ns = now_ns

    def command_winch(self, sample: JointSample, phase: Phase) -> None:
        """Take a command for the drum; one without a motor can only hold.

        Raises:
            Refusal: anything but holding the present length, or nothing moves any more.
        """
        topic = topics.WINCH_COMMAND
        if phase.final:
            raise Refusal(topic, RefusalCode.WRONG_PHASE, stopped(phase))
        length, rate, _ = sample.joints[WINCH_DRUM]
        held = self._scenario.tether.length
        released = sample.joints[WINCH_BRAKE].position != 0.0
        if rate != 0.0 or released or abs(length - held) > _SAME_LENGTH:
            raise Refusal(
                topic,
                RefusalCode.NOT_SUPPORTED,
                f"{WINCH_DRUM} is told {length!r} m at {rate!r} m/s, brake "
                f"{'released' if released else 'closed'}; this plant's drum has no motor and only "
                f"holds: {held:g} m at 0 m/s, brake closed",
            )

    def silenced(self, now_ns: int, compression: float) -> float | None:
        """Stop the nut when commands have ceased while it moves.

        Returns:
            How long there was silence [s] if the nut was stopped just now.
        """
        jump = self._jump
        if jump is None or now_ns - self._jump_heard_ns < self._silence_ns:
            return None
        self._jump = None
        if jump.compression == compression:
            return None
        return (now_ns - self._jump_heard_ns) / _NANO


def stopped(phase: Phase) -> str:
    """Say why nothing moves any more and what would help."""
    why = {
        Phase.DIVERGED: "the integration has diverged",
        Phase.TETHER_BROKEN: "the tether is broken",
    }[phase]
    return f"{why}, nothing moves; {topics.SIM_RESET} or {topics.SIM_RESET_PLANT} starts again"
