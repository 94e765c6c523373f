"""Model of an arm in Exudyn: a floating frame of reference for every flexible link, the model class of the paper.

A link is an `ObjectFFRFreducedOrder`. Its "mesh" consists of the mass points of our beam elements and its modes are
the shapes of their node coordinates, so that mass, rotary inertia and stiffness equal ours. The frame is located at
the joint. Four additional massless points on the section at the tip are the mesh nodes of a `MarkerSuperElementRigid`,
which provides the rotation of the tip by the exponential map. Rotations are Euler parameters: with Tait-Bryan angles
(`NodeRigidBodyRxyz`) the same model converges to a different motion, 9 mm away after half a second.

A motor is a scalar inertia connected by a spring (Eq. 23 of the paper), which requires the joint angle as a coordinate.
Exudyn measures joint angles between rigid bodies only (`MarkerBodiesRelativeRotationCoordinate`). Therefore a massless
body is attached to every tip, and another shares its node with the frame of the next link. The model runs compiled,
without user functions.

For links that bend out of one plane the converged tip differs from ours by a few millimetres, since the angular
velocity of the marker is not exactly the rate of its rotation; in planar motion both agree.
"""

import io
import sys
import time
from contextlib import redirect_stdout, suppress
from importlib import import_module
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix

from flexman_gym.common.arrays import Array, Vector
from flexman_gym.common.errors import value_error
from flexman_gym.model.beam import Beam, build_beam
from flexman_gym.model.element import section_points
from flexman_gym.scene.arm import Arm
from flexman_gym.scene.joint import Joint
from flexman_gym.scene.scene import Scene
from flexman_gym.scene.signals import ConstantTorque
from flexman_gym.toolbox.precision.peers.peer_run import PeerRun, check_modelled, output_count, peer_row
from flexman_gym.toolbox.precision.runs import PrecisionRow, PrecisionScene, ReferenceSolution, Timer

sys.exudynFast = True  # type: ignore[attr-defined]  # selects the build without range checks; must precede the first import
with redirect_stdout(io.StringIO()):
    exudyn: Any = import_module("exudyn")
    items: Any = import_module("exudyn.itemInterface")
    fem: Any = import_module("exudyn.FEM")

ELEMENTS = 2
MODEL = "Exudyn, floating frame"
QUICK, DEFAULT = "quickest settings", "default settings"
STEPS = {QUICK: (5e-3, 2.5e-3, 2e-3, 1e-3, 5e-4), DEFAULT: (2.5e-3, 2e-3, 1e-3)}
FINE, STRICT = 1e-4, 1e-8  # step (s) and relative Newton tolerance of the converged run
LOOSE = 1e-3  # relative Newton tolerance whose effect on the tip is below that of the step, unlike 1e-2


class System:
    """`MainSystem` of an arm at rest at zero angles, with motor torques (n,) N m and a sensor of its tip."""

    def __init__(self, arm: Arm, torque: Vector, elements: int = ELEMENTS) -> None:
        if arm.payload is not None or any(joint.stiffness is None for joint in arm.joints):
            raise value_error("arm", "a payload or rigid joints", "springs in all joints and no payload for Exudyn")
        self.container = exudyn.SystemContainer()
        self.main = self.container.AddSystem()
        carrier = self.main.AddObject(items.ObjectGround())
        place, tip = np.zeros(3), 0
        for i, (link, joint) in enumerate(zip(arm.links, arm.joints, strict=True)):
            if i:
                carrier = self._tip_body(place, tip)
            frame, tip = self._link(link, build_beam(link, elements), place, arm.gravity)
            self._joint(joint, carrier, frame, torque[i])
            place = place + np.array(link.orientation)[:, 0] * link.length
        kind = exudyn.OutputVariableType.Position
        sensor = items.SensorMarker(markerNumber=tip, outputVariableType=kind, storeInternal=True, writeToFile=False)
        self.sensor = self.main.AddSensor(sensor)
        self.main.Assemble()

    def tip(self) -> Array:
        """Return the tip positions (T, 3) m at the output times reached by the last run."""
        return np.asarray(self.main.GetSensorStoredData(self.sensor))[:, 1:]

    def _link(self, link: Any, beam: Beam, place: Array, gravity: Vector) -> tuple[int, int]:
        """Add a link; return the object number of a rigid body in its frame and the marker number of its tip."""
        turn, (masses, positions, shapes) = np.array(link.orientation), _mesh(link, beam)
        mesh, count = fem.FEMinterface(), 3 * len(masses)
        mesh.nodes = {"Position": positions @ turn.T}
        mesh.massMatrix = csr_matrix(np.diag(np.repeat(masses, 3)))
        mesh.stiffnessMatrix = csr_matrix((count, count))
        mesh.modeBasis = {"matrix": (turn @ shapes).reshape(count, -1), "type": "NormalModes"}
        terms = fem.ObjectFFRFreducedOrderInterface(mesh, rigidBodyNodeType=exudyn.NodeType.RotationEulerParameters)
        terms.stiffnessMatrixReduced = beam.stiffness
        result = terms.AddObjectFFRFreducedOrder(
            self.main, positionRef=list(place), rotationMatrixRef=np.eye(3), gravity=list(gravity)
        )
        frame = items.ObjectRigidBody(mass=0.0, inertia=[0.0] * 6, nodeNumber=result["nRigidBody"])
        end = range(len(masses) - 4, len(masses))
        marker = items.MarkerSuperElementRigid(
            bodyNumber=result["oFFRFreducedOrder"], meshNodeNumbers=list(end), weightingFactors=[0.25] * 4
        )
        return self.main.AddObject(frame), self.main.AddMarker(marker)

    def _tip_body(self, place: Array, tip: int) -> int:
        """Add a massless rigid body fixed to the marker of a tip; return its object number."""
        node = self.main.AddNode(items.NodeRigidBodyEP(referenceCoordinates=[*place, 1.0, 0.0, 0.0, 0.0]))
        body = self.main.AddObject(items.ObjectRigidBody(mass=0.0, inertia=[0.0] * 6, nodeNumber=node))
        marker = self.main.AddMarker(items.MarkerBodyRigid(bodyNumber=body))
        self.main.AddObject(items.ObjectJointGeneric(markerNumbers=[tip, marker]))
        return int(body)

    def _joint(self, joint: Joint, before: int, behind: int, torque: float) -> None:
        """Add a revolute joint between two rigid bodies, driven by a motor through a spring and a damper."""
        axis = exudyn.HT(rotation=_along(np.array(joint.axis)), translation=[0.0] * 3)
        ends = [self.main.AddMarker(items.MarkerBodyRigid(bodyNumber=body, localHT=axis)) for body in (before, behind)]
        self.main.AddObject(items.ObjectJointRevoluteZ(markerNumbers=ends))
        rotor = self.main.AddNode(items.Node1D())
        self.main.AddObject(items.ObjectMass1D(mass=joint.rotor_inertia, nodeNumber=rotor))
        motor = self.main.AddMarker(items.MarkerNodeCoordinate(nodeNumber=rotor, coordinate=0))
        self.main.AddLoad(items.LoadCoordinate(markerNumber=motor, load=torque))
        turns = self.main.AddNode(items.NodeGenericData(numberOfDataCoordinates=1, initialCoordinates=[0.0]))
        angle = self.main.AddMarker(
            items.MarkerBodiesRelativeRotationCoordinate(
                bodyNumbers=[before, behind], nodeNumber=turns, axis0=list(joint.axis)
            )
        )
        spring = {"stiffness": joint.stiffness, "damping": joint.damping}
        self.main.AddObject(items.ObjectConnectorCoordinateSpringDamper(markerNumbers=[motor, angle], **spring))


def _mesh(link: Any, beam: Beam) -> tuple[Array, Array, Array]:
    """Return masses (p,) kg, positions (p, 3) m and shapes (p, 3, k) of the points of a beam and of four at its tip."""
    arms = np.column_stack([np.zeros(4), section_points(link.sections[-1])])
    turned = np.cross(beam.tip_rotation[None], arms[:, :, None], axis=1)
    return (
        np.concatenate([beam.masses, np.zeros(4)]),
        np.vstack([beam.positions, arms + np.array([link.length, 0.0, 0.0])]),
        np.concatenate([beam.shapes, beam.tip_translation + turned]),
    )


def _along(axis: Array) -> Array:
    """Return a rotation matrix whose z axis is the given unit vector."""
    across = np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis)
    across /= np.linalg.norm(across)
    return np.column_stack([across, np.cross(axis, across), axis])


def settings(scene: Scene, step: float, method: str, tolerance: float = LOOSE) -> Any:
    """Return `SimulationSettings` of a fixed-step run (step in s) without file output.

    The default settings of Exudyn are the generalised-alpha method with a spectral radius of 0.9, modified Newton
    iterations with a tolerance of 1e-8, and its own dense solver. The fastest settings for this arm, among tolerances
    from 1e-2 to 1e-8, solvers, full Newton iterations and other spectral radii, change the tolerance to 1e-3 and the
    solver to Eigen's dense solver. The trapezoidal rule has the same cost, and with constraints of index 2 the tip
    bodies drift.
    """
    result = exudyn.SimulationSettings()
    rows, substeps = output_count(scene, step)
    result.timeIntegration.endTime, result.timeIntegration.numberOfSteps = scene.duration, rows * substeps
    result.timeIntegration.verboseMode, result.timeIntegration.adaptiveStep = 0, False
    result.solution.file.write, result.solution.sensors.writePeriod = False, scene.output_step
    if method != DEFAULT:
        result.timeIntegration.newton.relativeTolerance = tolerance
        result.linearSolver.solverType = exudyn.LinearSolverType.EigenDense
    return result


def run(scene: Scene, step: float, method: str = QUICK, tolerance: float = LOOSE) -> PeerRun:
    """Run a scene of constant torques from rest at zero angles; the step (s) must divide the output step."""
    check_modelled(scene)
    if not isinstance(scene.torque, ConstantTorque) or any((*scene.initial.joint_angles, *scene.initial.joint_rates)):
        raise value_error("scene", scene.note or "a motion", "constant torques from rest at zero angles for Exudyn")
    system = System(scene.arm, scene.torque.value)
    chosen = settings(scene, step, method, tolerance)
    tip = np.full((output_count(scene, step)[0] + 1, 3), np.nan)
    exudyn.config.printToConsole = False
    started = time.process_time(), time.perf_counter()
    with suppress(exudyn.SolverError):  # a failed run is detected by its missing tip positions
        system.main.SolveDynamic(chosen)
    spent = time.process_time() - started[0], time.perf_counter() - started[1]
    known = system.tip()[: len(tip)]
    tip[: len(known)] = known
    costs = [seconds / max(len(known) - 1, 1) / scene.output_step for seconds in spent]
    iterations = system.main.sys["dynamicSolver"].it.newtonStepsCount / scene.duration
    return PeerRun(MODEL, method, step, tip, costs[0], costs[1], iterations)


def converged(scene: Scene) -> ReferenceSolution:
    """Return Exudyn's solution at a short step; its error estimate is the difference to a step 2.5 times as long."""
    fine, coarse = (run(scene, step, QUICK, STRICT) for step in (FINE, 2.5 * FINE))
    return ReferenceSolution(fine.tip, fine.distance(coarse.tip), f"{MODEL}, {1e3 * FINE:g} ms")


def runs(scene: PrecisionScene) -> list[Timer]:
    """Return timers of runs with the fastest and the default settings; time errors refer to Exudyn's converged run."""
    solution = converged(scene.scene)

    def timed(method: str, step: float) -> PrecisionRow:
        return peer_row(scene, run(scene.scene, step, method), solution)

    return [lambda a=(method, step): timed(*a) for method, steps in STEPS.items() for step in steps]  # type: ignore[misc]
