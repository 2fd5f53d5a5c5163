"""Bones against their own reconstruction: a bent knee is bettered, a resting one left alone."""

from dataclasses import replace

import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.correction import bones_2d3d, path_problem
from legsim.correction.bones_2d3d import Bones2D3D
from legsim.correction.fused import SensorPriors
from legsim.correction.limb_motion import Limb
from legsim.correction.method import Scan
from legsim.correction.rough_start import EXACT
from legsim.deformation.models import FieldMotion, Motion, RigidMotion
from legsim.evaluation import image_gauge
from legsim.geometry.cone_beam import Projections
from legsim.imu.errors import SensorErrors
from legsim.imu.signals import ImuSignals
from legsim.opencl.device import Device
from tests.correction import test_articulated as bent

pytestmark = pytest.mark.filterwarnings("ignore::legsim.reconstruction.weights.ShortScanWarning")
VIEWS = bent.VIEWS[::2]
NOTHING = ImuSignals(VIEWS, (), np.zeros((len(VIEWS), 0, 3)), np.zeros((len(VIEWS), 0, 3)))


def thinned(images: Projections) -> Projections:
    return Projections(images.geometry[::2], images.line_integrals[::2])


def resting(device: Device, monkeypatch: pytest.MonkeyPatch) -> Projections:
    still = RigidMotion.identity(bent.VIEWS)
    monkeypatch.setattr(bent, "true_motions", lambda: dict.fromkeys(bent.solids(), still))
    return thinned(bent.exposed(device))


def left_px(motion: Motion | None, name: str) -> float:
    """RMS distance of a bone's projections after the similarity that fits best."""
    geometry = bent.geometry()[::2]
    points = np.concatenate([np.asarray(mesh.vertices) for mesh in bent.solids()[name]])
    points = points[(np.abs(points) < 0.08).all(-1)][::7]
    true = geometry.project(bent.true_motions()[name].carry(points)[::2])[0]
    carried = (motion or RigidMotion.identity(VIEWS)).carry

    def seen(at: np.ndarray) -> np.ndarray:
        return geometry.project(carried(at))[0]

    best = image_gauge.best_similarity(seen, points, true)
    off = seen(transforms.apply(best, points)) - true
    return float(np.sqrt((off**2).sum(-1).mean()))


@pytest.mark.slow
def test_the_error_of_a_bending_knee_is_halved_without_a_sensor(device: Device):
    """RMS of femur and tibia, which move by two pixels; it is still falling."""
    scan = Scan(thinned(bent.exposed(device)), NOTHING, ())
    found = Bones2D3D(bent.NODES, rounds=8, device=device)(scan)
    assert any("misfit of edges" in note for note in found.notes)
    left, before = (
        float(np.hypot(left_px(motion, "femur"), left_px(motion, "tibia")))
        for motion in (found.motion, None)
    )
    assert left < 0.5 * before


@pytest.mark.end_to_end
def test_a_knee_at_rest_is_left_as_it_is(device: Device, monkeypatch: pytest.MonkeyPatch):
    scan = Scan(resting(device, monkeypatch), NOTHING, ())
    found = Bones2D3D(bent.NODES, rounds=1, device=device)(scan)
    assert isinstance(found.motion, RigidMotion)
    np.testing.assert_array_equal(
        found.motion.moved_from_reference, RigidMotion.identity(VIEWS).moved_from_reference
    )
    assert "the data do not determine a motion, and the scan is left as it is" in found.notes[-1]


def test_a_scan_without_bones_is_left_as_it_is(device: Device):
    air = Projections(bent.geometry()[::2], np.zeros((len(VIEWS), 96, 124), np.float32))
    found = Bones2D3D(bent.NODES, device=device)(Scan(air, NOTHING, ()))
    assert isinstance(found.motion, RigidMotion)
    assert "nothing but air is seen around the rotation center; the scan is left" in found.notes[-1]


def test_without_bones_the_motion_of_exact_sensors_is_kept(device: Device):
    exact = SensorPriors(SensorErrors(), EXACT)
    found = Bones2D3D(bent.NODES, exact, device=device)(bent.resting())
    assert isinstance(found.motion, FieldMotion)
    assert np.abs(found.motion.displacements).max() < 1e-9
    assert "start along the paths of sensors thigh_l and shank_l" in found.notes[0]
    assert "the motion of the sensors is kept" in found.notes[1]


def test_no_round_is_refused(device: Device):
    with pytest.raises(LegsimError, match="given 0 rounds; give at least 1"):
        Bones2D3D(rounds=0, device=device)(replace(bent.resting(), joints=()))


@pytest.mark.parametrize(("moved_px", "is_followed"), [(1.4, False), (1.43, True)])
def test_only_what_is_seen_beyond_the_own_error_is_followed(
    device: Device, monkeypatch: pytest.MonkeyPatch, moved_px: float, is_followed: bool
):
    """Root two times an error of a pixel, whatever the rounds found."""
    still = np.broadcast_to(np.eye(4), (len(VIEWS), 4, 4))
    limb = Limb(np.array([[0, 0.4, 0], [0, 0, 0], [0, -0.4, 0]]), still, still)
    monkeypatch.setattr(bones_2d3d, "_registered", lambda *_: (limb, limb, "rounds"))
    monkeypatch.setattr(bones_2d3d, "_seen_change", lambda *_: (moved_px, 1.0))
    air = Projections(bent.geometry()[::2], np.zeros((len(VIEWS), 96, 124), np.float32))
    found = Bones2D3D(bent.NODES, device=device)(Scan(air, NOTHING, ()))
    assert isinstance(found.motion, FieldMotion if is_followed else RigidMotion)
    assert any("do not determine a motion" in note for note in found.notes) is not is_followed


def test_sensors_that_fit_no_path_leave_the_bones_to_start_at_rest(
    device: Device, monkeypatch: pytest.MonkeyPatch
):
    def far(*_: object) -> None:
        raise np.linalg.LinAlgError("not positive definite")

    monkeypatch.setattr(path_problem, "cho_factor", far)
    found = Bones2D3D(bent.NODES, rounds=1, device=device)(bent.resting())
    assert found.notes[0].startswith("In doubt: bones-2d3d: sensor thigh_l: no path of the sensor")
    assert "; bones start at rest." in found.notes[0]
