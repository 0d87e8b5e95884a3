"""Keep the settled start of a scenario beside the compiled code, for the next start of a node.

Settling is the longest part of a start with compiled code. The same code settles the same scenario
to the same bits, so a kept state changes no run: a file's name is the digest of the scenario, of
the code and of the packages that compute the state. A file that is damaged, or of which only a part
was written, is ignored and written anew.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import secrets
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
import scipy

import rover_sim.plants
import rover_sim.scenarios
from msg_schemas.regular_files import read_text
from rover_sim.plants.ahead_of_time import compiled_marker
from rover_sim.plants.saved_state import plain_state
from rover_sim.plants.spatial_plant import SpatialPlant

_MOST_FILES: Final = 32
_LARGEST: Final = 1 << 24  # [byte]
_WITHOUT_EFFECT: Final = ("name", "about", "sensors")
"""Parts of a scenario that do not change its settled state."""


def settle_or_load(plant: SpatialPlant) -> None:
    """Settle a plant's start, unless it needs none or its settled state is kept.

    The code of the plant's model must come from the cache: code that a process compiled for itself
    may differ in the last bits.

    Raises:
        SettlingError: it does not come to rest.
        ScenarioError: the tether does not reach the rover.
    """
    if not plant.settles:
        return
    file = state_file(plant)
    try:
        plant.start_from(_read(file))
    except (OSError, ValueError):
        settled = plant.settled_state()
        with contextlib.suppress(OSError):
            _write(file, plain_state(settled))


def state_file(plant: SpatialPlant) -> Path:
    """Return the path of the file that keeps a plant's settled state."""
    marker = compiled_marker(plant.scenario.model)
    scenario = {
        name: value
        for name, value in plant.scenario.to_mapping().items()
        if name not in _WITHOUT_EFFECT
    }
    scenario["start"] = dict(scenario["start"], compression=0.0, tilt=[0.0, 0.0, 0.0])
    digest = hashlib.sha256(json.dumps(scenario, sort_keys=True).encode())
    for part in (marker.name, np.__version__, scipy.__version__, _sources()):
        digest.update(part.encode())
    return marker.with_name(f"settled_{digest.hexdigest()[:24]}.json")


@cache
def _sources() -> str:
    """Digest of the sources besides the compiled ones that compute the state."""
    digest = hashlib.sha256()
    for package in (rover_sim.plants, rover_sim.scenarios):
        for folder in package.__path__:
            for path in sorted(Path(folder).glob("*.py")):
                digest.update(path.read_bytes())
    return digest.hexdigest()


def _read(file: Path) -> Any:
    """Return the state of a file as plain values.

    Raises:
        OSError: there is none that can be read.
        ValueError: it is damaged.
    """
    digest, _, content = read_text(file, _LARGEST).partition("\n")
    if digest != _digest_of(content):
        raise ValueError(f"{file}: its digest is not that of its content")
    return json.loads(content)


def _write(file: Path, values: Any) -> None:
    """Write a file as a whole, and remove the oldest ones beyond the limit.

    Raises:
        OSError: it cannot be written.
    """
    content = json.dumps(values)
    part = file.with_name(f"{file.name}.{secrets.token_hex(8)}")
    try:
        part.write_text(f"{_digest_of(content)}\n{content}", encoding="utf-8")
        part.replace(file)
    except OSError:
        part.unlink(missing_ok=True)
        raise
    kept = sorted(file.parent.glob("settled_*"), key=lambda path: path.stat().st_mtime_ns)
    for path in kept[:-_MOST_FILES]:
        path.unlink(missing_ok=True)


def _digest_of(content: str) -> str:
    return hashlib.sha256(content.encode()).hexdigest()
