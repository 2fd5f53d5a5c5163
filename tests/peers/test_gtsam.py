"""The smoother beside GTSAM's: one sensor with biases and a rough start, and landmarks that are known.

Both are given the same measurements and priors. GTSAM preintegrates between views by rectangles,
which get samples at their middles, four thousand per second (a thousand leave 1 % of a standard
deviation). Noise within the sensor is left out: the smoother has it as hat functions over time and
GTSAM as a step at each view, which is not the same.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.values import FloatArray
from legsim.correction import smoother
from legsim.correction.error_state import error_state
from legsim.correction.path_measurements import FiducialShadows
from legsim.correction.rough_start import StartErrors, rough
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.imu.errors import SensorErrors, TriadErrors
from legsim.imu.signals import ImuSignals, SensorStart
from tests.peers.agreement import Check
from tests.references.sway import GRAVITY, Sway

pytestmark = pytest.mark.peer

VIEWS = np.arange(13) / 5
SAMPLES = np.arange(-60, 700) / 200
SWAY = Sway.standing(5, position_mm=4.0, angle_deg=1.0)
LANDMARKS = 0.03 * np.concatenate([np.zeros((1, 3)), np.eye(3)])
FORCE_BIAS, TURN_BIAS = np.array([0.08, -0.05, 0.11]), np.array([0.008, 0.012, -0.006])
SENSOR = SensorErrors(TriadErrors(turn_on_bias=0.1), TriadErrors(turn_on_bias=0.01))
START = StartErrors(0.004, 0.008, 0.03, 0.005)
PX = 0.3
GEOMETRY = ConeBeamGeometry.circular(
    times=VIEWS,
    angles=np.radians(15) * np.arange(len(VIEWS)),
    source_isocenter=0.78,
    source_detector=1.198,
    shape_vu=(240, 310),
    pixel_pitch=1.232e-3,
    isocenter=SWAY.center,
)


@dataclass(frozen=True)
class Found:
    """An estimate and its standard deviations."""

    poses: FloatArray
    """(v, 4, 4)"""
    biases: FloatArray
    """(6,) of accelerometer and gyroscope"""
    places_sd: FloatArray
    """(v, 3) m in world"""
    turns_sd: FloatArray
    """(v, 3) rad in world"""
    biases_sd: FloatArray


@pytest.fixture(scope="module")
def gtsam() -> ModuleType:
    return pytest.importorskip("gtsam")


@pytest.fixture(scope="module")
def measured() -> tuple[SensorStart, FloatArray]:
    """A rough start, and the landmarks' shadows with errors that no estimate doubts."""
    rng = np.random.default_rng(8)
    (drawn,) = rough([SensorStart(SWAY.poses(VIEWS[:1])[0], np.zeros(3))], START, rng)
    start = replace(drawn, velocity=SWAY.velocities(VIEWS[:1])[0] + 0.02)
    exact = GEOMETRY.project(transforms.apply(SWAY.poses(VIEWS), LANDMARKS))[0]
    return start, exact + PX * rng.uniform(-np.sqrt(3), np.sqrt(3), exact.shape)


def by_legsim(start: SensorStart, pixels: FloatArray) -> Found:
    rate, force = SWAY.signals(SAMPLES)
    signals = ImuSignals(
        SAMPLES, ("s",), (rate + TURN_BIAS)[:, None], (force + FORCE_BIAS)[:, None]
    )
    state = error_state(signals, "s", start, VIEWS, SENSOR, START)
    shadows = FiducialShadows(pixels, LANDMARKS, PX)
    found = smoother.smooth(state, geometry=GEOMETRY, fiducials=shadows)
    assert found.settled
    gyroscope = 9 + state.force_errors.shape[-1]
    of_biases = [*range(9, 12), *range(gyroscope, gyroscope + 3)]
    sizes = np.repeat([0.1, 0.01], 3)
    at = found.path.of_attached(np.zeros((1, 3)))[:, 0]
    places, turns = (
        np.sqrt(np.einsum("vin,nm,vim->vi", by, found.covariance, by))
        for by in (at, found.path.twists[:, :3])
    )
    own = np.sqrt(np.diag(found.covariance)[of_biases])
    return Found(found.path.poses, sizes * found.errors[of_biases], places, turns, sizes * own)


def by_gtsam(gtsam: ModuleType, start: SensorStart, pixels: FloatArray) -> Found:
    """Levenberg and Marquardt's rule, with preintegration anew at each bias that it finds."""
    values, biases = _first(gtsam, start), np.zeros(6)
    precise = gtsam.LevenbergMarquardtParams()
    precise.setLinearSolverType("MULTIFRONTAL_QR")
    precise.setRelativeErrorTol(1e-14)
    for _ in range(4):
        graph = _graph(gtsam, start, pixels, biases)
        values = gtsam.LevenbergMarquardtOptimizer(graph, values, precise).optimize()
        biases = values.atConstantBias(_key("b")).vector()
    poses = np.stack([values.atPose3(_key("x", k)).matrix() for k in range(len(VIEWS))])
    covariance = _covariance(_graph(gtsam, start, pixels, biases).linearize(values))
    # by key: the biases, velocities, then poses in their own axes, turn before shift
    blocks = [
        covariance[s : s + 6, s : s + 6] for s in range(6 + 3 * len(VIEWS), len(covariance), 6)
    ]
    turns, places = (
        np.stack(
            [
                np.sqrt(np.diag(pose[:3, :3] @ c[part, part] @ pose[:3, :3].T))
                for pose, c in zip(poses, blocks, strict=True)
            ]
        )
        for part in (slice(0, 3), slice(3, 6))
    )
    return Found(poses, biases, places, turns, np.sqrt(np.diag(covariance)[:6]))


def _covariance(linear: Any) -> FloatArray:
    """Of all variables of a linearized graph, whose factors differ by ten powers of ten: dense,
    since GTSAM's own marginals square that.
    """
    rows, _ = linear.jacobian()
    back = np.linalg.inv(np.linalg.qr(rows)[1])
    return back @ back.T


def _key(letter: str, index: int = 0) -> int:
    """As gtsam.symbol."""
    return (ord(letter) << 56) + index


def _first(gtsam: ModuleType, start: SensorStart) -> Any:
    """The true path, moved to the rough start: both estimates are at the same least."""
    values, path = gtsam.Values(), SWAY.poses(VIEWS)
    off = start.world_from_sensor @ transforms.inverse(path[0])
    for k, pose in enumerate(off @ path):
        values.insert(_key("x", k), gtsam.Pose3(pose))
        values.insert(_key("v", k), SWAY.velocities(VIEWS[k : k + 1])[0])
    values.insert(_key("b"), gtsam.imuBias.ConstantBias())
    return values


def _graph(gtsam: ModuleType, start: SensorStart, pixels: FloatArray, biases: FloatArray) -> Any:
    graph, noise = gtsam.NonlinearFactorGraph(), gtsam.noiseModel
    params = gtsam.PreintegrationParams(GRAVITY)
    params.setAccelerometerCovariance(1e-12 * np.eye(3))
    params.setGyroscopeCovariance(1e-14 * np.eye(3))
    params.setIntegrationCovariance(1e-14 * np.eye(3))
    hat = gtsam.imuBias.ConstantBias(biases[:3], biases[3:])
    rotation = start.world_from_sensor[:3, :3]
    # turns of the start are of world; a pose of GTSAM's changes in its own axes
    turned = rotation.T @ np.diag(START.sigmas[:3] ** 2) @ rotation
    spread = np.zeros((6, 6))
    spread[:3, :3], spread[3:, 3:] = turned, START.place**2 * np.eye(3)
    graph.add(
        gtsam.PriorFactorPose3(
            _key("x"), gtsam.Pose3(start.world_from_sensor), noise.Gaussian.Covariance(spread)
        )
    )
    still = noise.Isotropic.Sigma(3, START.velocity)
    graph.add(gtsam.PriorFactorVector(_key("v"), start.velocity, still))
    sizes = noise.Diagonal.Sigmas(np.repeat([0.1, 0.01], 3))
    graph.add(gtsam.PriorFactorConstantBias(_key("b"), gtsam.imuBias.ConstantBias(), sizes))
    for k, (begin, end) in enumerate(pairwise(VIEWS)):
        between = gtsam.PreintegratedImuMeasurements(params, hat)
        middles, step = _middles(begin, end)
        for turn, force in zip(*SWAY.signals(middles), strict=True):
            between.integrateMeasurement(force + FORCE_BIAS, turn + TURN_BIAS, step)
        keys = (_key("x", k), _key("v", k), _key("x", k + 1), _key("v", k + 1), _key("b"))
        graph.add(gtsam.ImuFactor(*keys, between))
    for k, seen in enumerate(pixels):
        graph.add(_shadows(gtsam, _key("x", k), GEOMETRY.matrices[k], seen))
    return graph


def _middles(begin: float, end: float) -> tuple[FloatArray, float]:
    count = round((end - begin) * 4000)
    step = (end - begin) / count
    return np.asarray(begin + step * (np.arange(count) + 0.5), float), step


def _shadows(gtsam: ModuleType, key: int, matrix: FloatArray, seen: FloatArray) -> Any:
    """All landmarks in one view."""

    def error(_: object, values: Any, jacobians: Any) -> FloatArray:
        pose = values.atPose3(key).matrix()
        arms = LANDMARKS @ pose[:3, :3].T
        homogeneous = (arms + pose[:3, 3]) @ matrix[:, :3].T + matrix[:, 3]
        pixel, depth = homogeneous[:, :2] / homogeneous[:, 2:], homogeneous[:, 2, None, None]
        if jacobians is not None:
            by_point = (matrix[:2, :3] - pixel[..., None] * matrix[2, :3]) / depth
            by_own = by_point @ pose[:3, :3]
            by_turn = by_own @ -transforms.cross_matrix(LANDMARKS)
            jacobians[0] = np.asfortranarray(np.concatenate([by_turn, by_own], -1).reshape(-1, 6))
        return (pixel - seen).ravel()

    size = gtsam.noiseModel.Isotropic.Sigma(2 * len(LANDMARKS), PX)
    return gtsam.CustomFactor(size, [key], error)


def test_both_find_the_same_path_and_biases(
    gtsam: ModuleType, measured: tuple[SensorStart, FloatArray], agree: Check
):
    ours, theirs = by_legsim(*measured), by_gtsam(gtsam, *measured)
    apart = (ours.poses - theirs.poses)[:, :3, 3] / ours.places_sd
    between = ours.poses[:, :3, :3] @ np.swapaxes(theirs.poses[:, :3, :3], -1, -2)
    turned = transforms.vector_from_rotation(between) / ours.turns_sd
    biased = (ours.biases - theirs.biases) / ours.biases_sd
    for what, off in (("places", apart), ("turns", turned), ("biases", biased)):
        agree(f"smoothed {what}", "GTSAM", 100 * float(np.abs(off).max()), 1.0, "% of the s.d.")


def test_both_are_as_sure_of_it(
    gtsam: ModuleType, measured: tuple[SensorStart, FloatArray], agree: Check
):
    ours, theirs = by_legsim(*measured), by_gtsam(gtsam, *measured)
    for what in ("places_sd", "turns_sd", "biases_sd"):
        ratio = getattr(ours, what) / getattr(theirs, what)
        off = 100 * float(np.abs(ratio - 1).max())
        agree(f"standard deviations, {what.removesuffix('_sd')}", "GTSAM", off, 1.0, "%")


def test_they_are_near_the_truth(measured: tuple[SensorStart, FloatArray]):
    ours = by_legsim(*measured)
    off = (ours.poses - SWAY.poses(VIEWS))[:, :3, 3] / ours.places_sd
    assert np.abs(off).max() < 4
    assert np.abs((ours.biases - [*FORCE_BIAS, *TURN_BIAS]) / ours.biases_sd).max() < 4
