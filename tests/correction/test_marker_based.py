"""The marker-based method: the motion of the beads becomes the correction of the scan."""

import numpy as np
import pytest

from legsim.core import transforms
from legsim.correction.bead_scan import BeadScan
from legsim.correction.marker_based import MarkerBased
from legsim.correction.method import Correction, Scan
from legsim.deformation.models import RigidMotion
from legsim.geometry.cone_beam import Projections
from legsim.imu.signals import ImuSignals, SensorStart
from legsim.opencl import device
from legsim.phantom.meshes import Part, Phantom, sphere
from legsim.scan import projector
from legsim.scan.c_arm import CArm
from tests.references.sway import Sway

VIEWS = np.arange(62) / 7.75
SWAY = Sway.standing(3, position_mm=8.0, angle_deg=1.5)
MOTION = RigidMotion.from_poses(VIEWS, SWAY.poses(VIEWS))
RADIUS = 0.004
TURN = 2.4 * np.arange(8)
PLACES = SWAY.center + np.stack(
    [0.07 * np.cos(TURN), np.linspace(-0.05, 0.05, 8), 0.07 * np.sin(TURN)], -1
)


@pytest.fixture(scope="module")
def beads() -> BeadScan:
    """Eight beads that move as one, and nothing else."""
    surface, triangles = sphere(RADIUS)
    parts = tuple(
        Part(f"bead_{k}", "made", 1500.0, place + surface, triangles)
        for k, place in enumerate(PLACES)
    )
    arm = CArm.paper(
        angles=np.radians(3.2) * np.arange(62), shape_vu=(96, 124), pixel_pitch=3.08e-3
    )
    seen = projector.project(
        Phantom(parts),
        arm.geometry(VIEWS, SWAY.center),
        device.open_device(),
        posed=lambda view: [
            transforms.apply(MOTION.moved_from_reference[view], part.vertices) for part in parts
        ],
    )
    return BeadScan(seen, PLACES, RADIUS)


@pytest.fixture(scope="module")
def scan(beads: BeadScan) -> Scan:
    """The same views without beads."""
    geometry = beads.projections.geometry
    signals = ImuSignals(VIEWS, ("s",), np.zeros((62, 1, 3)), np.zeros((62, 1, 3)))
    images = np.zeros_like(beads.projections.line_integrals)
    return Scan(Projections(geometry, images), signals, (SensorStart(np.eye(4), np.zeros(3)),))


@pytest.fixture(scope="module")
def found(beads: BeadScan, scan: Scan) -> Correction:
    return MarkerBased(beads)(scan)


def test_the_motion_of_the_beads_corrects_the_scan_without_them(found: Correction, scan: Scan):
    """Judged in the images, by the law of all methods: they leave the size of the scene open."""
    assert found.projections is scan.projections
    assert found.motion is not None
    seen, true, resting = (
        scan.projections.geometry.project(points)[0]
        for points in (found.motion.carry(PLACES), MOTION.carry(PLACES), PLACES)
    )
    left, before = (np.sqrt(((at - true) ** 2).sum(-1).mean()) for at in (seen, resting))
    assert before > 1
    assert left < 0.35 * before


def test_it_says_how_many_shadows_were_found_and_how_well_they_fit(found: Correction):
    (note,) = found.notes
    assert note.startswith("8 beads: ")
    assert note.endswith("px RMS from a rigid motion.")


def test_poses_are_fitted_to_the_mean_positions_where_that_is_wanted(
    beads: BeadScan, scan: Scan, found: Correction
):
    published = MarkerBased(beads, "mean")(scan)
    (note,) = published.notes
    assert note.endswith("px RMS from a rigid motion of their static mean positions.")
    assert isinstance(published.motion, RigidMotion)
    assert isinstance(found.motion, RigidMotion)
    away = published.motion.moved_from_reference - found.motion.moved_from_reference
    assert np.abs(away).max() > 1e-4


def test_a_scan_with_beads_is_made_when_the_method_runs(
    beads: BeadScan, scan: Scan, found: Correction
):
    asked: list[BeadScan] = []

    def expose() -> BeadScan:
        asked.append(beads)
        return beads

    method = MarkerBased(expose)
    assert asked == []
    late, early = method(scan).motion, found.motion
    assert asked == [beads]
    assert isinstance(late, RigidMotion)
    assert isinstance(early, RigidMotion)
    np.testing.assert_array_equal(late.moved_from_reference, early.moved_from_reference)
