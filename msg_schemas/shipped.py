"""Configurations by name: one that a package ships in a folder, or a file by its path."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

from msg_schemas.configuration import ConfigurationError, read
from msg_schemas.yaml_reader import read_yaml

T = TypeVar("T")


class ShippedError(ValueError):
    """A configuration is missing or wrong; names file, key, value and what is accepted."""


def shipped_names(folder: Path) -> list[str]:
    """Names of the configurations that a folder ships."""
    return sorted(path.stem for path in folder.glob("*.yaml"))


def read_named(kind: type[T], name_or_path: str, folder: Path, what: str) -> tuple[Path, T]:
    """Read a configuration by its name in a folder, or a file by its path.

    Args:
        kind: class of the configuration.
        name_or_path: a name, or a path that ends in .yaml.
        folder: folder of the shipped configurations.
        what: noun for the message of an error, such as ``mission plan``.

    Returns:
        The file and its configuration.

    Raises:
        ShippedError: the file cannot be read, or its content is wrong.
    """
    path = Path(name_or_path).expanduser()
    if path.suffix != ".yaml":
        names = shipped_names(folder)
        if name_or_path not in names:
            raise ShippedError(
                f"no {what} {name_or_path!r}: should be the path of a .yaml file, or one of "
                f"{', '.join(names)}"
            )
        path = folder / f"{name_or_path}.yaml"
    try:
        return path, read(kind, read_yaml(path))
    except ConfigurationError as error:
        # An error of the YAML reader names the file already.
        text = str(error)
        raise ShippedError(text if text.startswith(str(path)) else f"{path}: {text}") from None
