"""Reads the parameter files of ROS 2, as ``config/`` ships them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from msg_schemas.fields import shown
from msg_schemas.package import PACKAGE
from msg_schemas.parameters import ParameterError
from msg_schemas.yaml_reader import read_yaml

_ROOT = Path(__file__).parents[1]
# Both colcon and pip install into PREFIX/lib/pythonX.Y/site-packages and PREFIX/share. A checkout
# may stand nearer to the root of the file system than that.
_FOLDERS = (
    _ROOT / "config",
    *(prefix / "share" / PACKAGE / "config" for prefix in _ROOT.parents[2:3]),
)


def config_folder() -> Path:
    """Return the folder of the shipped parameter files, of a checkout or of an installation.

    Raises:
        FileNotFoundError: neither is there.
    """
    for folder in _FOLDERS:
        if (folder / "winch_node.yaml").is_file():
            return folder
    msg = f"no parameter files in {' or '.join(map(str, _FOLDERS))}"
    raise FileNotFoundError(msg)


def read_parameters(files: Iterable[str | Path], node: str) -> dict[str, object]:
    """Return a node's parameters from files; later files override earlier ones.

    Raises:
        ParameterError: a file is not a parameter file.
    """
    found: dict[str, object] = {}
    for file in files:
        content = read_yaml(Path(file))
        if not isinstance(content, Mapping):
            msg = f"{file} holds no parameters: should be NODE: ros__parameters: NAME: VALUE"
            raise ParameterError(msg)
        for key in ("/**", f"/**/{node}", node, f"/{node}"):
            section = content.get(key, {})
            values = section.get("ros__parameters", {}) if isinstance(section, Mapping) else None
            if not isinstance(values, Mapping):
                msg = f"{file}: {key} holds {shown(values)}, should be ros__parameters: NAME: VALUE"
                raise ParameterError(msg)
            found |= {str(name): value for name, value in values.items()}
    return found
