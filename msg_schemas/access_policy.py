"""Writes the SROS 2 policy: ``mother_rover policy [--namespace /NAME] [FILE]``.

One enclave per process, ``/mother_rover/<namespace>/<process>``, grants its nodes their rows of
``ACCESS``.
The format is version 0.2.0 of sros2's policies, without includes, whose path differs between
installations.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree as ET

from msg_schemas import topics
from msg_schemas.access import ACCESS, ALL, COMPOSED, LOCKSTEP, OF_ALL_NODES, Access, batches_of

DEFAULT_PATH = Path("config/access_policy.xml")
ROOT_NAMESPACE = "/"

_NAMESPACE = re.compile(r"/|(/[A-Za-z_][A-Za-z0-9_]*)+")
_PARAMETER_SERVICES = (
    "describe_parameters",
    "get_parameter_types",
    "get_parameters",
    "list_parameters",
    "set_parameters",
    "set_parameters_atomically",
)
_NODE_SERVICES = (
    "change_state",
    "get_available_states",
    "get_available_transitions",
    "get_state",
    "get_transition_graph",
    "get_type_description",
)


def enclave(node: str, namespace: str = ROOT_NAMESPACE) -> str:
    """Path of a node's enclave."""
    return f"/mother_rover{namespace.rstrip('/')}/{node}"


def policy(namespace: str = ROOT_NAMESPACE) -> str:
    """Return the policy of all nodes in a namespace, as XML.

    Raises:
        ValueError: the namespace is not absolute.
    """
    if not _NAMESPACE.fullmatch(namespace):
        msg = f"the namespace is {namespace!r}: should be absolute, such as / or /rover1"
        raise ValueError(msg)
    root = ET.Element("policy", version="0.2.0")
    enclaves = ET.SubElement(root, "enclaves")
    for process, nodes in {**{node: (node,) for node in ACCESS}, **COMPOSED}.items():
        each = ET.SubElement(enclaves, "enclave", path=enclave(process, namespace))
        profiles = ET.SubElement(each, "profiles")
        for node in nodes:
            profile = ET.SubElement(profiles, "profile", ns=namespace, node=node)
            _fill(profile, ACCESS[node], namespace)
    ET.indent(root)
    head = (
        "<!-- Generated from the table in msg_schemas/access.py by\n"
        "     mother_rover policy; edit the table, not this file. -->\n"
    )
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{head}{ET.tostring(root, "unicode")}\n'


def _fill(profile: ET.Element, access: Access, namespace: str) -> None:
    own = [f"~/{name}" for name in (*_PARAMETER_SERVICES, *_NODE_SERVICES)]
    published = {
        *OF_ALL_NODES.publishes,
        *OF_ALL_NODES.publishes_outside_contract,
        *access.publishes,
        *access.publishes_outside_contract,
        *_batches(access.publishes),
        "~/transition_event",
        "/parameter_events",
        "/rosout",
    }
    subscribed = {
        *access.subscribes,
        *_batches(access.subscribes),
        *LOCKSTEP,
        topics.CLOCK,
        "/parameter_events",
    }
    for kind, act, names in (
        ("topic", "publish", published),
        ("topic", "subscribe", subscribed),
        ("service", "reply", {*own, *access.serves}),
        ("service", "request", {*access.calls}),
        # sros2 expands an action to its hidden topics and services.
        ("action", "execute", {*access.executes}),
        ("action", "call", {*access.requests}),
    ):
        if not names:
            continue
        granted = ET.SubElement(profile, f"{kind}s", {act: "ALLOW"})
        for name in sorted(ALL if ALL[0] in names else names):
            written = name.strip("/") if name == topics.CLOCK and namespace != "/" else name
            ET.SubElement(granted, kind).text = written


def _batches(names: Iterable[str]) -> set[str]:
    """Topics of the batches that may hold these topics."""
    return {batches_of(name) for name in names if name not in ALL}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.description = (
        "Write the SROS 2 policy: one enclave for each node, with the topics and services that the "
        "contract allows it."
    )
    parser.add_argument("file", type=Path, nargs="?", default=DEFAULT_PATH, metavar="FILE",
                        help="file to write (default: %(default)s)")  # fmt: skip
    parser.add_argument("--namespace", default=ROOT_NAMESPACE, metavar="/NAME",
                        help="namespace of the nodes (default: %(default)s)")  # fmt: skip


def run(given: argparse.Namespace) -> int:
    """Write the policy; return 2 if the namespace is refused."""
    try:
        text = policy(given.namespace)
    except ValueError as error:
        print(f"mother_rover policy: {error}", file=sys.stderr)
        return 2
    given.file.parent.mkdir(parents=True, exist_ok=True)
    given.file.write_text(text, encoding="utf-8")
    print(f"wrote {given.file}")
    return 0
