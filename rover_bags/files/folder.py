"""Find the files of a bag, also of an incomplete one."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from msg_schemas.fields import FieldError
from msg_schemas.yaml_reader import read_yaml
from rover_bags.files.store import BagError


class ScanError(BagError):
    """A path that is not a bag, or a bag of an unsupported format."""


ZSTD_SUFFIX: Final = ".zstd"
"""Suffix of a file that was compressed as a whole."""
_KINDS: Final = (".mcap", ".db3")
_STORAGES: Final = {"mcap": ".mcap", "sqlite3": ".db3"}
"""Suffix of the files by the storage that ``metadata.yaml`` names."""
_DESCRIPTION: Final = "metadata.yaml"
_MOST_MISSING: Final = 1000
"""If more numbers are missing, they do not count files, but state a date or another run."""


def bag_files(path: Path) -> list[Path]:
    """Return the files of a bag in their order.

    Args:
        path: The bag's folder or one of its files.

    Raises:
        ScanError: There is no bag, or there are files of two storages and nothing names one.
    """
    if not path.exists():
        raise ScanError(f"there is no bag {path}")
    if path.is_file():
        if path.name == _DESCRIPTION:
            raise ScanError(f"{path} describes a bag; give the bag's folder {path.parent} instead")
        return [path]
    if not path.is_dir():
        raise ScanError(f"{path} is not a bag: it is neither a folder nor a regular file")
    found = {kind: files for kind in _KINDS if (files := _files_of(path, kind))}
    if not found:
        raise ScanError(
            f"{path} is not a bag: the folder holds no file ending in "
            f"{', '.join(_KINDS)} (optionally followed by {ZSTD_SUFFIX})"
        )
    if len(found) == 1:
        return next(iter(found.values()))
    storage = (stored_metadata(path) or {}).get("storage_identifier")
    kind = _STORAGES.get(str(storage), "")
    if kind not in found:
        raise ScanError(
            f"{path} holds files ending in {' and in '.join(found)}, and no valid {_DESCRIPTION} "
            "names the storage of the bag; give one file, or move those of one kind away"
        )
    return found[kind]


def _files_of(path: Path, kind: str) -> list[Path]:
    """Files of one kind in a folder; one that is both compressed and decompressed counts once."""
    found = {_plain_name(file): file for file in path.glob(f"*{kind}{ZSTD_SUFFIX}")}
    found |= {file.name: file for file in path.glob(f"*{kind}")}
    return sorted(found.values(), key=_file_order)


def is_one_recording(files: Sequence[Path]) -> bool:
    """Return whether files are the numbered parts of one bag, by their names."""
    numbers = {_number(file) for file in files}
    names = {re.sub(r"_\d+(?=\.[^.]*$)", "", _plain_name(file)) for file in files}
    return len(numbers) == len(files) and len(names) <= 1


def is_bag_file(file: Path) -> bool:
    """Return whether a file is one of a bag, by its name."""
    return _plain_name(file).endswith(_KINDS)


def is_sqlite(file: Path) -> bool:
    """Return whether a file of a bag is an SQLite file, by its name."""
    return _plain_name(file).endswith(".db3")


def missing_files(path: Path, information: dict[str, Any] | None) -> list[str]:
    """Return the names of missing files, from ``metadata.yaml`` or from gaps in their numbers."""
    if path.is_file():
        return []
    there = bag_files(path)
    names = {_plain_name(file) for file in there}
    listed = (information or {}).get("relative_file_paths")
    if isinstance(listed, list) and listed:
        return [str(name) for name in listed if _plain_name(Path(str(name))) not in names]
    numbers = [number for file in there if (number := _number(file)) is not None]
    last = max(numbers, default=0)
    is_counted = len(numbers) == len(there) and is_one_recording(there)
    if not is_counted or last - len(set(numbers)) >= _MOST_MISSING:
        return []
    stem, suffix = re.split(r"_\d+(?=\.)", there[0].name, maxsplit=1)
    return [f"{stem}_{number}{suffix}" for number in range(last) if number not in numbers]


def _plain_name(file: Path) -> str:
    return file.name.removesuffix(ZSTD_SUFFIX)


def _number(file: Path) -> int | None:
    number = re.search(r"_(\d+)\.[^.]*$", _plain_name(file))
    return int(number[1]) if number else None


def _file_order(path: Path) -> tuple[int, str]:
    return (_number(path) or 0, path.name)


def stored_metadata(path: Path) -> dict[str, Any] | None:
    """Return the contents of the bag's ``metadata.yaml``, or None if it is missing or damaged."""
    try:
        information = read_yaml(path / _DESCRIPTION)["rosbag2_bagfile_information"]
    except (FieldError, KeyError, TypeError):
        return None
    return information if isinstance(information, dict) else None


def metadata_problem(path: Path) -> str:
    """Return "missing" or "damaged" for ``metadata.yaml``; "" if it is valid or path is a file."""
    if path.is_file() or stored_metadata(path) is not None:
        return ""
    return "damaged" if (path / _DESCRIPTION).exists() else "missing"
