"""Commands of the `ros2` command line as the documents have them, held to the suite without it.

Each is read by a parser that knows what of `ros2` the documents use, and becomes an object that
says what it would do. `check` holds it to our own launch files, executables, topics, types and
parameters; the sessions' test does it.
"""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import architecture
import yaml
from documented import ROOT
from ros_messages import sent_by_rclpy

from msg_schemas.access import ACCESS, Act, check_access
from msg_schemas.actions import ACTIONS, ActionSpecification
from msg_schemas.cdr import unpack
from msg_schemas.message_types import message_class
from msg_schemas.package import PACKAGE
from msg_schemas.parameters import ParameterError, from_mapping, rules_of
from msg_schemas.specifications import Service, Topic
from msg_schemas.table import SERVICES, TOPICS
from rover_launch.plan import LaunchPlan, arguments_of, plan
from rover_runtime.component import Component
from rover_runtime.ros.interface_packages import SOURCES
from rover_runtime.ros.node import parameter_classes
from rover_verify.checks.launches import described

OPERATOR = "operator"
_ROS_ARGUMENTS = "--ros-args"


class Parser(argparse.ArgumentParser):
    """A parser that fails by an exception."""

    def error(self, message: str) -> NoReturn:
        raise AssertionError(f"{self.prog}: {message}")


# --------------------------------------------------------------------------- nodes and parameters


def node_class(executable: str) -> type[Component] | None:
    """The node of an executable; None: it is no node that is run by parameters alone."""
    module = importlib.import_module(architecture.nodes(ROOT)[executable])
    found = [
        value
        for value in vars(module).values()
        if isinstance(value, type)
        and issubclass(value, Component)
        and value.__module__ == module.__name__
        and executable == value.NAME
    ]
    return found[0] if found else None


def check_parameters(node: type[Component], given: Mapping[str, object]) -> None:
    """Hold parameters to those that a node has, with its rules."""
    left = dict(given)
    left.pop("use_sim_time", None)
    for cls in parameter_classes(node):
        mine = {name: left.pop(name) for name in rules_of(cls) if name in left}
        from_mapping(cls, mine)
    if left:
        raise ParameterError(f"{node.NAME} has no parameter {', '.join(left)}")


def split_ros_arguments(words: Sequence[str]) -> tuple[list[str], dict[str, object]]:
    """Arguments before ``--ros-args``, and parameters after it."""
    at = words.index(_ROS_ARGUMENTS) if _ROS_ARGUMENTS in words else len(words)
    parser = Parser(prog=_ROS_ARGUMENTS)
    parser.add_argument("-p", action="append", default=[])
    parameters = {}
    for text in parser.parse_args(list(words[at + 1 :])).p:
        name, sign, value = text.partition(":=")
        assert sign, f"-p {text}: should be NAME:=VALUE"
        parameters[name] = yaml.safe_load(value)
        assert not isinstance(parameters[name], dict), f"ROS reads no mapping: quote {value} twice"
    return list(words[:at]), parameters


# -------------------------------------------------------------------------------------- messages


def filled(message: Any, values: Mapping[str, Any]) -> Any:
    """A message with the values of a text in YAML, as ``ros2 topic pub`` fills it in."""
    for name, value in values.items():
        held = getattr(message, name)  # AttributeError: the type has no such field
        if isinstance(value, Mapping):
            filled(held, value)
        elif isinstance(held, float):
            setattr(message, name, float(value))
        elif isinstance(value, list) and getattr(held, "typecode", "") == "d":
            setattr(message, name, [float(each) for each in value])
        else:
            setattr(message, name, value)
    return message


def row_of(rows: Mapping[str, Any], given: str, namespace: str = "") -> Any:
    """The contract's row of a name, given in a namespace or without one."""
    for name, row in rows.items():
        if given.strip("/").removeprefix(namespace).strip("/") == name.strip("/"):
            return row
    raise AssertionError(f"{given} is not in the contract")


# -------------------------------------------------------------------------------------- commands


@dataclass(frozen=True)
class Launch:
    """``ros2 launch``: the processes of one of our launch files."""

    file: str
    given: Mapping[str, str]

    def plan(self, config: Path = ROOT / "config", **other: str) -> LaunchPlan:
        """What it starts, some arguments being other ones."""
        controllers, defaults = described(ROOT / "launch" / self.file)
        arguments = arguments_of(controllers, str(config), defaults)
        values = {each.name: each.default for each in arguments}
        unknown = self.given.keys() - values.keys()
        assert not unknown, f"{self.file} has no argument {', '.join(unknown)}"
        return plan(controllers, values | dict(self.given) | other, lambda _name: None)

    def check(self) -> None:
        """Every process that it starts has the parameters that it is given."""
        for started in self.plan().started:
            node = node_class(started.executable)
            if node is not None:
                check_parameters(node, started.parameters)


@dataclass(frozen=True)
class Run:
    """``ros2 run``: one of our executables, with its arguments."""

    words: tuple[str, ...]

    def check(self) -> None:
        """Check that the executable exists; its own test checks the arguments."""
        assert self.words[0] in architecture.nodes(ROOT), self.words[0]


@dataclass(frozen=True)
class Publish:
    """``ros2 topic pub``: one message."""

    row: Topic
    values: Mapping[str, Any]

    def message(self) -> Any:
        """What is sent."""
        return filled(message_class(self.row.message)(), self.values)

    def check(self) -> None:
        """The contract takes the message, from an operator."""
        unpack(self.row.name, sent_by_rclpy(self.message()))
        check_access(OPERATOR, Act.PUBLISH, self.row.name)


@dataclass(frozen=True)
class Echo:
    """``ros2 topic echo``."""

    row: Topic

    def check(self) -> None:
        """Nothing more is to be held: the row is there."""


@dataclass(frozen=True)
class Call:
    """``ros2 service call``."""

    row: Service
    values: Mapping[str, Any]

    def check(self) -> None:
        """The type has what is given."""
        filled(message_class(self.row.service).Request(), self.values)


@dataclass(frozen=True)
class SendGoal:
    """``ros2 action send_goal``."""

    action: ActionSpecification
    values: Mapping[str, Any]

    def check(self) -> None:
        """The goal has what is given, and an operator may send it."""
        package, _, name = self.action.action.split("/")
        definition = SOURCES / package / "action" / f"{name}.action"
        goal = definition.read_text(encoding="utf-8").partition("---")[0]
        fields = {line.split()[1] for line in goal.splitlines() if line.strip() and line[0] != "#"}
        assert set(self.values) <= fields
        check_access(OPERATOR, Act.REQUEST, self.action.name)


@dataclass(frozen=True)
class SetParameter:
    """``ros2 param set``."""

    node: str
    name: str
    value: object

    def check(self) -> None:
        """The node has the parameter, takes the value, and takes it while it runs."""
        node = node_class(self.node)
        assert node is not None, self.node
        check_parameters(node, {self.name: self.value})
        (rule,) = [r[self.name] for c in parameter_classes(node) if self.name in (r := rules_of(c))]
        assert not rule.read_only, f"{self.name} cannot be set while {self.node} runs"


@dataclass(frozen=True)
class Secure:
    """``ros2 security``: keys for the enclaves of our policy."""

    policy: str

    def check(self) -> None:
        """The policy is there, with an enclave for the operator."""
        assert OPERATOR in ACCESS
        assert not self.policy or (ROOT / self.policy).is_file()


@dataclass(frozen=True)
class Foreign:
    """What has nothing of ours in it."""

    def check(self) -> None:
        """Nothing is to be held."""


Ros2 = Launch | Run | Publish | Echo | Call | SendGoal | SetParameter | Secure | Foreign


def _launch(words: Sequence[str]) -> Launch:
    package, file, *rest = words
    assert package == PACKAGE
    given = {}
    for word in rest:
        if word == "--show-args":
            continue
        name, sign, value = word.partition(":=")
        assert sign, f"{word}: should be NAME:=VALUE"
        given[name] = value
    return Launch(file, given)


def _run(words: Sequence[str]) -> Run:
    package, *rest = words
    assert package == PACKAGE
    return Run(tuple(rest))


def _parsed(parser: Parser, words: Sequence[str], *names: str) -> argparse.Namespace:
    for name in names:
        parser.add_argument(name)
    return parser.parse_args(list(words))


def _publish(words: Sequence[str]) -> Publish:
    parser = Parser(prog="ros2 topic pub")
    often = parser.add_mutually_exclusive_group()
    often.add_argument("--once", action="store_true")
    often.add_argument("-r", "--rate", type=float)
    parser.add_argument("-w", "--wait-matching-subscriptions", type=int)
    given = _parsed(parser, words, "topic", "type", "values")
    row = row_of(TOPICS, given.topic)
    assert given.type == row.message, f"{given.topic} is a {row.message}"
    return Publish(row, yaml.safe_load(given.values))


def _echo(words: Sequence[str]) -> Echo:
    parser = Parser(prog="ros2 topic echo")
    parser.add_argument("--once", action="store_true")
    parser.add_argument("topic")
    return Echo(row_of(TOPICS, parser.parse_args(list(words)).topic))


def _call(words: Sequence[str]) -> Call:
    parser = Parser(prog="ros2 service call")
    for name in ("service", "type"):
        parser.add_argument(name)
    parser.add_argument("values", nargs="?", default="{}")
    given = parser.parse_args(list(words))
    first, _, _ = given.service.strip("/").partition("/")
    namespace = first if first.startswith("rover") else ""
    row = row_of(SERVICES, given.service, namespace)
    assert given.type == row.service, f"{given.service} is a {row.service}"
    return Call(row, yaml.safe_load(given.values))


def _send_goal(words: Sequence[str]) -> SendGoal:
    parser = Parser(prog="ros2 action send_goal")
    parser.add_argument("-f", "--feedback", action="store_true")
    given = _parsed(parser, words, "action", "type", "values")
    row = row_of(ACTIONS, given.action)
    assert given.type == row.action, f"{given.action} is a {row.action}"
    return SendGoal(row, yaml.safe_load(given.values))


def _set_parameter(words: Sequence[str]) -> SetParameter:
    node, name, value = words
    # As `ros2 param set` does: a text that reads as a list of mappings is no parameter's type.
    read = yaml.safe_load(value)
    return SetParameter(node.strip("/"), name, value if isinstance(read, (list, dict)) else read)


def _secure(words: Sequence[str]) -> Secure:
    parser = Parser(prog="ros2 security")
    kinds = parser.add_subparsers(required=True)
    create = kinds.add_parser("create_keystore")
    create.add_argument("keystore")
    generate = kinds.add_parser("generate_artifacts")
    generate.add_argument("-k", required=True)
    generate.add_argument("-p", default="")
    return Secure(getattr(parser.parse_args(list(words)), "p", ""))


_READERS: Mapping[tuple[str, ...], Callable[[Sequence[str]], Ros2]] = {
    ("launch",): _launch,
    ("run",): _run,
    ("topic", "pub"): _publish,
    ("topic", "echo"): _echo,
    ("service", "call"): _call,
    ("action", "send_goal"): _send_goal,
    ("param", "set"): _set_parameter,
    ("security",): _secure,
    ("bag", "record"): lambda _: Foreign(),
}


def read(words: Sequence[str]) -> Ros2:
    """What a command of ``ros2`` would do; AssertionError: it is none that is known."""
    assert words[0] == "ros2"
    for verbs, reader in _READERS.items():
        if tuple(words[1 : 1 + len(verbs)]) == verbs:
            return reader(words[1 + len(verbs) :])
    raise AssertionError(f"{' '.join(words[:3])}: not known to the documents' test")
