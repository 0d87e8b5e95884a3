"""Writes ``docs/contract.md`` from the table: ``mother_rover contract [FILE]``."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path

from msg_schemas import qos
from msg_schemas.access import Act, nodes_that
from msg_schemas.actions import ACTIONS
from msg_schemas.commands import CommandState
from msg_schemas.described import Described
from msg_schemas.events import EVENT_GROUPS, EventName
from msg_schemas.faults import (
    DriveFault,
    DriveFaultCause,
    JumpFailure,
    JumpFault,
    Reason,
    StuckCause,
    WinchFault,
)
from msg_schemas.machine import FRAMES
from msg_schemas.phases import HealthState
from msg_schemas.refusal import RefusalCode
from msg_schemas.specifications import Audience, Field, Intent, StalePolicy, Topic
from msg_schemas.table import CONTRACT_VERSION, SERVICES, TOPICS
from msg_schemas.text_limits import DOCUMENT_BYTES, LONGEST_REASON, NAME_BYTES, STATUS_BYTES

DEFAULT_PATH = Path("docs/contract.md")

_OWNED = (
    "one owner: `header.frame_id` names the command source; the first accepted one owns {} on all "
    "topics that command it, until its commands time out; others are refused as `owned`"
)

_DIAGNOSTICS = (
    "Each node reports its health on `diagnostics` as the status `NODE: node` with the value "
    "`state` below, and each refusal as `NODE: refused SUBJECT` with the values `subject`, `code`, "
    "`refused` (number since the start), `not_shown` and, where the request names it, "
    "`command_source`. `msg_schemas.health.read_health` and `msg_schemas.refusal.read_refusal` "
    "decode them."
)
_COMMANDS = (
    "The component that takes a request or a service call keeps a record of it, and publishes each "
    "change of it on `commands`, as one status: its name is the topic or service, its hardware "
    "id the node, its message the reason or the present activity for people. The values are "
    "`sender` and `id` (see above), `taken` (when it was taken [ns]), `state`, `what` (the content "
    "for people), `reason`, `progress` (fraction done, 0 .. 1, in steps of a tenth; empty = "
    "unknown) and `expiry` (time without a renewal after which it expires [s]; empty = it needs "
    "none). A record that has ended also has the values of the event that ended it, as "
    "`result.NAME`. `reason` is the code of a refusal, or the reason of the end (see the events). "
    "`msg_schemas.commands.read_command` decodes a record. A record that has ended never changes; "
    "node, topic or service, `sender`, `id` and `taken` identify it. A message of the same sender "
    "that asks for what is under way renews the command and has no record of its own. Streams of "
    "one owner, as drive commands, have no records."
)
_EVENTS = (
    "A message on `events` holds one status: its name is that of the event, its level the severity "
    "of that name, its values those listed. The message is for people; software decides by the "
    "name and the values. The value `reason` is one of the reasons below."
)
_HEAD = """\
# The contract

*Version {version}. This file is generated from the table in `msg_schemas` by
`mother_rover contract`; edit the table, not this file.*

The contract lists every topic, service, event and diagnostic of the suite. Names are relative:
namespaces and remapping give several rovers; only the clock is absolute, by ROS convention. Units
are SI, axes follow REP-103 (x forward, y left, z up), quaternions are (x, y, z, w). Only standard
message packages are used.

In a `sensor_msgs/JointState` all arrays are filled, one value per name; `position`, `velocity` and
`effort` have the units given below. A message that violates the contract is refused: nothing moves,
the node continues, and the refusal appears on `{diagnostics}`.

A sender may name itself and its request in the message's `header.frame_id`, where the topic has no
frame, as `SENDER#ID`. The record of the request on `{commands}` repeats both, cut to 128 characters
each; so a sender that names each request differently finds what became of it. Without an ID, and
for a request in a frame, the ID is the stamp in nanoseconds, or the time of taking if the stamp is
zero.

Texts have limits, in bytes of UTF-8; a longer one is refused as `malformed`: {name} for a frame, a
joint or another name, {status} for the message or a value of a status, {document} for a
`std_msgs/String`. A reason has at most {reason} characters. In names and reasons that a node
repeats, `?` replaces what cannot be printed.

The columns "published by" and "served by" name the nodes that may do so (`msg_schemas/access.py`);
`operator` is a person at a command line. A simulation runs one of the plants (`sim_node`,
`mock_plant`), or `hil_bridge` with `drive_emulator`.
"""


_ACTIONS = """`action_node` offers these commands as goals with feedback, result and cancel. A goal
becomes a request on the topic, or a call of the service, with the limits, refusals and owners of
that command. The record of the command is the goal's: text and progress are the feedback; last
state, reason, text and values are the result. A goal has succeeded when its record is `done`, is
canceled when it was superseded after a cancel, and aborted otherwise. The protocol has no place for
the reason of a rejection: a refused goal is accepted, and aborted with the reason in the result. A
cancel calls the service of the table, which holds the rover.
"""


def render() -> str:
    """Return the whole document as Markdown."""
    head = _HEAD.format(
        version=CONTRACT_VERSION, diagnostics="diagnostics", commands="commands",
        name=NAME_BYTES, status=STATUS_BYTES, document=DOCUMENT_BYTES, reason=LONGEST_REASON,
    )  # fmt: skip
    lines = [head]
    lines += ["## Frames", "", "| frame | meaning |", "|---|---|"]
    lines += [f"| `{name}` | {about} |" for name, about in FRAMES.items()]
    lines += ["", "## Topics at a glance", ""]
    lines += ["| topic | type | published by | rate | description |", "|---|---|---|---|---|"]
    for t in TOPICS.values():
        link = f"[`{t.name}`](#{_anchor(t.name)})"
        lines.append(
            f"| {link} | `{t.message}` | {_nodes(Act.PUBLISH, t.name)} | {_rate(t)} | {t.about} |"
        )
    lines += [
        "",
        "## Services",
        "",
        "| service | type | served by | description |",
        "|---|---|---|---|",
    ]
    lines += [
        f"| `{s.name}` | `{s.service}` | {_nodes(Act.SERVE, s.name)} | {s.about} |"
        for s in SERVICES.values()
    ]
    lines += ["", "## Actions", "", _ACTIONS, ""]
    lines += [
        "| action | type | its command | a cancel calls | description |",
        "|---|---|---|---|---|",
    ]
    lines += [
        f"| `{a.name}` | `{a.action}` | `{a.command}` | `{a.hold}` | {a.about} |"
        for a in ACTIONS.values()
    ]
    lines += ["", "## Quality of service", "", "| intent | profile of the publisher |", "|---|---|"]
    lines += [f"| {intent.value} | {qos.describe(intent)} |" for intent in Intent]
    lines += ["", "## Diagnostics", "", _DIAGNOSTICS, ""]
    lines += ["### Health", "", *_words("state", tuple(HealthState)), ""]
    lines += ["### Refusals", "", *_words("code", tuple(RefusalCode)), ""]
    lines += ["## Commands", "", _COMMANDS, "", *_words("state", tuple(CommandState)), ""]
    lines += ["## Events", "", _EVENTS, ""]
    for publisher, names in EVENT_GROUPS.items():
        lines += [f"### Events of {publisher}", "", *_event_table(tuple(names)), ""]
    lines += ["### Reasons", "", *_words("reason", tuple(Reason)), ""]
    lines += ["### Faults of the winch", "", *_words("fault", tuple(WinchFault)), ""]
    lines += ["### Causes of a drive fault on the link", ""]
    lines += [*_words("cause", tuple(DriveFaultCause)), ""]
    lines += ["### Faults of the jump", "", *_words("fault", tuple(JumpFault)), ""]
    lines += ["### Causes of a cancelled or failed jump", ""]
    lines += [*_words("cause", tuple(JumpFailure)), ""]
    lines += ["### Causes of a stuck rover", "", *_words("cause", tuple(StuckCause)), ""]
    lines += ["### Faults of the drive controller", "", *_words("fault", tuple(DriveFault))]
    lines += ["", "## Topics one by one", ""]
    for topic in TOPICS.values():
        lines += _section(topic)
    return "\n".join(lines).rstrip() + "\n"


def _words(heading: str, words: Sequence[Described]) -> list[str]:
    return [f"| {heading} | meaning |", "|---|---|", *(f"| `{w}` | {w.about} |" for w in words)]


def _event_table(names: Sequence[EventName]) -> list[str]:
    lines = ["| event | severity | meaning | values |", "|---|---|---|---|"]
    for name in names:
        values = ", ".join(f"`{value}`" for value in name.values)
        lines.append(f"| `{name}` | {name.level.name} | {name.about} | {values} |")
    return lines


def _nodes(act: Act, name: str) -> str:
    return ", ".join(f"`{node}`" for node in nodes_that(act, name)) or "every node"


def _anchor(name: str) -> str:
    return "".join(c for c in name.lower() if c.isalnum() or c in "_-")


def _rate(topic: Topic) -> str:
    return "on change" if topic.rate is None else f"{topic.rate:g} Hz"


def _section(topic: Topic) -> list[str]:
    lines = [f"### `{topic.name}`", "", f"{topic.about[0].upper()}{topic.about[1:]}.", ""]
    lines += [f"- type `{topic.message}`, {_rate(topic)}"]
    lines += [f"- published by {_nodes(Act.PUBLISH, topic.name)}"]
    lines += [f"- intent {topic.intent.value}: {qos.describe(topic.intent)}"]
    if topic.frame:
        child = f", child frame `{topic.child_frame}`" if topic.child_frame else ""
        lines += [f"- frame `{topic.frame}`{child}"]
    if topic.audience is not Audience.ALL:
        lines += [f"- for {topic.audience.value}"]
    if topic.owned:
        lines += [f"- {_OWNED.format(f'`{topic.owned}`')}"]
    if topic.spatial_only:
        lines += ["- of parts that the planar plant does not have"]
    if topic.one_joint:
        lines += ["- a message names exactly one of the joints"]
    if topic.optional_joints:
        optional = ", ".join(f"`{name}`" for name in topic.optional_joints)
        lines += [f"- a machine may lack the joints {optional}"]
    if topic.words:
        lines += [f"- one of {len(topic.words)} words, listed below"]
    lines += [f"- {rule}" for rule in _stale(topic.stale)]
    if topic.words:
        lines += ["", *_words("word", topic.words)]
    if topic.fields:
        lines += ["", "| field | unit | limits | default | meaning |", "|---|---|---|---|---|"]
        lines += [_field(row) for row in topic.fields]
    return [*lines, ""]


def _stale(policy: StalePolicy) -> list[str]:
    rules = []
    if math.isfinite(policy.max_age):
        rules.append(
            f"refused when older than {policy.max_age:g} s or stamped more than "
            f"{policy.max_lead:g} s ahead of the receiver's clock; "
            f"without a stamp: {policy.unstamped.value}"
        )
    if math.isfinite(policy.timeout):
        rules.append(f"after {policy.timeout:g} s without a message: {policy.on_timeout}")
    if math.isfinite(policy.timeout_moving):
        rules.append(
            f"after {policy.timeout_moving:g} s without a message while it moves: "
            f"{policy.on_timeout_moving}"
        )
    return rules


def _field(row: Field) -> str:
    if math.isinf(row.minimum) and math.isinf(row.maximum):
        limits = "finite"
    else:
        limits = f"{row.minimum:g} .. {row.maximum:g}"
    default = "required" if row.default is None else f"{row.default:g}"
    return f"| `{row.path}` | {row.unit} | {limits} | {default} | {row.about} |"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.description = "Write the contract's document from the table of topics and services."
    parser.add_argument("path", nargs="?", type=Path, default=DEFAULT_PATH, metavar="FILE",
                        help="file to write (default: %(default)s)")  # fmt: skip


def run(options: argparse.Namespace) -> int:
    """Write the document; return 0."""
    path: Path = options.path
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(render(), encoding="utf-8")
    print(f"wrote {path}")
    return 0
