"""Do no harm: a leg that rests, seen by a consumer sensor from a rough start, is left as it is.

Every method of the package is listed: those that promise it, and those that follow a sensor's drift
wherever it leads, which a run warns of.
"""

from dataclasses import replace
from typing import cast

import numpy as np
import pytest
import trimesh

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.correction.articulated_beads import BeadedLeg
from legsim.correction.bead_scan import BeadScan
from legsim.correction.fiducials import Fiducials
from legsim.correction.fused import SensorPriors
from legsim.correction.method import Scan
from legsim.correction.path_measurements import BeadShadows, FiducialShadows
from legsim.correction.rough_start import StartErrors, rough
from legsim.deformation.models import RigidMotion
from legsim.evaluation import residual_motion, similarity
from legsim.evaluation.regions import Region
from legsim.evaluation.residual_motion import Structure
from legsim.geometry.volume import Volume
from legsim.imu.catalogue import load_sensor
from legsim.imu.readout import read_out
from legsim.imu.signals import ImuSignals, SensorStart
from legsim.phantom.meshes import Part, Phantom
from legsim.reconstruction import fdk
from legsim.run import methods
from legsim.simulation.simulated_scan import ScanTruth
from tests.laws.test_methods import (
    DEVICE,
    GRID,
    INPUTS,
    JOINTS,
    KNEE,
    SAMPLES,
    VIEWS,
    Truth,
    bead_places,
    body,
    c_arm,
    exposed,
    with_joints,
)

pytestmark = [
    pytest.mark.end_to_end,
    pytest.mark.filterwarnings("ignore::legsim.reconstruction.weights.ShortScanWarning"),
]

PROMISED = (
    *("uncorrected", "autofocus", "standing", "fused", "fused-beads", "fused-fiducials"),
    *("marker-based", "oracle", "oracle-nonrigid", "articulated-beads", "bones-2d3d"),
)
"""Methods that leave a resting leg as it is, whatever their sensor reads"""
WARNED = ("rigid", "rigid-paper-order", "nonrigid-2d", "nonrigid-3d", "articulated")
"""Methods that follow a sensor by dead reckoning: a run warns where its drift hides a motion"""

BMI160, ROUGH = load_sensor("bmi160").errors, StartErrors()
STILL = RigidMotion.identity(VIEWS)
PX = 0.1
"""error of shadows on this coarse detector, whose pixels are 3 mm wide"""
BONE = KNEE + 1e-3 * np.array(
    [[0.0, 0, 0], [30, -40, 0], [-30, -40, 10], [0, 30, -30], [20, 40, 0]]
)


def resting(seed: int) -> Scan:
    """A leg at rest with a BMI160 on thigh and shank."""
    rng = np.random.default_rng(seed)
    exact = [SensorStart(transforms.translation(JOINTS[k]), np.zeros(3)) for k in (1, 0)]
    force = np.broadcast_to([0, 9.80665, 0], (len(SAMPLES), 2, 3))
    signals = ImuSignals(SAMPLES, ("shank_l", "thigh_l"), np.zeros((len(SAMPLES), 2, 3)), force)
    # the sensor's own filter, which needs finer samples, has nothing to filter at rest
    read = read_out(signals, BMI160.without("low-pass"), rng)
    return with_joints(Scan(exposed(body(), STILL), read, rough(exact, ROUGH, rng)))


def beaded() -> BeadScan:
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.004)
    faces = np.asarray(ball.faces)
    beads = [
        Part(f"bead_{k}", "made", 1500.0, np.asarray(ball.vertices) + place, faces)
        for k, place in enumerate(bead_places())
    ]
    return BeadScan(exposed(Phantom((*body().parts, *beads)), STILL), bead_places(), 0.004)


def seen(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Shadows (v, p, 2) of points that rest, with errors."""
    exact = c_arm().project(np.broadcast_to(points, (len(VIEWS), *points.shape)))[0]
    return exact + PX * rng.standard_normal(exact.shape)


def inputs(seed: int) -> methods.MethodInputs:
    rng, places = np.random.default_rng([seed, 1]), Fiducials(0.03).points_sensor
    return replace(
        INPUTS,
        truth=cast(ScanTruth, Truth(STILL)),
        beads=beaded,
        priors=SensorPriors(BMI160, ROUGH),
        fused_beads=lambda: BeadShadows(seen(bead_places()[:2], rng), PX),
        fused_fiducials=lambda: FiducialShadows(seen(JOINTS[1] + places, rng), places, PX),
        beaded_leg=BeadedLeg(
            lambda _: BeadShadows(seen(bead_places()[:2], rng), PX), KNEE - JOINTS[0]
        ),
    )


@pytest.fixture(scope="module")
def scans() -> dict[int, Scan]:
    return {seed: resting(seed) for seed in (1, 2)}


@pytest.fixture(scope="module")
def static(scans: dict[int, Scan]) -> Volume:
    return fdk.fdk(scans[1].projections, GRID, device=DEVICE)


def test_every_method_either_promises_or_is_warned_of():
    assert sorted((*PROMISED, *WARNED)) == sorted(methods.BUILT_IN)
    assert set(WARNED) == set(methods.DEAD_RECKONING)


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("name", PROMISED)
def test_a_resting_leg_is_left_as_it_is(
    scans: dict[int, Scan], static: Volume, name: str, seed: int
):
    """SSIM against the motion-free scan falls by 0.005 at most; images see less than 0.1 mm."""
    found = methods.build(name, inputs(seed))(scans[seed])
    volume = fdk.fdk(found.projections, GRID, device=DEVICE, motion=found.motion)
    around = np.linalg.norm(GRID.positions() - KNEE, axis=-1).reshape(GRID.shape_zyx) < 0.07
    regions = (Region("leg", around),)
    scored = similarity.evaluate(volume, static, regions, device=DEVICE)
    assert scored.of("leg").ssim > 1 - 0.005
    bone = Structure("bone", True, np.broadcast_to(BONE, (len(VIEWS), *BONE.shape)))
    (left,) = residual_motion.of_motion(found.motion, (bone,), c_arm())
    assert left.pixels_after_similarity is not None
    pitch_mm = 3.08 * 0.78 / 1.198
    assert pitch_mm * left.pixels_after_similarity < 0.1


@pytest.mark.parametrize("name", WARNED)
def test_dead_reckoning_does_harm_and_is_warned_of(scans: dict[int, Scan], name: str):
    """Meters; images cannot even be deformed by as much."""
    scan, given = scans[1], inputs(1)
    method = methods.build(name, given)
    if name == "nonrigid-2d":
        with pytest.raises(LegsimError, match=r"behind the source .* follow sensors that drift"):
            method(scan)
    else:
        motion = method(scan).motion
        assert motion is not None
        assert np.abs(motion.carry(KNEE[None]) - KNEE).max() > 0.5
    (said, *_) = methods.undetermined([name], scan, given.sensor, given.priors)
    assert said.startswith(f"{name} follows ")
    assert "does not determine it" in said


def test_who_finds_the_drift_is_not_warned_of(scans: dict[int, Scan]):
    given = inputs(1)
    assert not methods.undetermined(PROMISED, scans[1], given.sensor, given.priors)
    exact = SensorPriors(BMI160.without(*_ALL), StartErrors(0.0, 0.0, 0.0, 0.0))
    assert not methods.undetermined(WARNED, scans[1], given.sensor, exact)


_ALL = (
    *("white-noise", "turn-on-bias", "instability", "random-walk", "scale", "misalignment"),
    *("g-sensitivity", "temperature", "quantisation", "low-pass"),
)
