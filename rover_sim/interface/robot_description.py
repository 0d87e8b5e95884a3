"""URDF of the rover and the winch's drum, from a scenario, for RViz, Foxglove and others.

The root link is `map`, at the fairlead; base_link has a floating joint to it. Joints have the names
of the drives. A scenario has no mass of the wheels: a wheel is modelled as a ring with its spin
inertia, I/r^2, and that mass is subtracted from Body 1. The links' masses and inertias thus add up
to the scenario's, plus the spin inertias of flywheel and wheels.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from msg_schemas import machine
from msg_schemas.samples import Colour
from rover_sim.interface.drawing import BODY1_COLOUR, BODY2_COLOUR, WHEEL_COLOUR
from rover_sim.physics.tether.ancf import Array
from rover_sim.scenarios.hardware import RoverSettings, WinchSettings
from rover_sim.scenarios.scenario import ScenarioError
from rover_sim.scenarios.spatial_scenario import SpatialScenario

_DRUM_WIDTH: Final = 0.2  # [m]
_DRUM_COLOUR: Final = (0.55, 0.55, 0.60, 1.0)
_CAMERA_SIZE: Final = (0.04, 0.04, 0.03)
_CAMERA_COLOUR: Final = (0.10, 0.10, 0.12, 1.0)
_MESHES: Final = (".dae", ".stl", ".obj")
_QUARTER = 0.5 * math.pi
_Y: Final = (0.0, 1.0, 0.0)
_Z: Final = (0.0, 0.0, 1.0)
_ORIGIN: Final = (0.0, 0.0, 0.0)


def robot_description(scenario: SpatialScenario) -> str:
    """Return the URDF of the rover and, if there is one, the winch's drum.

    Raises:
        ValueError: the scenario has no rover.
        ScenarioError: the folder of its meshes has none.
    """
    rover = scenario.rover
    if rover is None:
        raise ValueError(f"the scenario {scenario.name} has no rover to describe")
    robot = ET.Element("robot", name="mother_rover")
    ET.SubElement(robot, "link", name=machine.WORLD_FRAME)
    _bodies(robot, rover)
    for name, place in (
        (machine.WHEEL_LEFT, rover.wheels.left),
        (machine.WHEEL_RIGHT, rover.wheels.right),
    ):
        _wheel(robot, rover, name, place)
    camera = scenario.sensors.camera
    x, y, z = camera.axis
    look = (0.0, math.atan2(-z, math.hypot(x, y)), math.atan2(y, x))
    link = _link(robot, machine.CAMERA_FRAME)
    _shape(link, "box", _CAMERA_COLOUR, size=_text(_CAMERA_SIZE))
    _joint(
        robot,
        "camera_mount",
        "fixed",
        machine.BODY1_FRAME,
        machine.CAMERA_FRAME,
        camera.position,
        look,
    )
    # REP-103: optical frame, z along the view, x to the right and y down in the image.
    _link(robot, machine.CAMERA_OPTICAL_FRAME)
    turned = (-_QUARTER, 0.0, -_QUARTER)
    _joint(
        robot,
        "camera_optics",
        "fixed",
        machine.CAMERA_FRAME,
        machine.CAMERA_OPTICAL_FRAME,
        _ORIGIN,
        turned,
    )
    lowest = (rover.wheels.axle_x, 0.0, rover.wheels.axle_z - rover.wheels.tip_radius)
    for frame, parent, place in (
        (machine.IMU_FRAME, machine.BODY1_FRAME, scenario.sensors.imu_position),
        (machine.TETHER_FRAME, machine.BODY1_FRAME, rover.attachment),
        (machine.SWITCH_FRAME, machine.BODY1_FRAME, lowest),
        (machine.FAIRLEAD_FRAME, machine.WORLD_FRAME, _ORIGIN),
    ):
        _link(robot, frame)
        _joint(robot, f"{frame}_mount", "fixed", parent, frame, place)
    if scenario.winch is not None:
        _drum(robot, scenario.winch)
    if rover.meshes:
        _use_meshes(robot, rover.meshes)
    ET.indent(robot)
    return ET.tostring(robot, encoding="unicode", xml_declaration=True) + "\n"


def _use_meshes(robot: ET.Element, folder: str) -> None:
    """Show the links of which the folder has a mesh by it; collisions keep their shapes."""
    meshes = {
        each.stem: each
        for each in sorted(Path(folder).expanduser().glob("*"))
        if each.suffix.lower() in _MESHES
    }
    shown = [link for link in robot.iter("link") if link.get("name") in meshes]
    if not shown:
        names = ", ".join(str(link.get("name")) for link in robot.iter("link"))
        raise ScenarioError(
            "rover.meshes",
            folder,
            f"should be a folder with a mesh ({', '.join(_MESHES)}) named as a link: {names}",
        )
    for link in shown:
        for visual in link.findall("visual"):
            link.remove(visual)
        visual = ET.SubElement(link, "visual")
        uri = meshes[link.attrib["name"]].resolve().as_uri()
        ET.SubElement(ET.SubElement(visual, "geometry"), "mesh", filename=uri)


def wheel_mass(rover: RoverSettings) -> float:
    """Return the mass of a ring with a wheel's spin inertia [kg]."""
    return rover.wheel_drive.wheel_inertia / rover.wheels.radius**2


def _bodies(robot: ET.Element, rover: RoverSettings) -> None:
    mass, centre, tensor = _body1_without_wheels(rover)
    link = _link(robot, machine.BODY1_FRAME, mass, centre, tensor)
    _shape(link, "box", BODY1_COLOUR, rover.body1_centre, size=_text(rover.body1_size))
    _joint(robot, "tether", "floating", machine.WORLD_FRAME, machine.BODY1_FRAME, _ORIGIN)
    slider = rover.slider
    middle = rover.body2_place(slider.free_length).tolist()
    parent, child = machine.BODY1_FRAME, machine.BODY2_FRAME
    joint = _joint(robot, machine.JUMP_SLIDER, "prismatic", parent, child, middle, axis=_Z)
    if rover.is_single_body:  # its frame stays, without mass and shape
        _link(robot, machine.BODY2_FRAME, 0.0, _ORIGIN, np.zeros((3, 3)))
        ET.SubElement(joint, "limit", lower="0", upper="0", effort="0", velocity="0")
        return
    link = _link(robot, machine.BODY2_FRAME, rover.m2, _ORIGIN, np.diag(rover.inertia2))
    _shape(link, "box", BODY2_COLOUR, size=_text(rover.body2_size))
    stroke = rover.jump_drive.stroke
    reduced = rover.m1 * rover.m2 / rover.mass
    ET.SubElement(
        joint,
        "limit",
        lower=_number(-slider.lower_stop),
        upper="0",
        effort=_number(slider.spring_rate * stroke),
        velocity=_number(stroke * math.sqrt(slider.spring_rate / reduced)),
    )


def _body1_without_wheels(rover: RoverSettings) -> tuple[float, Array, Array]:
    """Return mass [kg], centre of mass in base_link [m] and inertia about it [kg m^2], (3, 3)."""
    mass = rover.m1 - 2.0 * wheel_mass(rover)
    tensor = np.diag(rover.inertia1)
    tensor[0, 0] += rover.jump_drive.inertia  # the flywheel spins about x
    moment = np.zeros(3)
    for place in (rover.wheels.left, rover.wheels.right):
        own = _wheel_tensor(rover)
        own[1, 1] = 0.0  # the scenario's inertias exclude the wheels' spin
        tensor = tensor - own - _of_point(wheel_mass(rover), np.array(place))
        moment -= wheel_mass(rover) * np.array(place)
    centre = moment / mass
    return mass, centre, tensor - _of_point(mass, centre)


def _of_point(mass: float, place: Array) -> Array:
    return np.asarray(mass * (np.dot(place, place) * np.eye(3) - np.outer(place, place)))


def _wheel_tensor(rover: RoverSettings) -> Array:
    spin = rover.wheel_drive.wheel_inertia
    across = 0.5 * spin + wheel_mass(rover) * rover.wheels.width**2 / 12.0
    return np.diag([across, spin, across])


def _wheel(robot: ET.Element, rover: RoverSettings, name: str, place: Sequence[float]) -> None:
    link = _link(robot, name, wheel_mass(rover), _ORIGIN, _wheel_tensor(rover))
    _cylinder(link, WHEEL_COLOUR, rover.wheels.tip_radius, rover.wheels.width)
    _joint(robot, name, "continuous", machine.BODY1_FRAME, name, place, axis=_Y)


def _drum(robot: ET.Element, winch: WinchSettings) -> None:
    # A solid cylinder; the tether leaves it at the fairlead.
    mass = 2.0 * winch.drum_inertia / winch.radius**2
    across = 0.5 * winch.drum_inertia + mass * _DRUM_WIDTH**2 / 12.0
    tensor = np.diag([across, winch.drum_inertia, across])
    link = _link(robot, machine.WINCH_DRUM, mass, _ORIGIN, tensor)
    _cylinder(link, _DRUM_COLOUR, winch.radius, _DRUM_WIDTH)
    place = (-winch.radius, 0.0, 0.0)
    _joint(
        robot,
        machine.WINCH_DRUM,
        "continuous",
        machine.WORLD_FRAME,
        machine.WINCH_DRUM,
        place,
        axis=_Y,
    )


# --- elements ---------------------------------------------------------------------------


def _link(
    robot: ET.Element,
    name: str,
    mass: float = 0.0,
    centre: Sequence[float] | Array = _ORIGIN,
    tensor: Array | None = None,
) -> ET.Element:
    link = ET.SubElement(robot, "link", name=name)
    if tensor is not None:
        inertial = ET.SubElement(link, "inertial")
        ET.SubElement(inertial, "origin", xyz=_text(centre), rpy="0 0 0")
        ET.SubElement(inertial, "mass", value=_number(mass))
        parts = {
            f"i{a}{b}": _number(float(tensor["xyz".index(a), "xyz".index(b)]))
            for a, b in ("xx", "xy", "xz", "yy", "yz", "zz")
        }
        ET.SubElement(inertial, "inertia", parts)
    return link


def _shape(
    link: ET.Element,
    kind: str,
    colour: Colour,
    place: Sequence[float] = _ORIGIN,
    turned: Sequence[float] = _ORIGIN,
    **size: str,
) -> None:
    for use in ("visual", "collision"):
        element = ET.SubElement(link, use)
        ET.SubElement(element, "origin", xyz=_text(place), rpy=_text(turned))
        ET.SubElement(ET.SubElement(element, "geometry"), kind, size)
        if use == "visual":
            material = ET.SubElement(element, "material", name=f"{link.get('name')}_colour")
            ET.SubElement(material, "color", rgba=_text(colour))


def _cylinder(link: ET.Element, colour: Colour, radius: float, width: float) -> None:
    turned = (_QUARTER, 0.0, 0.0)
    _shape(link, "cylinder", colour, turned=turned, radius=_number(radius), length=_number(width))


def _joint(
    robot: ET.Element,
    name: str,
    kind: str,
    parent: str,
    child: str,
    place: Sequence[float],
    turned: Sequence[float] = _ORIGIN,
    axis: Sequence[float] | None = None,
) -> ET.Element:
    joint = ET.SubElement(robot, "joint", name=name, type=kind)
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    ET.SubElement(joint, "origin", xyz=_text(place), rpy=_text(turned))
    if axis is not None:
        ET.SubElement(joint, "axis", xyz=_text(axis))
    return joint


def _number(value: float) -> str:
    return format(value, ".12g")


def _text(values: Sequence[float] | Array) -> str:
    return " ".join(_number(float(value)) for value in values)
