"""What a bag's folder holds, whatever its recorder left of it."""

import re
from pathlib import Path
from typing import Any

import yaml

from rover_bags.store import BagError


class ScanError(BagError):
    """Something that is not a bag, or of a kind that cannot be read."""


def bag_files(path: Path) -> list[Path]:
    """The MCAP files of a bag in their order.

    Args:
        path: The bag's folder or one MCAP file.

    Raises:
        ScanError: There is none; the text says what is there instead.
    """
    if not path.exists():
        raise ScanError(f"there is no bag {path}")
    if path.is_file():
        return [path]
    found = sorted(path.glob("*.mcap"), key=_file_order)
    if found:
        return found
    for pattern, what in (
        ("*.db3*", "an SQLite bag: convert it to MCAP first (`ros2 bag convert`)"),
        ("*.mcap.zstd", "compressed file by file: decompress its files first (`zstd -d`)"),
    ):
        if next(iter(path.glob(pattern)), None) is not None:
            raise ScanError(f"{path} is {what}")
    raise ScanError(f"{path} is not a bag: the folder holds no .mcap file")


def _file_order(path: Path) -> tuple[int, str]:
    number = re.search(r"_(\d+)$", path.stem)
    return (int(number[1]) if number else 0, path.name)


def stored_metadata(path: Path) -> dict[str, Any] | None:
    """The bag's ``metadata.yaml`` where it is there and sound, else None."""
    try:
        content = yaml.safe_load((path / "metadata.yaml").read_text(encoding="utf-8"))
        information = content["rosbag2_bagfile_information"]
    except (OSError, UnicodeDecodeError, yaml.YAMLError, KeyError, TypeError):
        return None
    return information if isinstance(information, dict) else None
