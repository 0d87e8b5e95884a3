"""YAML reader that accepts numbers like 1e4 and refuses duplicate keys.

PyYAML's safe loader follows YAML 1.1, which reads ``1e4`` as text (it wants
``1.0e+4``) and ``on`` as a boolean, and lets a second key silently win over the
first.
"""

from __future__ import annotations

import re
from collections.abc import Hashable
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import yaml

from msg_schemas.fields import FieldError


class _Loader(yaml.SafeLoader):
    """The safe loader with YAML 1.2's numbers and booleans, and unique keys."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: set[Any] = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if not isinstance(key, str):
                raise yaml.constructor.ConstructorError(
                    None, None, f"the key {key!r} should be text", key_node.start_mark
                )
            if key in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"the key {key!r} stands twice", key_node.start_mark
                )
            seen.add(key)
        return super().construct_mapping(node, deep)


_FLOAT = re.compile(
    r"^(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)[eE][-+]?[0-9]+"
    r"|[-+]?(?:\.[0-9]+|[0-9]+\.[0-9]*)|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$"
)
_BOOLEAN = re.compile(r"^(?:true|True|TRUE|false|False|FALSE)$")
_REPLACED = {"tag:yaml.org,2002:float", "tag:yaml.org,2002:bool"}

_Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag not in _REPLACED]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver("tag:yaml.org,2002:float", _FLOAT, list("-+0123456789."))
_Loader.add_implicit_resolver("tag:yaml.org,2002:bool", _BOOLEAN, list("tTfF"))


def read_yaml(source: Path | Traversable | str, name: str = "") -> Any:
    """Read one YAML document from a file, or from text if `source` is a string.

    Raises:
        FieldError: If the file cannot be read or is no YAML; names the file (or
            `name`) and the line.
    """
    label = name or ("text" if isinstance(source, str) else str(source))
    try:
        content = source if isinstance(source, str) else source.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise FieldError(label, None, f"cannot be read: {reason}") from None
    try:
        return yaml.load(content, Loader=_Loader)
    except yaml.YAMLError as error:
        raise FieldError(label, None, f"is not YAML: {_one_line(error)}") from None


def _one_line(error: yaml.YAMLError) -> str:
    if not isinstance(error, yaml.MarkedYAMLError):
        return " ".join(str(error).split())
    mark = error.problem_mark
    where = f" (line {mark.line + 1}, column {mark.column + 1})" if mark is not None else ""
    return f"{error.problem}{where}"
