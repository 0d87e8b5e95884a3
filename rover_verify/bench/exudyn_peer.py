"""The peer of the bench: the same tether and rover built from Exudyn's own C++ elements.

Exudyn (Gerstmayr 2023, Multibody System Dynamics 60) has the planar thin ANCF cable as
`ObjectANCFCable2D`, whose axial strain is |r'| - 1 where ours is Green's strain. Strain models of
one's own would need Python callbacks in every evaluation, so the bench keeps the built-in one,
and each code's error is measured against its own converged solution. In the pendulum and in the
jump the strains are so small that both codes follow the same motion to micrometres; in the jump
that stretches its tether by percents the motions differ by millimetres.
"""

from __future__ import annotations

import contextlib
import io
import itertools
import math
import sys
import time
import warnings
from typing import Any

import numpy as np

from rover_sim import PlanarPlant, PlanarState, Scenario
from rover_verify.bench.trial import SAMPLE, BenchSetting, Trial

# A pin as a spring, for the explicit integrators (see `settings_of`) [N/m].
PIN_STIFFNESS = 1e4


def load() -> tuple[Any, Any] | None:
    """Exudyn and its item interface, or None where it is not installed.

    The variant without range checks is asked for, as a user after speed would.
    """
    sys.exudynFast = True  # type: ignore[attr-defined]  # read by Exudyn when it is imported
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            import exudyn  # noqa: PLC0415 - optional, and it prints when it is imported
            from exudyn import itemInterface  # noqa: PLC0415
    except ImportError:
        return None
    exudyn.config.suppressWarnings = True
    # What fails to converge is counted; messages would interrupt the table.
    exudyn.config.printToConsole = False
    return exudyn, itemInterface


def version() -> str | None:
    """Exudyn's version, None where it is not installed."""
    loaded = load()
    return None if loaded is None else str(loaded[0].config.Version())


class ExudynModel:
    """One scenario in Exudyn, in the state in which our plant starts.

    Args:
        plant: our plant; Exudyn gets its constants.
        start: the state to start from, a rover having taken off.
        springy_pins: pins as stiff springs, which the explicit integrators need.

    Raises:
        RuntimeError: Exudyn is not installed.
    """

    def __init__(self, plant: PlanarPlant, start: PlanarState, *, springy_pins: bool) -> None:
        loaded = load()
        if loaded is None:
            raise RuntimeError("Exudyn is not installed: pip install exudyn")
        self._exudyn, self._items = loaded
        self._container = self._exudyn.SystemContainer()  # it owns the system
        self._system = self._container.AddSystem()
        self._sensor = self._build(plant.scenario, start, springy_pins)

    def _build(self, scenario: Scenario, start: PlanarState, springy_pins: bool) -> Any:
        """Build the system; returns the sensor of the tether's tip."""
        items, gravity, system = self._items, scenario.gravity, self._system
        section, count = scenario.tether.section, scenario.tether.elements
        length = scenario.tether.length / count
        nodes = []
        for index in range(count + 1):
            reference = [index * length, 0.0, 1.0, 0.0]
            nodes.append(
                system.AddNode(
                    items.NodePoint2DSlope1(
                        referenceCoordinates=reference,
                        initialCoordinates=list(start.nodes[index].ravel() - reference),
                        initialVelocities=list(start.node_rates[index].ravel()),
                    )
                )
            )
        for first, second in itertools.pairwise(nodes):
            cable = system.AddObject(
                items.ObjectANCFCable2D(
                    length=length,
                    massPerLength=section.line_density,
                    bendingStiffness=section.bending_stiffness,
                    axialStiffness=section.axial_stiffness,
                    bendingDamping=section.bending_stiffness * section.bending_damping_time,
                    axialDamping=section.axial_stiffness * section.axial_damping_time,
                    nodeNumbers=[first, second],
                )
            )
            marker = system.AddMarker(items.MarkerBodyMass(bodyNumber=cable))
            system.AddLoad(
                items.LoadMassProportional(markerNumber=marker, loadVector=[0.0, -gravity, 0.0])
            )
        ground = system.AddMarker(
            items.MarkerNodeCoordinate(
                nodeNumber=system.AddNode(items.NodePointGround()), coordinate=0
            )
        )
        for coordinate in (0, 1):
            markers = [
                ground,
                system.AddMarker(
                    items.MarkerNodeCoordinate(nodeNumber=nodes[0], coordinate=coordinate)
                ),
            ]
            if springy_pins:
                pin = items.ObjectConnectorCoordinateSpringDamper(
                    markerNumbers=markers, stiffness=PIN_STIFFNESS
                )
            else:
                pin = items.ObjectConnectorCoordinate(markerNumbers=markers)
            system.AddObject(pin)
        if scenario.rover is not None:
            self._add_rover(system, scenario, start, nodes[-1])
        sensor = system.AddSensor(
            items.SensorNode(
                nodeNumber=nodes[-1],
                outputVariableType=self._exudyn.OutputVariableType.Position,
                storeInternal=True,
                writeToFile=False,
            )
        )
        system.Assemble()
        return sensor

    def _add_rover(self, system: Any, scenario: Scenario, start: PlanarState, tip: Any) -> None:
        items, rover = self._items, scenario.rover
        assert rover is not None
        bodies, markers = [], []
        for centre, rate, mass, inertia in (
            (start.G1, start.G1_rate, rover.m1, rover.inertia1),
            (start.G2, start.G2_rate, rover.m2, rover.inertia2),
        ):
            node = system.AddNode(
                items.NodeRigidBody2D(
                    referenceCoordinates=[*centre, start.theta],
                    initialVelocities=[*rate, start.omega],
                )
            )
            body = system.AddObject(
                items.ObjectRigidBody2D(physicsMass=mass, physicsInertia=inertia, nodeNumber=node)
            )
            marker = system.AddMarker(items.MarkerBodyRigid(bodyNumber=body))
            system.AddLoad(
                items.Force(markerNumber=marker, loadVector=[0.0, -mass * scenario.gravity, 0.0])
            )
            bodies.append(body)
            markers.append(marker)
        system.AddObject(
            items.ObjectJointPrismatic2D(
                markerNumbers=markers, axisMarker0=[0.0, 1.0, 0.0], normalMarker1=[1.0, 0.0, 0.0]
            )
        )
        system.AddObject(
            items.ObjectConnectorSpringDamper(
                markerNumbers=markers,
                referenceLength=rover.spring_free_length,
                stiffness=rover.spring_rate,
                damping=rover.slider_damping,
            )
        )
        attachment = system.AddMarker(
            items.MarkerBodyPosition(bodyNumber=bodies[0], localPosition=[*rover.attachment, 0.0])
        )
        end = system.AddMarker(items.MarkerNodePosition(nodeNumber=tip))
        system.AddObject(items.ObjectJointRevolute2D(markerNumbers=[attachment, end]))

    def run(self, setting: BenchSetting, duration: float) -> Trial | None:
        """Simulate from the start; None if the solver gives up or the motion is not finite."""
        exudyn = self._exudyn
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            options = exudyn.SimulationSettings()
            options.linearSolver.solverType = exudyn.LinearSolverType.EigenSparse
        integration = options.timeIntegration
        integration.numberOfSteps = round(duration / setting.h)
        integration.endTime = duration
        # Give up on a step instead of halving it until the time no longer moves.
        integration.minimumStepSize = setting.h / 16.0
        integration.verboseMode = 0
        integration.stepInformation = 0
        integration.generalizedAlpha.spectralRadius = 0.9
        integration.newton.useModifiedNewton = True
        integration.newton.relativeTolerance = setting.tolerance
        options.solutionSettings.writeSolutionToFile = False
        options.solutionSettings.sensorsWritePeriod = SAMPLE
        options.parallel.numberOfThreads = 1
        method = getattr(exudyn.DynamicSolverType, setting.method)
        began = time.process_time()
        try:
            self._system.SolveDynamic(
                options, solverType=method, updateInitialValues=False, showHints=False
            )
        except (RuntimeError, ValueError):
            return None
        spent = time.process_time() - began
        samples = np.array(self._system.GetSensorStoredData(self._sensor))
        path = samples[:, 1:3]
        complete = len(path) >= 1 + math.floor(duration / SAMPLE + 1e-6)
        if not complete or not np.all(np.isfinite(path)):
            return None
        return Trial(spent, path)
