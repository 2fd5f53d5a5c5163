"""A simulated scan: its mirror image, what a run makes of the same settings, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.correction.bead_scan import Beads
from legsim.correction.nonrigid import joint_motions
from legsim.correction.rigid import Rigid
from legsim.deformation.models import RigidMotion
from legsim.geometry import image_files
from legsim.geometry.volume import VolumeGrid
from legsim.imu.files import load_imu
from legsim.imu.sensors import default_sensors
from legsim.imu.simulation import simulate_imu
from legsim.kinematics import from_recording
from legsim.kinematics.moving_leg import MovingLeg
from legsim.phantom import materials
from legsim.scan.c_arm import CArm
from legsim.simulation.setup import PhantomOptions
from legsim.simulation.simulated_scan import SimulatedScan, simulate_scan
from tests.examples.squat import ARM, GRID_VOXELS, mirrored, mirrored_arm, other_side, squatting

pytestmark = pytest.mark.filterwarnings("ignore::legsim.reconstruction.weights.ShortScanWarning")
FLIP = np.array([1.0, 1.0, -1.0])
TURN = np.array([-1.0, -1.0, 1.0])
"""how a mirror changes points and forces, and turns"""


@pytest.fixture(scope="module")
def person() -> MovingLeg:
    return squatting()


@pytest.fixture(scope="module")
def left(person) -> SimulatedScan:
    return simulate_scan(person, ARM, side="left")


@pytest.fixture(scope="module")
def right(person) -> SimulatedScan:
    """The same scan in a mirror."""
    return simulate_scan(mirrored(person), mirrored_arm(ARM), side="right")


def test_the_right_leg_of_a_mirrored_person_is_projected_mirrored(left, right):
    for ours, theirs in (
        (left.seen.projections, right.seen.projections),
        (left.at_rest, right.at_rest),
    ):
        flipped = theirs.line_integrals[:, :, ::-1]
        assert ours.line_integrals.max() > 3
        np.testing.assert_allclose(flipped, ours.line_integrals, atol=5e-5)


def test_sources_and_detectors_stand_mirrored(left, right):
    ours, theirs = left.setup.geometry, right.setup.geometry
    np.testing.assert_allclose(theirs.sources(), ours.sources() * FLIP, atol=1e-9)
    np.testing.assert_allclose(theirs.rotation_center(), ours.rotation_center() * FLIP, atol=1e-9)


def test_sensors_read_mirrored(left, right):
    ours, theirs = left.seen.signals, right.seen.signals
    assert theirs.sensor_names == tuple(other_side(name) for name in ours.sensor_names)
    np.testing.assert_array_equal(theirs.times, ours.times)
    np.testing.assert_allclose(theirs.specific_force, ours.specific_force * FLIP, atol=1e-9)
    np.testing.assert_allclose(theirs.angular_velocity, ours.angular_velocity * TURN, atol=1e-9)


def test_starts_and_joints_on_the_sensors_are_mirrored(left, right):
    for ours, theirs in zip(left.seen.starts, right.seen.starts, strict=True):
        np.testing.assert_allclose(theirs.velocity, ours.velocity * FLIP, atol=1e-9)
        np.testing.assert_allclose(
            theirs.world_from_sensor[:3, 3], ours.world_from_sensor[:3, 3] * FLIP, atol=1e-9
        )
    for ours, theirs in zip(left.seen.joints[0], right.seen.joints[0], strict=True):
        assert theirs.sensor == other_side(ours.sensor)
        np.testing.assert_allclose(theirs.position_sensor, ours.position_sensor * FLIP, atol=1e-9)


def test_regions_are_mirrored(left, right):
    for ours, theirs in zip(
        *(scan.regions(scan.grid(GRID_VOXELS, 6e-3)) for scan in (left, right)), strict=True
    ):
        assert theirs.name == ours.name
        assert ours.mask.sum() > 500
        np.testing.assert_array_equal(theirs.mask[::-1], ours.mask)


def test_beads_lie_mirrored_on_the_skin(left, right):
    exact = Beads(guess_error=0.0)
    ours, theirs = (scan.beads(exact) for scan in (left, right))
    np.testing.assert_allclose(theirs.guesses, ours.guesses * FLIP, atol=1e-9)
    shadows = [
        beads.projections.line_integrals - scan.seen.projections.line_integrals
        for beads, scan in ((ours, left), (theirs, right))
    ]
    assert shadows[0].max() > 0.1
    np.testing.assert_allclose(shadows[1][:, :, ::-1], shadows[0], atol=1e-3)


def test_the_truth_and_what_methods_find_are_mirrored(left, right):
    point = left.setup.geometry.rotation_center()[None]
    ours, theirs = left.truth.motion_of("tibia_l"), right.truth.motion_of("tibia_r")
    np.testing.assert_allclose(theirs.carry(point * FLIP), ours.carry(point) * FLIP, atol=1e-9)
    found = [Rigid()(scan.seen).motion for scan in (left, right)]
    assert isinstance(found[0], RigidMotion)
    assert isinstance(found[1], RigidMotion)
    np.testing.assert_allclose(
        found[1].carry(point * FLIP), found[0].carry(point) * FLIP, atol=1e-5
    )
    (a,), (b,) = joint_motions(left.seen), joint_motions(right.seen)
    np.testing.assert_allclose(b.moved, a.moved * FLIP, atol=1e-5)


def test_the_true_field_is_mirrored(left, right):
    nodes = [scan.grid(10, 0.016) for scan in (left, right)]
    ours, theirs = (
        scan.truth.field(grid).displacements
        for scan, grid in zip((left, right), nodes, strict=True)
    )
    assert np.abs(ours).max() > 1e-3
    apart = np.abs(theirs[:, ::-1] * FLIP - ours).max((0, -1))
    # a node as near to the one bone as to the other may go with either
    assert (apart < 1e-5).mean() > 0.99


def test_the_scan_at_rest_repeats_the_first_view(left):
    moving, still = (p.line_integrals.astype(float) for p in (left.seen.projections, left.at_rest))
    np.testing.assert_array_equal(moving[0], still[0])
    assert np.abs(moving[-1] - still[-1]).max() > 1e-3


def test_the_true_motion_of_a_segment_carries_its_first_pose_to_every_view(left):
    poses = left.truth.poses.of("tibia_l")
    moved = left.truth.motion_of("tibia_l").moved_from_reference
    np.testing.assert_allclose(moved @ poses[0], poses, atol=1e-12)


def test_inside_a_bone_the_field_is_the_bones_motion(left):
    tibia = left.truth.poses.of("tibia_l")[0]
    shaft = tibia[:3, :3] @ [0.0, -0.2, 0.0] + tibia[:3, 3]
    nodes = VolumeGrid.cubic(3, 2e-3, [float(c) for c in shaft])
    center = nodes.positions()[13]
    moved = left.truth.motion_of("tibia_l").carry(center[None])[:, 0]
    found = center + left.truth.field(nodes).displacements[:, 1, 1, 1]
    np.testing.assert_allclose(found, moved, atol=2e-4)


def test_a_scan_is_what_a_run_makes_of_the_same_settings(tiny_run, tiny_settings):
    """Bit for bit: projections, at rest too, and the sensors' signals."""
    arm = CArm.paper(
        angles=np.radians(-8.8 + 1.6 * np.arange(124)),
        rate_hz=15.5,
        shape_vu=(96, 124),
        pixel_pitch=1e-3 * 3.08,
    )
    scan = simulate_scan(from_recording.solve_kinematics(tiny_settings.motion.file), arm)
    for name, ours in (
        ("projections", scan.seen.projections),
        ("projections-static", scan.at_rest),
    ):
        theirs = image_files.load_projections(tiny_run.folder / f"{name}.mha", ours.geometry)
        np.testing.assert_array_equal(ours.line_integrals, theirs.line_integrals)
    signals = load_imu(tiny_run.folder / "imu.csv")
    np.testing.assert_array_equal(scan.seen.signals.specific_force, signals.specific_force)
    np.testing.assert_array_equal(scan.seen.signals.angular_velocity, signals.angular_velocity)


def test_beads_absorb_at_the_energy_of_the_phantom(person):
    """Tantalum is four times as heavy at 70 keV, above its edge, as at 60."""
    beads = Beads(count=4, radius=0.02, guess_error=0.0)
    found = {}
    for energy in (60.0, 70.0):
        scan = simulate_scan(person, ARM, phantom=PhantomOptions(energy_kev=energy))
        added = scan.beads(beads).projections.line_integrals - scan.seen.projections.line_integrals
        found[energy] = added.max()
    expected = [materials.attenuation("tantalum", energy) for energy in found]
    assert found[70.0] / found[60.0] == pytest.approx(expected[1] / expected[0], rel=1e-3)


def test_its_repr_names_the_leg_and_the_sensors(left):
    assert repr(left) == f"SimulatedScan({left.setup!r}, sensors shank_l, thigh_l)"


def test_progress_counts_both_exposures(person):
    steps: list[tuple[str, int, int]] = []
    simulate_scan(person, ARM, progress=lambda *now: steps.append(now))
    assert [work for work, done, count in steps if done == count == 24] == [
        "projecting",
        "projecting, at rest",
    ]


def test_signals_without_sensor_placements_are_refused(person):
    signals = replace(simulate_imu(person), sensors=())
    with pytest.raises(LegsimError, match="do not say where their sensors are strapped on"):
        simulate_scan(person, ARM, signals)


def test_what_is_no_side_is_refused(person):
    with pytest.raises(LegsimError, match="side is 'middle'; give left or right"):
        simulate_scan(person, ARM, side="middle")  # type: ignore[arg-type]


def test_sensors_of_the_other_leg_leave_the_scanned_joints_unknown(person):
    scan = simulate_scan(person, ARM, simulate_imu(person, default_sensors("right")), side="left")
    assert scan.seen.joints == ()
    assert scan.seen.signals.sensor_names == ("shank_r", "thigh_r")


def test_a_recording_shorter_than_the_scan_is_refused(person):
    with pytest.raises(LegsimError, match="the recording lasts"):
        simulate_scan(person, replace(ARM, rate_hz=1.0))
