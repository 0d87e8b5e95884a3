"""The one reader of YAML: of parameters, scenarios, plans, procedures, devices and bags.

It follows YAML 1.2. PyYAML's safe loader follows YAML 1.1, which reads ``1e4`` as text, ``on`` as a
boolean, ``010`` as 8, ``1:30`` as 90, ``2001-01-01`` as a date. This reader accepts mappings with
text as unique keys, lists, text, numbers, booleans and null, and bounds size, depth and aliases, so
that no file costs much time or memory.
"""

from __future__ import annotations

import re
from collections.abc import Hashable
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import yaml

from msg_schemas.fields import FieldError, named
from msg_schemas.regular_files import LARGEST_TEXT, read_text
from msg_schemas.text_limits import LONGEST_REASON, cut, printable

_DEEPEST = 32  # levels of mappings and lists
_MOST_NODES = 100_000  # keys and values, those behind each alias counted anew

_TAG = "tag:yaml.org,2002:"
_INT, _FLOAT, _BOOL = (_TAG + kind for kind in ("int", "float", "bool"))
_ACCEPTED = frozenset(_TAG + kind for kind in ("map", "seq", "str", "int", "float", "bool", "null"))
_RESOLVED = _ACCEPTED - {_INT, _FLOAT, _BOOL}  # as PyYAML does
_BAD_SCALARS = (ValueError, OverflowError, KeyError, TypeError, AttributeError, IndexError)


class _Loader(yaml.SafeLoader):
    """The safe loader with YAML 1.2's scalars, unique keys and limits."""

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._depth = 0
        self._sizes: dict[int, int] = {}  # nodes in a node, by its identity
        self._open: set[str] = set()  # anchors of the nodes that are being composed

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        anchor = event.anchor
        if isinstance(event, yaml.AliasEvent) and anchor in self._open:
            raise _Error(f"the alias {anchor!r} lies in itself", event.start_mark)
        if self._depth >= _DEEPEST:
            raise _Error(f"it is nested deeper than {_DEEPEST} levels", event.start_mark)
        opened = {anchor} - self._open - {None}
        self._open |= opened
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        self._open -= opened
        if node is not None and id(node) not in self._sizes:
            self._sizes[id(node)] = self._size_of(node)
        return node

    def _size_of(self, node: yaml.Node) -> int:
        size = 1
        if isinstance(node, yaml.MappingNode):
            size += sum(self._sizes[id(part)] for pair in node.value for part in pair)
        elif isinstance(node, yaml.SequenceNode):
            size += sum(self._sizes[id(part)] for part in node.value)
        if size > _MOST_NODES:
            raise _Error(f"it has more than {_MOST_NODES} values", node.start_mark)
        return size

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        if node.tag not in _ACCEPTED:
            raise _Error(f"the tag {node.tag!r} is not accepted", node.start_mark)
        try:
            return super().construct_object(node, deep)
        except _BAD_SCALARS as error:
            kind = node.tag.removeprefix(_TAG)
            value = cut(repr(node.value), 60) if isinstance(node, yaml.ScalarNode) else "a group"
            raise _Error(f"{value} is no {kind}: {error}", node.start_mark) from None

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: set[Any] = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if not isinstance(key, str):
                raise _Error(f"the key {key!r} should be text", key_node.start_mark)
            if key in seen:
                raise _Error(f"the key {key!r} stands twice", key_node.start_mark)
            seen.add(key)
        return super().construct_mapping(node, deep)

    def construct_yaml_int(self, node: yaml.ScalarNode) -> int:
        return int(self.construct_scalar(node), 0)


class _Error(yaml.constructor.ConstructorError):
    def __init__(self, problem: str, mark: Any) -> None:
        super().__init__(None, None, problem, mark)


_NUMBER_STARTS = list("-+0123456789.")
_INT_PATTERN = re.compile(r"^(?:[-+]?(?:0|[1-9][0-9]*)|0x[0-9a-fA-F]+|0o[0-7]+)$")
_FLOAT_PATTERN = re.compile(
    r"^(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)[eE][-+]?[0-9]+"
    r"|[-+]?(?:\.[0-9]+|[0-9]+\.[0-9]*)|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$"
)
_BOOL_PATTERN = re.compile(r"^(?:true|True|TRUE|false|False|FALSE)$")

_Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag in _RESOLVED]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver(_INT, _INT_PATTERN, _NUMBER_STARTS)
_Loader.add_implicit_resolver(_FLOAT, _FLOAT_PATTERN, _NUMBER_STARTS)
_Loader.add_implicit_resolver(_BOOL, _BOOL_PATTERN, list("tTfF"))
_Loader.add_constructor(_INT, _Loader.construct_yaml_int)


class YamlFileError(FieldError):
    """A file, or text, that is not read: its name and why."""

    def __init__(self, label: str, problem: str) -> None:
        super().__init__(label, None, problem)
        self.args = (f"{named(cut(label, LONGEST_REASON))}: {problem}",)


def read_yaml(source: Path | Traversable | str, name: str = "") -> Any:
    """Read one YAML document from a file, or from text if `source` is a string.

    Raises:
        YamlFileError: If the file cannot be read, is no regular file or too large, or its content
            is refused; names the file (or `name`) and the line.
    """
    label = name or ("text" if isinstance(source, str) else str(source))
    try:
        if isinstance(source, str):
            content = source
        elif isinstance(source, Path):
            content = read_text(source)
        else:
            content = source.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise YamlFileError(label, f"cannot be read: {reason}") from None
    if len(content) > LARGEST_TEXT:
        raise YamlFileError(label, f"has more than {LARGEST_TEXT} characters")
    try:
        return yaml.load(content, Loader=_Loader)
    except yaml.YAMLError as error:
        raise YamlFileError(label, f"is not YAML: {_one_line(error)}") from None


def _one_line(error: yaml.YAMLError) -> str:
    if not isinstance(error, yaml.MarkedYAMLError):
        return printable(cut(" ".join(str(error).split()), LONGEST_REASON))
    mark = error.problem_mark
    where = f" (line {mark.line + 1}, column {mark.column + 1})" if mark is not None else ""
    return printable(cut(str(error.problem), LONGEST_REASON)) + where
