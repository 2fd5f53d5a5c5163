"""An imaged leg moves as the leg model does: the shipped phantom, imaged, comes back."""

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.geometry.label_images import load_label_image
from legsim.geometry.volume import VolumeGrid
from legsim.kinematics.joint_splines import segment_poses_at
from legsim.kinematics.leg_model import COORDINATES, LegModel
from legsim.kinematics.skeleton import SegmentPoses
from legsim.mocap.trajectories import JointTrajectories
from legsim.opencl.device import open_device
from legsim.phantom import from_labels, imaged_leg, label_maps, leg_phantom
from legsim.phantom.from_labels import Layers
from legsim.phantom.imaged_leg import ImagedLegWarning
from legsim.phantom.label_structures import structure_grid
from legsim.phantom.leg_phantom import LegPhantom
from tests.examples import segmentations
from tests.examples.squat import ARM, squatting

VOXEL = 0.003
PERSON = squatting()
LEGS = leg_phantom.load_leg_phantom(scales=PERSON.leg.scales).one_leg("l")


def flexed(degrees: float, scales=PERSON.leg.scales) -> SegmentPoses:
    """The model's leg with a bent knee and hip, turned about its length."""
    values = np.zeros((1, len(COORDINATES)))
    for name, angle in (("knee_angle", -1), ("hip_flexion", 0.5), ("hip_rotation", 0.5)):
        values[0, COORDINATES.index(f"{name}_l")] = angle * np.radians(degrees)
    return LegModel.load(scales).segment_poses(JointTrajectories([0.0], COORDINATES, values))


def imported(folder, degrees: float, *, soft: bool, reach: float | None = None):
    """PHANTOM.toml of the shipped left leg, imaged at a pose; ``reach`` m about the knee."""
    pose = flexed(degrees)
    posed = LEGS.posed(pose.world_from_segment[0], pose.segment_names)
    kept = [k for k, s in enumerate(LEGS.segments) if soft or not s.startswith("soft")]
    some = replace(
        LEGS,
        phantom=LEGS.phantom.only(kept),
        segments=tuple(LEGS.segments[k] for k in kept),
    )
    vertices = tuple(posed[k] for k in kept)
    points = np.concatenate(vertices)
    low, high = points.min(0) - 2 * VOXEL, points.max(0) + 2 * VOXEL
    if reach is not None:
        knee = pose.of("tibia_l")[0][1, 3]
        low[1], high[1] = knee - reach, knee + reach
    counts = np.ceil((high - low) / VOXEL).astype(int)
    grid = VolumeGrid(tuple(counts[::-1]), (VOXEL,) * 3, tuple((low + high) / 2))
    labels, text = segmentations.of_phantom(some, vertices, grid, open_device("cpu"))
    segmentations.write(folder / "leg.nii.gz", labels, grid)
    (folder / "leg.toml").write_text(text)
    structures = structure_grid(
        [load_label_image(folder / "leg.nii.gz")],
        [label_maps.load_label_map(folder / "leg.toml")],
        side=None,
    )
    return from_labels.save(folder / "made", from_labels.mesh_labels(structures, Layers()))


@pytest.fixture(scope="module")
def bones(tmp_path_factory):
    """The bones of a straight leg."""
    return imported(tmp_path_factory.mktemp("straight"), 0, soft=False)


def apart(made: LegPhantom, name: str, within: float = np.inf) -> np.ndarray:
    """Distances (views, vertices) in voxels of an imported bone from the original's surface.

    Only vertices within ``within`` m of the knee count.
    """
    poses = segment_poses_at(
        PERSON.leg, PERSON.splines, ARM.view_times(PERSON.trajectories.times)[::4]
    )
    k, original = made.part_index(name), LEGS.part_index(name)
    rest = made.phantom.parts[k].vertices
    knee = made.reference_world_from_segment[LEGS_KNEE][1, 3]
    near = np.abs(rest[:, 1] - knee) < within
    found = []
    for pose in poses.world_from_segment:
        moved = made.posed(pose, poses.segment_names)[k][near]
        true = LEGS.posed(pose, poses.segment_names)[original]
        mesh = trimesh.Trimesh(true, LEGS.phantom.parts[original].triangles, process=False)
        places = trimesh.sample.sample_surface(mesh, 60000, seed=1)[0]
        found.append(cKDTree(places).query(moved)[0] / VOXEL)
    return np.array(found)


LEGS_KNEE = 9  # tibia_l in SEGMENTS
BONES = ("femur_cortex_l", "tibia_cortex_l", "patella_cortex_l")


@pytest.mark.parametrize("name", BONES)
def test_the_phantom_imaged_straight_moves_with_the_original_within_half_a_voxel(bones, name):
    found = apart(imaged_leg.load_imaged_leg(bones, scales=PERSON.leg.scales), name)
    # corners of voxels at edges and notches are up to half a voxel's diagonal off before any motion
    assert (np.quantile(found, 0.98, axis=1) < 0.5).all()
    assert found.max() < 0.87


@pytest.mark.parametrize("name", BONES)
def test_a_knee_alone_imaged_bent_moves_with_the_original_within_half_a_voxel(tmp_path, name):
    path = imported(tmp_path, 15, soft=False, reach=0.12)
    made = imaged_leg.load_imaged_leg(path, scales=PERSON.leg.scales)
    found = apart(made, name, within=0.11)
    assert (np.quantile(found, 0.98, axis=1) < 0.5).all()
    assert found.max() < 0.87


@pytest.mark.parametrize(("degrees", "reach"), [(0, None), (15, 0.12), (40, None)])
def test_the_pose_of_imaged_bones_is_right_to_a_sixth_of_a_voxel(tmp_path, degrees, reach):
    path = imported(tmp_path, degrees, soft=False, reach=reach)
    found = imaged_leg.image_pose(path, imaged_leg.files.read(path), PERSON.leg.scales)
    true = flexed(degrees)
    for name in ("femur", "tibia"):
        pose = true.of(f"{name}_l")[0]
        points = transforms.apply(pose, LEGS.in_segment(f"{name}_cortex_l"))
        if reach is not None:
            points = points[np.abs(points[:, 1] - true.of("tibia_l")[0][1, 3]) < reach]
        motion = found[imaged_leg.SEGMENTS.index(f"{name}_l")] @ transforms.inverse(pose)
        off = np.linalg.norm(transforms.apply(motion, points) - points, axis=1)
        # over 41 straight and bent, whole and cut legs at 1 to 3 mm (1 mm: left alone): at most 0.12
        assert off.max() < VOXEL / 6, name


@pytest.mark.parametrize("degrees", [-10, 15, 40])
def test_exact_bones_of_a_bent_leg_give_its_pose(degrees):
    """Without voxels nothing is left: the model's knee does not turn about its condyles' middle."""
    pose = flexed(degrees)
    parts, segments = [], []
    for k, vertices in enumerate(LEGS.posed(pose.world_from_segment[0], pose.segment_names)):
        if LEGS.phantom.parts[k].name in ("femur_cortex_l", "tibia_cortex_l"):
            parts.append(replace(LEGS.phantom.parts[k], vertices=vertices))
            segments.append(LEGS.segments[k])
    read = imaged_leg.PhantomFile(imaged_leg.Phantom(tuple(parts)), tuple(segments), ())
    found = imaged_leg.image_pose(Path("leg.toml"), read, PERSON.leg.scales)
    for name in ("femur_l", "tibia_l", "talus_l"):
        k = imaged_leg.SEGMENTS.index(name)
        np.testing.assert_allclose(found[k], pose.of(name)[0], atol=2e-6)


def test_a_leg_that_stands_turned_is_placed_as_it_stands():
    pose = flexed(15)
    turn = transforms.rigid(transforms.axis_rotation((0, 1, 0), np.radians(70)), (0.2, 0, 0))
    parts, segments = [], []
    for k, vertices in enumerate(LEGS.posed(pose.world_from_segment[0], pose.segment_names)):
        if LEGS.phantom.parts[k].name in BONES:
            moved = transforms.apply(turn, vertices)
            parts.append(replace(LEGS.phantom.parts[k], vertices=moved))
            segments.append(LEGS.segments[k])
    read = imaged_leg.PhantomFile(imaged_leg.Phantom(tuple(parts)), tuple(segments), ())
    found = imaged_leg.image_pose(Path("leg.toml"), read, PERSON.leg.scales)
    for name in ("femur_l", "tibia_l", "patella_l"):
        k = imaged_leg.SEGMENTS.index(name)
        np.testing.assert_allclose(found[k], turn @ pose.of(name)[0], atol=5e-6)


def test_soft_tissue_comes_back_where_it_was_imaged(tmp_path):
    path = imported(tmp_path, 12, soft=True, reach=0.08)
    made = imaged_leg.load_imaged_leg(path, scales=PERSON.leg.scales)
    read = imaged_leg.files.read(path)
    pose = imaged_leg.image_pose(path, read, PERSON.leg.scales)
    back = made.posed(pose, imaged_leg.SEGMENTS)
    for part, moved in zip(read.phantom.parts, back, strict=True):
        far = np.linalg.norm(moved - part.vertices, axis=1)
        # a few points are where the map folds; farther off than this it would warn
        assert np.quantile(far, 0.99) < 1e-7, part.name
        assert far.max() < imaged_leg._NOT_STRAIGHTENED, part.name


def test_a_phantom_prepared_for_swing_swings_soft_tissue_only(tmp_path):
    path = imported(tmp_path, 0, soft=True, reach=0.04)
    made = imaged_leg.load_imaged_leg(path, scales=PERSON.leg.scales, swinging=True)
    names = (*imaged_leg.SEGMENTS, "swing_of_femur_l", "swing_of_tibia_l")
    pose = np.concatenate(
        [made.reference_world_from_segment, np.broadcast_to(np.eye(4), (2, 4, 4))]
    )
    pose[-2:, 0, 3] = 0.003
    still = [part.vertices for part in made.phantom.parts]
    for part, segment, moved, rest in zip(
        made.phantom.parts, made.segments, made.posed(pose, names), still, strict=True
    ):
        shift = np.abs(moved - rest).max()
        assert shift == pytest.approx(0.003, abs=1e-6) if part.name == "skin_l" else True
        assert shift < 1e-9 or segment.startswith("soft")


def test_landmarks_that_somebody_moved_count_as_they_are(bones):
    read = imaged_leg.files.read(bones)

    def shank(*shift: float) -> np.ndarray:
        moved = {"l": {name: point + shift for name, point in read.landmarks["l"].items()}}
        pose = imaged_leg.image_pose(bones, replace(read, landmarks=moved), PERSON.leg.scales)
        return pose[imaged_leg.SEGMENTS.index("tibia_l")][:3, 3]

    apart = shank(0.011, 0.02, 0.03) - shank(0.001, 0, 0)
    np.testing.assert_allclose(apart, (0.01, 0.02, 0.03), atol=1e-9)


def test_found_landmarks_do_as_well_as_those_of_the_file(bones):
    read = imaged_leg.files.read(bones)
    poses = [
        imaged_leg.image_pose(bones, one, PERSON.leg.scales)
        for one in (read, replace(read, landmarks={}))
    ]
    assert np.abs(poses[0][:, :3, 3] - poses[1][:, :3, 3]).max() < 0.0005


def test_another_length_of_the_thigh_is_reported(bones):
    large = replace(PERSON.leg.scales, factors=1.1 * PERSON.leg.scales.factors)
    with pytest.warns(ImagedLegWarning) as caught:
        imaged_leg.load_imaged_leg(bones, scales=large)
    texts = [str(one.message) for one in caught]
    assert [text.split(" is ")[0].split(": ")[1] for text in texts] == [
        "the thigh of side l",
        "the shank of side l",
    ]


def test_parts_that_no_leg_carries_are_refused(bones, tmp_path):
    text = bones.read_text().replace('segment = "patella_l"\n', "", 1)
    path = bones.with_name("without.toml")
    path.write_text(text)
    with pytest.raises(LegsimError, match=r"without\.toml.*patella.*has no segment"):
        imaged_leg.load_imaged_leg(path)


def test_a_knee_turned_the_wrong_way_is_refused(bones):
    read = imaged_leg.files.read(bones)
    wrong = {side: dict(points) for side, points in read.landmarks.items()}
    wrong["l"]["ankle"] = wrong["l"]["ankle"] + (0.4, 0, 0)
    with pytest.raises(LegsimError, match="flexed by -"), warnings.catch_warnings():
        imaged_leg.image_pose(bones, replace(read, landmarks=wrong), PERSON.leg.scales)


@pytest.mark.parametrize(("angle", "outcome"), [(5, "as 5"), (-20, "as -15"), (-30, "by -30")])
def test_short_stumps_are_reported_and_their_flexion_kept_plausible(angle, outcome):
    stumps = {"thigh": 0.06, "shank": 0.07}
    with pytest.raises((LegsimError, ImagedLegWarning), match=outcome):
        warnings.simplefilter("error", ImagedLegWarning)
        imaged_leg._plausible(Path("p.toml"), np.radians(angle), stumps, "l")
    with pytest.raises(LegsimError, match="flexed by -20"):
        imaged_leg._plausible(Path("p.toml"), np.radians(-20), {"shank": 0.3}, "l")


def test_the_key_follows_every_mesh(bones):
    before = imaged_leg.content_key(bones)
    mesh = next(bones.parent.glob("femur*.ply"))
    content = mesh.read_bytes()
    try:
        mesh.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
        assert imaged_leg.content_key(bones) != before
        mesh.unlink()
        with pytest.raises(LegsimError, match="cannot be read"):
            imaged_leg.content_key(bones)
    finally:
        mesh.write_bytes(content)
    assert imaged_leg.content_key(bones) == before
