"""The visible parts of a robot, read from its description (URDF)."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from rover_bags.views.perspective import Array, box, cylinder, sphere

_GREY = (0.5, 0.5, 0.5)


@dataclass(frozen=True)
class Part:
    """A visible part.

    Attributes:
        link: moving link that carries it; fixed joints are resolved.
        faces: arrays of polygons in the link's frame [m], (K, M, 3) each.
        colour: red, green, blue in 0..1.
    """

    link: str
    faces: tuple[Array, ...]
    colour: tuple[float, ...]


@dataclass(frozen=True)
class Joint:
    """A joint to a parent link: place and orientation of the child at zero, and its axis."""

    parent: str
    place: Array
    rotation: Array
    axis: Array


@dataclass(frozen=True)
class Robot:
    """Parts and joints of a robot; joints by their child link."""

    parts: tuple[Part, ...]
    joints: dict[str, Joint]


def read_robot(text: str) -> Robot:
    """Read boxes, cylinders and spheres, and the joints.

    Raises:
        ValueError: the text is no URDF.
    """
    try:
        root = ET.fromstring(text)
        joints: dict[str, Joint] = {}
        fixed: dict[str, Joint] = {}
        for element in root.iter("joint"):
            child = _attribute(element.find("child"), "link")
            place, rotation = _origin(element.find("origin"))
            axis = element.find("axis")
            turns_about = np.array([1.0, 0.0, 0.0]) if axis is None else _numbers(axis, "xyz")
            joint = Joint(_attribute(element.find("parent"), "link"), place, rotation, turns_about)
            (fixed if element.get("type") == "fixed" else joints)[child] = joint
        parts = [
            part
            for link in root.iter("link")
            for visual in link.iter("visual")
            if (part := _part(link.get("name", ""), visual, fixed)) is not None
        ]
    except (ET.ParseError, TypeError) as error:
        raise ValueError(f"the robot description cannot be read: {error}") from error
    return Robot(tuple(parts), joints)


def _part(link: str, visual: ET.Element, fixed: dict[str, Joint]) -> Part | None:
    place, rotation = _origin(visual.find("origin"))
    passed: set[str] = set()
    while link in fixed:
        if link in passed:
            raise ValueError(f"the robot description has a circle of fixed joints at {link}")
        passed.add(link)
        mount = fixed[link]
        place = mount.place + mount.rotation @ place
        rotation, link = mount.rotation @ rotation, mount.parent
    shape = next(iter(visual.find("geometry") or ()), None)
    if shape is None:
        return None
    if shape.tag == "box":
        faces = box(_numbers(shape, "size"))
    elif shape.tag == "cylinder":
        faces = cylinder(float(shape.get("radius", "")), float(shape.get("length", "")))
    elif shape.tag == "sphere":
        faces = sphere(float(shape.get("radius", "")))
    else:
        return None  # meshes lie outside the bag
    colour = visual.find("material/color")
    rgb = _GREY if colour is None else tuple(_numbers(colour, "rgba")[:3].tolist())
    return Part(link, tuple(each @ rotation.T + place for each in faces), rgb)


def _origin(element: ET.Element | None) -> tuple[Array, Array]:
    if element is None:
        return np.zeros(3), np.eye(3)
    turned = Rotation.from_euler("xyz", _numbers(element, "rpy")).as_matrix()
    return _numbers(element, "xyz"), np.asarray(turned)


def _numbers(element: ET.Element, name: str) -> Array:
    return np.array([float(word) for word in element.get(name, "0 0 0").split()])


def _attribute(element: ET.Element | None, name: str) -> str:
    return "" if element is None else element.get(name, "")
