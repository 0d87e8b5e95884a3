"""``mother_rover validate wheel example``: a made-up set of a soil bin, with noise."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.integrate import trapezoid

from msg_schemas.number_arguments import seed
from rover_sim import Soil, Wheel, steady_wheel, wheel_on_soil
from rover_validation.wheel.sets import MEASURED, SETTINGS, write_table

SOIL: Final = Soil(
    cohesive_modulus=0.0,
    frictional_modulus=4.0e6,
    exponent=1.3,
    cohesion=0.0,
    friction_angle=30.0,
    shear_modulus=0.008,
    slip_weakening=1.8,
    side_weakening=1.5,
    slip_saturation=0.6,
    ploughing=2.5e5,
    front_ploughing=2.5,
    ploughing_decay=1.2,
    shear_release=1.2,
    rear_contact=0.3,
    excavation=0.25,
    grouser_thrust=1.5,
)
WHEELS: Final = {
    "grouser": Wheel(0.08, 0.06, 0.006, 0.0),
    "smooth": Wheel(0.08, 0.06, 0.0, 0.0),
}
_LOAD: Final = 30.0
_TRAVEL: Final = 20.0
_NOISE: Final = (0.3, 0.3, 0.5)
_COLUMNS: Final = ("wheel", "beta_deg", "setting", "repeat", *SETTINGS[2:], *MEASURED)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.description = (
        "Write measured.csv, settings.csv and indentation.json of a made-up soil bin, with noise."
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER")
    parser.add_argument("--seed", type=seed, default=1, help="of the noise; default: %(default)s")


def run(options: argparse.Namespace) -> int:
    """Write the files."""
    options.folder.mkdir(parents=True, exist_ok=True)
    write_example(options.folder, options.seed)
    print(f"{options.folder}: measured.csv, settings.csv, indentation.json")
    return 0


def write_example(folder: Path, seed: int) -> None:
    """Write the three files; settings.csv has the runs between those of measured.csv."""
    rng = np.random.default_rng(seed)
    measured, settings = [], []
    for name in WHEELS:
        for number, angle in enumerate((0, 20, 40, 60, 75)):
            for i, rim in enumerate((0, 6, 12, 20, 30, 60, 150)):
                row = [name, str(angle), str(rim), "1", f"{_TRAVEL:g}", f"{rim:g}", f"{_LOAD:g}"]
                if (number + i) % 2:
                    settings.append(row)
                else:
                    noisy = _forces(name, angle, rim) + rng.normal(size=3) * _NOISE
                    measured.append([*row, *(f"{x:.3f}" for x in noisy)])
    write_table(folder / "measured.csv", _COLUMNS, measured)
    write_table(folder / "settings.csv", _COLUMNS[:7], settings)
    depth = np.arange(1.0, 40.5, 1.0) * 1e-3
    content: dict[str, Any] = {
        f"wheel_{name}_1": {
            "kind": "wheel",
            "wheel": name,
            "z_mm": (depth * 1e3).tolist(),
            "F_N": [round(_standing(name, z) + rng.normal() * 0.5, 3) for z in depth],
        }
        for name in WHEELS
    }
    wheel = WHEELS["grouser"]
    content["_about"] = {
        "wheel": {
            "radius_m": wheel.radius,
            "width_m": wheel.width,
            "grouser_height_m": wheel.grouser_height,
        },
        "soil": {"specific_weight_N_m3": 15000.0, "repose_deg": 31.0},
    }
    (folder / "indentation.json").write_text(json.dumps(content), encoding="utf-8")


def _forces(name: str, angle: float, rim: float) -> np.ndarray:
    system = wheel_on_soil(WHEELS[name], SOIL)
    forward = _TRAVEL * np.cos(np.radians(angle))
    side = _TRAVEL * np.sin(np.radians(angle))
    sinkage, pull, across, _ = steady_wheel(system, _LOAD, forward, side, rim)
    return np.array([pull, across, sinkage * 1e3])


def _standing(name: str, sinkage: float) -> float:
    wheel = WHEELS[name]
    entry = np.arccos(1.0 - sinkage / wheel.radius)
    theta = np.linspace(-entry, entry, 401)
    depth = np.maximum(sinkage - wheel.radius * (1.0 - np.cos(theta)), 0.0)
    pressure = SOIL.frictional_modulus * depth**SOIL.exponent
    return float(trapezoid(pressure * np.cos(theta), theta) * wheel.width * wheel.radius)
