import numpy as np

from legsim.core import transforms
from legsim.correction import bead_scan, bead_tracking
from legsim.correction.bead_scan import Beads
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.kinematics.skeleton import SEGMENTS, SegmentPoses
from legsim.opencl import device
from legsim.phantom import leg_phantom, materials
from legsim.phantom.skinning import swing_of

TIMES = np.arange(6) / 31
PHANTOM = leg_phantom.load_leg_phantom()
KNEE = PHANTOM.reference_world_from_segment[SEGMENTS.index("tibia_l")][:3, 3]


def c_arm() -> ConeBeamGeometry:
    return ConeBeamGeometry.circular(
        times=TIMES,
        angles=np.radians(0.8) * np.arange(6),
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=(240, 310),
        pixel_pitch=1.232e-3,
        isocenter=KNEE,
    )


def test_beads_lie_around_the_knee_on_the_skin():
    places = bead_scan.bead_positions(PHANTOM, Beads(count=9, reach=0.05))
    assert places.shape == (9, 3)
    np.testing.assert_allclose(places[[0, -1], 1] - KNEE[1], [-0.05, 0.05], atol=1e-12)
    vertices = PHANTOM.phantom.parts[PHANTOM.part_index("skin_l")].vertices
    assert np.linalg.norm(places[:, None] - vertices, axis=-1).min(-1).max() < 0.015


def test_beads_on_one_side_of_the_knee_move_with_one_segment():
    """Below it they follow the shank: the thigh alone turns by 1.7 degrees, and they stay to half a
    millimeter, where those above move more.
    """
    names = list(SEGMENTS)
    turned = np.array(PHANTOM.reference_world_from_segment)
    thigh = names.index("femur_l")
    about = transforms.rigid(
        transforms.axis_rotation([0, 0, 1], 0.03), KNEE
    ) @ transforms.translation(-KNEE)
    turned[thigh] = about @ turned[thigh]
    poses = SegmentPoses(
        TIMES[:2], SEGMENTS, np.stack([PHANTOM.reference_world_from_segment, turned])
    )
    for count in (1, 2, 4):
        moved = [
            np.linalg.norm(np.diff(bead_scan.bead_paths(PHANTOM, poses, beads), axis=0), axis=-1)
            for beads in (Beads.on_one_side(count), Beads.on_one_side(count, below=False))
        ]
        assert moved[0].shape == (1, count)
        assert moved[0].max() < 5e-4 < moved[1].max()


def test_beads_that_move_with_the_leg_are_found_where_they_are(rng: np.random.Generator):
    moved = np.stack([transforms.translation([0, 0.001 * k, 0.0005 * k]) for k in range(6)])
    poses = SegmentPoses(TIMES, SEGMENTS, moved[:, None] @ PHANTOM.reference_world_from_segment)
    plain = Projections(c_arm(), np.ones((6, 240, 310), np.float32))
    beads = Beads(radius=1.5e-3, guess_error=1e-3)
    scan = bead_scan.add_beads(
        plain, PHANTOM, poses, beads, device.open_device(), energy_kev=60.0, rng=rng
    )
    places = bead_scan.bead_positions(PHANTOM, beads)
    assert 0 < np.abs(scan.guesses - places).max() < 6e-3
    shadow = scan.projections.line_integrals - 1
    assert shadow.min() > -1e-6
    # the chord through the middle of a bead, a little less where a pixel misses it
    assert 0.8 < shadow.max() / (materials.attenuation("tantalum", 60.0) * 3e-3) < 1.8
    found = bead_tracking.track(scan.projections, scan.guesses, radius=scan.radius)
    truth = c_arm().project(transforms.apply(moved, places))[0]
    has = np.isfinite(found).all(-1)
    assert has.sum() >= 24
    assert np.linalg.norm(found - truth, axis=-1)[has].max() < 0.1


def test_beads_swing_with_the_skin(rng: np.random.Generator):
    """Of a leg that rests, upwards at the last view: their shadows are where spheres are that are
    parts of the phantom.
    """
    swinging = leg_phantom.load_leg_phantom(swinging=True)
    names = (
        *SEGMENTS,
        *(swing_of(f"{bone}_{side}") for bone in ("femur", "tibia") for side in "lr"),
    )
    shifts = [transforms.translation([0, 0.004 if k == 5 else 0.0, 0]) for k in range(6)]
    still = PHANTOM.reference_world_from_segment
    poses = SegmentPoses(
        TIMES, names, np.stack([np.concatenate([still, [shift] * 4]) for shift in shifts])
    )
    plain = Projections(c_arm(), np.zeros((6, 240, 310), np.float32))
    beads = Beads(count=4, radius=1.5e-3, guess_error=0.0)
    scan = bead_scan.add_beads(
        plain, swinging, poses, beads, device.open_device(), energy_kev=60.0, rng=rng
    )
    beaded = swinging.with_spheres(
        "bead", bead_scan.bead_positions(swinging, beads), segment="soft_l", radius=1.5e-3
    )
    centers = np.stack(
        [
            [part.mean(0) for part in beaded.posed(pose, names)[-4:]]
            for pose in poses.world_from_segment
        ]
    )
    assert (centers[5] - centers[4])[:, 1].min() > 0.0005
    found = bead_tracking.track(scan.projections, scan.guesses, radius=scan.radius)
    has = np.isfinite(found).all(-1)
    assert has[4:].sum() >= 6
    assert np.linalg.norm(found - c_arm().project(centers)[0], axis=-1)[has].max() < 0.1


def test_shadows_are_means_over_pixels_as_the_scan_s_own(rng: np.random.Generator):
    """Drawn so, a shadow of 1.3 pixels is found to 0.1 pixel wherever in a pixel it falls."""
    shifts = [transforms.translation([0, 0.0001 * k, 0.00017 * k]) for k in range(6)]
    poses = SegmentPoses(
        TIMES, SEGMENTS, np.stack(shifts)[:, None] @ PHANTOM.reference_world_from_segment
    )
    plain, opened = Projections(c_arm(), np.zeros((6, 240, 310), np.float32)), device.open_device()
    beads, off = Beads(count=4, radius=1e-3, guess_error=0.0), {}
    truth = c_arm().project(
        transforms.apply(np.stack(shifts), bead_scan.bead_positions(PHANTOM, beads))
    )[0]
    for rays in (1, 2, 4):
        scan = bead_scan.add_beads(
            plain,
            PHANTOM,
            poses,
            beads,
            opened,
            energy_kev=60.0,
            rng=rng,
            rays_per_pixel=rays,
        )
        found = bead_tracking.track(scan.projections, scan.guesses, radius=scan.radius)
        off[rays] = float(np.nanmax(np.abs(found - truth)))
    assert max(off[2], off[4]) < 0.1 < 0.15 < off[1], off
