"""OpenSim at work on the same leg: poses and inverse kinematics, for the peer tests and the
benchmark. Needs `pip install opensim`.
"""

# opensim is an extra (peer)
# pyright: reportMissingImports=false
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import opensim

from legsim.core.values import FloatArray
from legsim.kinematics.leg_model import COORDINATES
from legsim.kinematics.marker_sites import MarkerSites
from legsim.kinematics.skeleton import SEGMENTS, SegmentScales
from legsim.mocap import opensim as storage
from legsim.mocap import trc
from legsim.mocap.trajectories import JointTrajectories, MarkerTrajectories

BODIES = tuple(name for name in SEGMENTS if not name.startswith("patella"))
"""gait2392 has no patella"""
HELD = tuple(f"{name}_{side}" for name in ("subtalar_angle", "mtp_angle") for side in "rl")
"""coordinates that gait2392's IK set-up holds at zero by tasks of weight 1000"""
BACK = ("lumbar_extension", "lumbar_bending", "lumbar_rotation")
"""coordinates of gait2392 that legsim has not"""


@dataclass(frozen=True, slots=True, eq=False)
class OpenSimSolution:
    """What OpenSim's inverse kinematics finds."""

    values: FloatArray
    """(n, 20) rad and m, in legsim's order"""
    markers: FloatArray
    """(n, m, 3) m, the model's markers in world"""
    seconds: float
    """of processor time for the frames alone, without reading and assembling"""


def load(model_file: Path, scales: SegmentScales | None = None) -> opensim.Model:
    """gait2392 without muscles, scaled by OpenSim itself, its back held straight."""
    opensim.Logger.setLevelString("Off")
    model = opensim.Model(str(model_file))
    model.updForceSet().clearAndDestroy()
    if scales is not None:
        factors = opensim.ScaleSet()
        for name in BODIES:
            scale = opensim.Scale()
            scale.setSegmentName(name)
            scale.setScaleFactors(opensim.Vec3(*map(float, scales.of(name))))
            scale.setApply(True)
            factors.cloneAndAppend(scale)
        model.scale(model.initSystem(), factors, False)
    for name in BACK:
        model.updCoordinateSet().get(name).setDefaultLocked(True)
    return model


@dataclass(frozen=True, slots=True, eq=False)
class Postures:
    """What OpenSim makes of random postures of any model."""

    coordinates: tuple[str, ...]
    values: FloatArray
    """(n, c) rad and m; coupled ones by OpenSim's own functions"""
    bodies: dict[str, FloatArray]
    """world_from_body (n, 4, 4) by name"""
    markers: dict[str, FloatArray]
    """(n, 3) m in world by name"""
    centers: dict[str, FloatArray]
    """(n, 3) m in world: the joint of each body, by the body's name"""


def any_model(model_file: Path, factors: Mapping[str, FloatArray] | None = None) -> opensim.Model:
    """A model without its muscles, scaled by OpenSim itself where ``factors`` (3,) by body are
    given.
    """
    opensim.Logger.setLevelString("Off")
    model = opensim.Model(str(model_file))
    model.updForceSet().clearAndDestroy()
    if factors is not None:
        scales = opensim.ScaleSet()
        for name, by in factors.items():
            scale = opensim.Scale()
            scale.setSegmentName(name)
            scale.setScaleFactors(opensim.Vec3(*map(float, by)))
            scale.setApply(True)
            scales.cloneAndAppend(scale)
        model.scale(model.initSystem(), scales, False)
    return model


def random_postures(model: opensim.Model, count: int, rng: np.random.Generator) -> Postures:
    """Bodies and markers of a model at random values inside its ranges, couplers held."""
    model.initSystem()
    coordinates = [model.getCoordinateSet().get(k) for k in range(model.getNumCoordinates())]
    for coordinate in coordinates:
        coordinate.setDefaultLocked(False)
    names = tuple(coordinate.getName() for coordinate in coordinates)
    low, high = np.clip([(c.getRangeMin(), c.getRangeMax()) for c in coordinates], -2.5, 2.5).T
    values = low + (high - low) * rng.random((count, len(names)))
    _couple(model, names, values)
    state = model.initSystem()
    coordinates = [model.getCoordinateSet().get(name) for name in names]
    frames = [model.getBodySet().get(k) for k in range(model.getNumBodies())]
    points = [model.getMarkerSet().get(k) for k in range(model.getNumMarkers())]
    poses = np.tile(np.eye(4), (count, len(frames), 1, 1))
    places = np.empty((count, len(points), 3))
    joints = [model.getJointSet().get(k) for k in range(model.getNumJoints())]
    centers = np.empty((count, len(joints), 3))
    for i, row in enumerate(values):
        for coordinate, value in zip(coordinates, row, strict=True):
            coordinate.setValue(state, float(value), False)
        model.realizePosition(state)
        for k, frame in enumerate(frames):
            poses[i, k] = _matrix(frame.getTransformInGround(state))
        for k, point in enumerate(points):
            place = point.getLocationInGround(state)
            places[i, k] = [place.get(a) for a in range(3)]
        for k, joint in enumerate(joints):
            centers[i, k] = _matrix(joint.getChildFrame().getTransformInGround(state))[:3, 3]
    return Postures(
        names,
        values,
        {frame.getName(): poses[:, k] for k, frame in enumerate(frames)},
        {point.getName(): places[:, k] for k, point in enumerate(points)},
        {
            joint.getChildFrame().findBaseFrame().getName(): centers[:, k]
            for k, joint in enumerate(joints)
        },
    )


def own_markers(
    model: opensim.Model, motion: MarkerTrajectories, names: Sequence[str], *, accuracy: float
) -> tuple[FloatArray, FloatArray]:
    """OpenSim's inverse kinematics by a model's own markers, all of weight 1: values (n, c) of the
    coordinates ``names``, markers (n, m, 3).
    """
    model.initSystem()
    with TemporaryDirectory() as folder:
        path = Path(folder) / "markers.trc"
        trc.save(path, motion)
        weights = opensim.SetMarkerWeights()
        for name in motion.marker_names:
            weights.cloneAndAppend(opensim.MarkerWeight(name, 1.0))
        reference = opensim.MarkersReference(str(path), weights)
    solver = opensim.InverseKinematicsSolver(
        model, reference, opensim.SimTKArrayCoordinateReference()
    )
    solver.setAccuracy(accuracy)
    state = model.initSystem()
    state.setTime(float(motion.times[0]))
    solver.assemble(state)
    coordinates = [model.getCoordinateSet().get(name) for name in names]
    markers = [model.getMarkerSet().get(name) for name in motion.marker_names]
    values = np.empty((len(motion.times), len(names)))
    places = np.empty((len(motion.times), len(markers), 3))
    for i, now in enumerate(motion.times):
        state.setTime(float(now))
        solver.track(state)
        model.realizePosition(state)
        values[i] = [coordinate.getValue(state) for coordinate in coordinates]
        for k, marker in enumerate(markers):
            place = marker.getLocationInGround(state)
            places[i, k] = [place.get(a) for a in range(3)]
    return values, places


def run_tool(model_file: Path, recording: Path, tasks: str, folder: Path) -> JointTrajectories:
    """What OpenSim's inverse kinematics tool finds with a task set (XML), rad and m."""
    setup, result = folder / "setup.xml", folder / "found.mot"
    setup.write_text(
        '<OpenSimDocument Version="30000"><InverseKinematicsTool name="peer">'
        f"<model_file>{model_file}</model_file><marker_file>{recording}</marker_file>"
        f"<constraint_weight>Inf</constraint_weight><accuracy>1e-9</accuracy>{tasks}"
        f"<report_errors>false</report_errors><output_motion_file>{result}</output_motion_file>"
        "</InverseKinematicsTool></OpenSimDocument>"
    )
    opensim.InverseKinematicsTool(str(setup)).run()
    return storage.load(result)


def _couple(model: opensim.Model, names: tuple[str, ...], values: FloatArray) -> None:
    """Sets coupled coordinates (n, c) in place."""
    constraints = model.getConstraintSet()
    for k in range(constraints.getSize()):
        coupler = opensim.CoordinateCouplerConstraint.safeDownCast(constraints.get(k))
        if coupler is not None:
            independent = names.index(coupler.getIndependentCoordinateNames().get(0))
            dependent = names.index(coupler.getDependentCoordinateName())
            function = coupler.getFunction()
            values[:, dependent] = [
                function.calcValue(opensim.Vector(1, float(v))) for v in values[:, independent]
            ]


def _matrix(transform: opensim.Transform) -> FloatArray:
    rotation, origin, matrix = transform.R(), transform.p(), np.eye(4)
    matrix[:3, 3] = [origin.get(a) for a in range(3)]
    matrix[:3, :3] = [[rotation.get(a, b) for b in range(3)] for a in range(3)]
    return matrix


def body_poses(model: opensim.Model, values: FloatArray) -> FloatArray:
    """world_from_body (n, 11, 4, 4) of BODIES at values (n, 20)."""
    state = model.initSystem()
    coordinates = [model.getCoordinateSet().get(name) for name in COORDINATES]
    bodies = [model.getBodySet().get(name) for name in BODIES]
    poses = np.tile(np.eye(4), (len(values), len(bodies), 1, 1))
    for i, row in enumerate(values):
        for coordinate, value in zip(coordinates, row, strict=True):
            coordinate.setValue(state, float(value), False)
        model.realizePosition(state)
        for k, body in enumerate(bodies):
            poses[i, k] = _matrix(body.getTransformInGround(state))
    return poses


def inverse_kinematics(
    model: opensim.Model, sites: MarkerSites, motion: MarkerTrajectories, *, accuracy: float
) -> OpenSimSolution:
    """OpenSim's solution for the markers in ``sites``, subtalar and toe joints held as gait2392's
    set-up does.
    """
    _attach(model, sites)
    state = model.initSystem()
    with TemporaryDirectory() as folder:
        path = Path(folder) / "markers.trc"
        rows = [motion.marker_names.index(name) for name in sites.names]
        trc.save(
            path, MarkerTrajectories(motion.times, sites.names, motion.positions_world[:, rows])
        )
        weights = opensim.SetMarkerWeights()
        for name, weight in zip(sites.names, sites.weights, strict=True):
            weights.cloneAndAppend(opensim.MarkerWeight(name, float(weight)))
        reference = opensim.MarkersReference(str(path), weights)
    held = opensim.SimTKArrayCoordinateReference()
    for name in HELD:
        task = opensim.CoordinateReference(name, opensim.Constant(0.0))
        task.setWeight(1000.0)
        held.push_back(task)
    solver = opensim.InverseKinematicsSolver(model, reference, held)
    solver.setAccuracy(accuracy)
    state.setTime(float(motion.times[0]))
    solver.assemble(state)
    return _track(model, solver, state, sites, motion.times)


def _attach(model: opensim.Model, sites: MarkerSites) -> None:
    model.updMarkerSet().clearAndDestroy()
    for name, segment, position in zip(sites.names, sites.segments, sites.positions, strict=True):
        frame = model.getBodySet().get(segment)
        model.addMarker(opensim.Marker(name, frame, opensim.Vec3(*map(float, position))))
    model.finalizeConnections()


def _track(
    model: opensim.Model,
    solver: opensim.InverseKinematicsSolver,
    state: opensim.State,
    sites: MarkerSites,
    times: FloatArray,
) -> OpenSimSolution:
    coordinates = [model.getCoordinateSet().get(name) for name in COORDINATES]
    markers = [model.getMarkerSet().get(name) for name in sites.names]
    values, places, seconds = (
        np.empty((len(times), len(COORDINATES))),
        np.empty((len(times), len(markers), 3)),
        0.0,
    )
    for i, now in enumerate(times):
        state.setTime(float(now))
        begin = time.process_time()
        solver.track(state)
        seconds += time.process_time() - begin
        model.realizePosition(state)
        values[i] = [coordinate.getValue(state) for coordinate in coordinates]
        for k, marker in enumerate(markers):
            place = marker.getLocationInGround(state)
            places[i, k] = [place.get(a) for a in range(3)]
    return OpenSimSolution(values, places, seconds)


def sensor_signals(
    model: opensim.Model,
    trajectories: JointTrajectories,
    body: str,
    body_from_sensor: FloatArray,
    times: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """(angular velocity, specific force), each (n, 3) in the sensor frame, of OpenSim's IMU
    component while the coordinates follow its own quintic splines (PositionMotion) through the
    samples."""
    table = opensim.TimeSeriesTable()
    table.setColumnLabels(list(COORDINATES))
    for now, row in zip(trajectories.times, trajectories.values, strict=True):
        table.appendRow(float(now), opensim.RowVector([float(v) for v in row]))
    splines, motion = opensim.GCVSplineSet(table), opensim.PositionMotion()
    for name in COORDINATES:
        motion.setPositionForCoordinate(model.getCoordinateSet().get(name), splines.get(name))
    for name in BACK:
        model.updCoordinateSet().get(name).setDefaultLocked(False)
        motion.setPositionForCoordinate(model.getCoordinateSet().get(name), opensim.Constant(0.0))
    # addComponent would crash here
    model.addModelComponent(motion)
    frame = opensim.PhysicalOffsetFrame(
        "sensor", model.getBodySet().get(body), _transform(body_from_sensor)
    )
    model.addComponent(frame)
    sensor = opensim.IMU()
    sensor.setName("imu")
    sensor.connectSocket_frame(frame)
    model.addComponent(sensor)
    state = model.initSystem()
    rate, force = np.empty((len(times), 3)), np.empty((len(times), 3))
    for i, now in enumerate(times):
        state.setTime(float(now))
        _prescribe(model, state, splines, float(now))
        model.realizeAcceleration(state)
        turn, pull = sensor.calcGyroscopeSignal(state), sensor.calcAccelerometerSignal(state)
        rate[i], force[i] = [turn.get(a) for a in range(3)], [pull.get(a) for a in range(3)]
    return rate, force


def _prescribe(
    model: opensim.Model, state: opensim.State, splines: opensim.GCVSplineSet, now: float
) -> None:
    """Values and speeds at a time, which a PositionMotion leaves to the caller; the accelerations
    it sets itself.
    """
    first, at = opensim.StdVectorInt([0]), opensim.Vector(1, now)
    for name in COORDINATES:
        coordinate, spline = model.getCoordinateSet().get(name), splines.get(name)
        coordinate.setValue(state, spline.calcValue(at), False)
        coordinate.setSpeedValue(state, spline.calcDerivative(first, at))


def _transform(matrix: FloatArray) -> opensim.Transform:
    turn = opensim.Rotation(opensim.Mat33(*(float(v) for v in matrix[:3, :3].ravel())))
    return opensim.Transform(turn, opensim.Vec3(*(float(v) for v in matrix[:3, 3])))
