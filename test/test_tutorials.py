"""What the tutorials build: the lander's pure part, the load cell on a bus, their procedures."""

from __future__ import annotations

import importlib.util
import threading
from types import ModuleType
from typing import Any
from uuid import uuid4

import canopen
import pytest
from documented import ROOT

from msg_schemas.parameters import ParameterError
from rover_hil.bridge.commissioning import mismatch
from rover_hil.canopen.devices import DEVICES, LOAD_CELL
from rover_hil.canopen.dictionary import object_dictionary
from rover_hil.canopen.impairment import read_impairments
from rover_hil.canopen.link import Link, unpack
from rover_hil.canopen.transport import open_bus
from rover_hil.emulator.emulated_machine import EmulatedMachine
from rover_hil.emulator.emulator_node import EmulatorParameters
from rover_hil.rehearsal.procedure import load_procedure
from rover_sim import Simulation, build_interface, build_plant, load_spatial

TUTORIALS = ROOT / "docs" / "tutorials"
PULL = 12.5  # [N]
PATIENCE = 20.0  # [s]


def imported(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, TUTORIALS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


# ---------------------------------------------------------------------------- plain nodes


@pytest.mark.ros
def test_each_run_of_the_node_by_topics_follows_a_request_of_its_own():
    first, second = (imported("lower_by_topics").NAME for _ in range(2))
    assert first != second


# ---------------------------------------------------------------------------- a controller


def test_the_lander_slows_down_before_the_floor_and_stops_on_it():
    lander = imported("lander")
    parameters = lander.LanderParameters()
    own = lander.Lander(parameters)
    length, rate = 4.0, own.rate(4.0, on_ground=False)
    assert rate == parameters.fast
    while length < parameters.floor + 0.2:
        before, length = rate, length + 0.1 * rate
        rate = own.rate(length, on_ground=False)
        assert 0.0 <= before - rate <= 0.11 * parameters.deceleration
    assert rate == pytest.approx(parameters.slow)
    assert own.rate(length, on_ground=True) == 0.0


# ------------------------------------------------------------------------------ a load cell


@pytest.fixture
def ends() -> Any:
    channel = f"bench-{uuid4()}"
    made = [canopen.Network(), canopen.Network()]
    for network in made:
        network.connect(interface="virtual", channel=channel)
    yield made
    for network in made:
        network.disconnect()


def test_the_own_load_cell_answers_as_the_bridge_requires(ends: list[canopen.Network]):
    mine, bridges = ends
    imported("own_load_cell").OwnLoadCell(
        mine, str(ROOT / "rover_hil" / "canopen" / "eds" / "load_cell.eds"), read=lambda: PULL
    )
    node = canopen.RemoteNode(LOAD_CELL.node_id, object_dictionary(LOAD_CELL))
    bridges.add_node(node)
    assert mismatch(node, LOAD_CELL) == ""

    (pdo,) = LOAD_CELL.tpdos
    answers: list[dict[str, int] | None] = []
    answered = threading.Event()

    def receive(_can_id: int, data: bytearray, _timestamp: float) -> None:
        answers.append(unpack(pdo, bytes(data)))
        answered.set()

    bridges.subscribe(pdo.can_id(LOAD_CELL.node_id), receive)
    node.nmt.wait_for_heartbeat(PATIENCE)
    bridges.send_message(0, bytes([1, LOAD_CELL.node_id]))  # NMT: operational
    for counter in range(1, 200):
        bridges.sync.transmit(counter)
        if answered.wait(PATIENCE / 200):
            break
    counts = answers[0]
    assert counts is not None
    assert LOAD_CELL.by_key["tension"].value(counts["tension"]) == pytest.approx(PULL)
    assert counts["sync_counter"] <= counter


@pytest.mark.usefixtures("compiled_in_space")
def test_a_device_that_is_there_itself_is_not_played():
    simulation = Simulation(build_interface(build_plant(load_spatial("free_hang")), 1), 0.005)
    link = Link(open_bus(f"virtual:{uuid4()}"))
    try:
        machine = EmulatedMachine(link, simulation, lambda: 0, lambda: 0, real=("load_cell",))
        machine.power_on()
    finally:
        link.close()
    assert machine.devices.keys() == {each.name for each in DEVICES} - {"load_cell"}
    assert machine.channels.keys() == machine.devices.keys()


@pytest.mark.parametrize(
    ("given", "complaint"),
    [
        ({"real_devices": "camera"}, "'camera' is no device: should be one of jump, wheel"),
        (
            {"real_devices": "imu, load_cell", "impairments": "{kind: cut, target: load_cell}"},
            "targets load_cell, one of the real_devices",
        ),
    ],
)
def test_what_cannot_be_real_is_refused(given: dict[str, Any], complaint: str):
    with pytest.raises(ParameterError, match=complaint):
        EmulatorParameters(**given)


# ------------------------------------------------------------------------------- procedures


@pytest.mark.parametrize("name", ["own_load_cell.yaml", "own_procedure.yaml"])
def test_a_procedure_is_as_it_should_be(name: str):
    assert load_procedure(str(TUTORIALS / name)).procedure.steps


def test_the_storm_is_one():
    kinds = [each.kind for each in read_impairments(str(TUTORIALS / "storm.yaml"))]
    assert kinds == ["loss", "jitter", "cut"]
