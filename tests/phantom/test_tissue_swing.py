"""Soft tissue that swings: it lags its bone as an oscillator does, bones stay, surfaces stay
nested, and the truth tells of it.
"""

import numpy as np
import pytest
import trimesh

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.imu.skin_mount import SkinMount
from legsim.kinematics import joint_splines
from legsim.kinematics.joint_splines import JointSplines
from legsim.kinematics.leg_model import COORDINATES, LegModel
from legsim.kinematics.skeleton import SEGMENTS, SegmentPoses
from legsim.mocap.trajectories import JointTrajectories
from legsim.phantom import leg_phantom, tissue_swing
from legsim.phantom.leg_phantom import LegPhantom
from legsim.phantom.skinning import FARTHEST_SWING, swing_of

TISSUE = SkinMount(frequency_hz=10.0, damping=0.25)
TIMES = np.arange(0, 4, 1 / 120)


@pytest.fixture(scope="module")
def leg() -> LegModel:
    return LegModel.load()


@pytest.fixture(scope="module")
def legs() -> LegPhantom:
    return leg_phantom.load_leg_phantom(swinging=True)


def shaken(frequency_hz: float, size: float, knee_deg: float = 0.0) -> JointSplines:
    """The whole body going to and fro along x, knees bent."""
    values = np.zeros((len(TIMES), len(COORDINATES)))
    values[:, COORDINATES.index("pelvis_tx")] = size * np.sin(2 * np.pi * frequency_hz * TIMES)
    for side in "lr":
        values[:, COORDINATES.index(f"knee_angle_{side}")] = -np.radians(knee_deg)
    return JointSplines(JointTrajectories(TIMES, COORDINATES, values))


def swung(
    leg: LegModel, splines: JointSplines, times: np.ndarray, tissue: SkinMount = TISSUE
) -> SegmentPoses:
    return tissue_swing.with_swing(
        joint_splines.segment_poses_at(leg, splines, times), leg, splines, tissue
    )


@pytest.mark.parametrize("frequency_hz", [2.0, 10.0])
def test_tissue_swings_by_the_law_of_the_damped_oscillator(leg, frequency_hz):
    size = 0.5 / (2 * np.pi * frequency_hz) ** 2
    late = np.arange(2, 3.5, 1 / 200)
    poses = swung(leg, shaken(frequency_hz, size), late)
    w, s = 2 * np.pi * TISSUE.frequency_hz, 2j * np.pi * frequency_hz
    expected = size * np.abs(s**2 / (s**2 + 2 * TISSUE.damping * w * s + w**2))
    for name in ("femur_l", "tibia_r"):
        shift = poses.of(swing_of(name))[:, :3, 3]
        assert np.abs(shift[:, 0]).max() == pytest.approx(expected, rel=0.03)
        assert np.abs(shift[:, 1:]).max() < 1e-6
        np.testing.assert_array_equal(
            poses.of(swing_of(name))[:, :3, :3], np.broadcast_to(np.eye(3), (len(late), 3, 3))
        )


def test_a_resting_body_does_not_swing_whatever_its_pose(leg):
    poses = swung(leg, shaken(1.0, 0.0, knee_deg=60.0), TIMES[10:20])
    assert np.abs(poses.of(swing_of("tibia_l"))[:, :3, 3]).max() < 1e-9


def test_a_swing_that_would_fold_layers_is_refused(leg):
    with pytest.raises(
        LegsimError,
        match=r"would swing .* mm; its layers allow 5\.3 mm: .* phantom\.tissue_swing\.amplitude",
    ):
        swung(leg, shaken(3.0, 0.02), TIMES[100:200], SkinMount(10.0, 0.25, amplitude=10.0))


def with_swing(pose: np.ndarray, thigh, shank) -> tuple[np.ndarray, tuple[str, ...]]:
    """A pose (13, 4, 4) and names, with the same swing of both legs."""
    names = tuple(swing_of(f"{bone}_{side}") for bone in ("femur", "tibia") for side in "lr")
    return np.concatenate(
        [pose, [transforms.translation(s) for s in (thigh, thigh, shank, shank)]]
    ), (*SEGMENTS, *names)


def squat(leg: LegModel, degrees: float = 60.0) -> np.ndarray:
    return leg.segment_poses(
        JointTrajectories([0.0], COORDINATES, shaken(1.0, 0.0, degrees).trajectories.values[:1])
    ).world_from_segment[0]


LARGEST = FARTHEST_SWING / np.sqrt(3) * np.array([[1, 1, 1], [-1, 1, -1]])


def test_without_swing_every_vertex_is_where_it_was_bit_for_bit(leg, legs):
    still = leg_phantom.load_leg_phantom()
    pose = squat(leg)
    poses, names = with_swing(pose, np.zeros(3), np.zeros(3))
    for expected, plain, zero in zip(
        still.posed(pose, SEGMENTS),
        legs.posed(pose, SEGMENTS),
        legs.posed(poses, names),
        strict=True,
    ):
        np.testing.assert_array_equal(plain, expected)
        np.testing.assert_array_equal(zero, expected)


def test_bones_stay_skin_swings_and_surfaces_stay_closed_and_nested(leg, legs):
    pose = squat(leg)
    poses, names = with_swing(pose, *LARGEST)
    before, after = legs.posed(pose, SEGMENTS), legs.posed(poses, names)
    for segment, part, a, b in zip(legs.segments, legs.phantom.parts, before, after, strict=True):
        if not segment.startswith("soft"):
            np.testing.assert_array_equal(a, b)
        if part.name.startswith("skin"):
            assert np.linalg.norm(b - a, axis=-1).max() == pytest.approx(FARTHEST_SWING, rel=1e-3)
            above = (
                part.vertices[:, 1]
                - legs.reference_world_from_segment[SEGMENTS.index("tibia_l"), 1, 3]
            )
            for chosen, swing in ((above > 0.25, LARGEST[0]), (above < -0.25, LARGEST[1])):
                share = (b - a)[chosen] @ swing / (swing @ swing)
                np.testing.assert_allclose((b - a)[chosen], share[:, None] * swing, atol=1e-9)
                assert share.max() == pytest.approx(1)
                assert share.min() > -1e-9
    for side in "lr":
        surfaces = {}
        for name in ("skin", "fat", "muscle_quadriceps", "muscle_soleus"):
            k = legs.part_index(f"{name}_{side}")
            surfaces[name] = trimesh.Trimesh(
                after[k], legs.phantom.parts[k].triangles, process=False
            )
        assert surfaces["skin"].contains(surfaces["fat"].vertices).all()
        for muscle in ("muscle_quadriceps", "muscle_soleus"):
            assert surfaces["fat"].contains(surfaces[muscle].vertices).all()
        for part, moved in zip(legs.phantom.parts, after, strict=True):
            if part.name.endswith(f"cortex_{side}"):
                assert surfaces["fat"].contains(moved).all(), part.name


def test_the_farthest_swing_turns_no_tissue_inside_out(leg, legs, rng):
    """The determinant of the map's slope, by differences, at points inside the skin of the straight
    leg.
    """
    straight, names = with_swing(legs.reference_world_from_segment, np.zeros(3), np.zeros(3))
    skin = legs.phantom.parts[legs.part_index("skin_r")]
    low, high = skin.vertices.min(0), skin.vertices.max(0)
    points = rng.uniform(low, high, (6000, 3))
    points = points[trimesh.Trimesh(skin.vertices, skin.triangles, process=False).contains(points)]
    step = 1e-5
    around = np.concatenate([points, *(points + step * axis for axis in np.eye(3))])
    for end in (legs.reference_world_from_segment, squat(leg)):
        poses, _ = with_swing(end, *LARGEST)
        moved = legs.paths(
            around, "soft_r", start=straight, poses=poses[None], segment_names=names
        )[0].reshape(4, -1, 3)
        determinants = np.linalg.det(np.moveaxis(moved[1:] - moved[0], 0, -1) / step)
        assert len(determinants) > 1000
        assert determinants.min() > 0.1


@pytest.mark.end_to_end
def test_the_truth_of_material_points_holds_the_swing(leg, legs, rng):
    start, names = with_swing(squat(leg, 50.0), [0.002, -0.001, 0], [0, 0.001, -0.002])
    end, _ = with_swing(squat(leg, 55.0), [-0.003, 0, 0.001], [0.001, 0.002, 0])
    before, after = legs.posed(start, names), legs.posed(end, names)
    for name in ("skin_r", "muscle_soleus_l", "fat_l", "tibia_cortex_l"):
        k = legs.part_index(name)
        chosen = rng.choice(len(before[k]), 200, replace=False)
        path = legs.paths(
            before[k][chosen],
            legs.segments[k],
            start=start,
            poses=np.stack([start, end]),
            segment_names=names,
        )
        np.testing.assert_allclose(path[0], before[k][chosen], atol=1e-7)
        np.testing.assert_allclose(path[1], after[k][chosen], atol=1e-7)


def test_beads_on_the_skin_swing_with_it_and_a_phantom_that_cannot_swing_says_so(leg, legs):
    place = legs.skin_points("l", heights=[0.15], directions=[0.3])
    beaded = legs.with_spheres("bead", place, segment="soft_l", radius=0.001)
    pose = squat(leg)
    poses, names = with_swing(pose, [0.003, 0, 0], [0.003, 0, 0])
    moved = beaded.posed(poses, names)[-1].mean(0) - beaded.posed(pose, SEGMENTS)[-1].mean(0)
    assert 0.001 < moved[0] <= 0.003 + 1e-9
    np.testing.assert_allclose(moved[1:], 0, atol=1e-9)
    with pytest.raises(LegsimError, match="swinging=True"):
        leg_phantom.load_leg_phantom().posed(poses, names)
