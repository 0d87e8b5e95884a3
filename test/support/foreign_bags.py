"""Bags of every storage and compression of ``ros2 bag record``, written by rosbags."""

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from msg_schemas.yaml_reader import read_yaml

STORE = get_typestore(Stores.ROS2_JAZZY)
STRING = "std_msgs/msg/String"
START = 1_700_000_000_000_000_000
STEP = 10_000_000
METADATA = "metadata.yaml"

Recorded = tuple[str, int, bytes]


@dataclass(frozen=True)
class Kind:
    """Storage plugin and compression mode."""

    storage: StoragePlugin
    mode: CompressionMode = CompressionMode.NONE

    @property
    def name(self) -> str:
        """Name for test identifiers."""
        return f"{self.storage.name}-{self.mode.name}".lower()


KINDS = (
    Kind(StoragePlugin.SQLITE3),
    Kind(StoragePlugin.SQLITE3, CompressionMode.FILE),
    Kind(StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
    Kind(StoragePlugin.MCAP),
    Kind(StoragePlugin.MCAP, CompressionMode.FILE),
    Kind(StoragePlugin.MCAP, CompressionMode.MESSAGE),
)


def messages(count: int, first: int = 0, size: int = 40) -> list[Recorded]:
    """Strings on two topics at 100 Hz."""
    found = []
    for index in range(first, first + count):
        words = f"message {index} ".ljust(size + index % 7, "abcdefghij"[index % 10])
        data = bytes(STORE.serialize_cdr(STORE.types[STRING](data=words), STRING))
        found.append(("/more" if index % 3 == 0 else "/words", START + index * STEP, data))
    return found


def write(path: Path, kind: Kind, recorded: Sequence[Recorded], *, version: int = 9) -> Path:
    """Write a bag; returns its data file."""
    writer = Writer(path, version=8 if version == 8 else 9, storage_plugin=kind.storage)
    writer.set_compression(kind.mode, CompressionFormat.ZSTD)
    with writer:
        topics = {
            name: writer.add_connection(name, STRING, typestore=STORE)
            for name in sorted({name for name, _, _ in recorded})
        }
        for name, stamp, data in recorded:
            writer.write(topics[name], stamp, data)
    return storage_file(path)


def storage_file(bag: Path) -> Path:
    """The data file of a bag."""
    return next(file for file in bag.iterdir() if file.name != METADATA)


def split(path: Path, kind: Kind, parts: Sequence[Sequence[Recorded]]) -> Path:
    """Write a bag of several files with one description, as a splitting recorder does."""
    path.mkdir()
    files, information = [], {}
    counts: dict[str, int] = {}
    for number, part in enumerate(parts):
        single = path.with_name(f"{path.name}_part_{number}")
        file = write(single, kind, part)
        suffix = file.name.removeprefix(single.name)
        target = path / f"{path.name}_{number}{suffix}"
        file.rename(target)
        information = read_yaml(single / METADATA)
        inner = information["rosbag2_bagfile_information"]
        files.append({**inner["files"][0], "path": target.name})
        for row in inner["topics_with_message_count"]:
            name = row["topic_metadata"]["name"]
            counts[name] = counts.get(name, 0) + row["message_count"]
        shutil.rmtree(single)
    inner = information["rosbag2_bagfile_information"]
    inner["files"] = files
    inner["relative_file_paths"] = [row["path"] for row in files]
    inner["message_count"] = sum(counts.values())
    for row in inner["topics_with_message_count"]:
        row["message_count"] = counts[row["topic_metadata"]["name"]]
    (path / METADATA).write_text(yaml.safe_dump(information), encoding="utf-8")
    return path


def cut(file: Path, fraction: float) -> None:
    """Truncate a file to its first part."""
    data = file.read_bytes()
    file.write_bytes(data[: int(len(data) * fraction)])
