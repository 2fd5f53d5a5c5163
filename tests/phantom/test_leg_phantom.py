"""The leg phantom: closed, nested, sized to a person, and posed without parts leaving or crossing
each other.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.kinematics import osim_file
from legsim.kinematics.leg_model import COORDINATES, LegModel
from legsim.kinematics.osim_leg import OsimLeg
from legsim.kinematics.skeleton import SEGMENTS, SegmentScales
from legsim.mocap.trajectories import JointTrajectories
from legsim.phantom import _leg_template, leg_phantom, materials
from legsim.phantom.leg_phantom import LegPhantom
from tests.examples import osim

CARTILAGE_PENETRATION = 0.0005
"""m by which faces of a joint may cross between 0 and 110 degrees: the coarse meshes' chords, and
femora scaled unevenly in x and y
"""
MOTIONS = Path(__file__).parents[2] / "motions"


@pytest.fixture(scope="module")
def legs() -> LegPhantom:
    return leg_phantom.load_leg_phantom()


def pose(degrees=0.0, *, scales=None, **coordinates) -> np.ndarray:
    """world_from_segment (13, 4, 4): both knees flexed, other coordinates by name in degrees."""
    values = np.zeros((1, len(COORDINATES)))
    for side in "lr":
        values[0, COORDINATES.index(f"knee_angle_{side}")] = -np.radians(degrees)
    for name, angle in coordinates.items():
        values[0, COORDINATES.index(name)] = np.radians(angle)
    return (
        LegModel.load(scales)
        .segment_poses(JointTrajectories([0.0], COORDINATES, values))
        .world_from_segment[0]
    )


def random_pose(rng) -> np.ndarray:
    """Anywhere a squatting or standing person gets to, both legs different."""
    ranges = {
        "hip_flexion": (-15, 100),
        "hip_adduction": (-25, 5),
        "hip_rotation": (-25, 25),
        "knee_angle": (-110, 5),
    }
    ranges |= {"ankle_angle": (-25, 35), "subtalar_angle": (-10, 10)}
    named = {f"{n}_{side}": rng.uniform(*limits) for n, limits in ranges.items() for side in "lr"}
    return pose(**named, pelvis_tilt=rng.uniform(-30, 30), pelvis_rotation=rng.uniform(-180, 180))


def mesh(legs, vertices, name) -> trimesh.Trimesh:
    k = legs.part_index(name)
    return trimesh.Trimesh(vertices[k], legs.phantom.parts[k].triangles, process=False)


def depth_within(surface: trimesh.Trimesh, points) -> np.ndarray:
    """(p,) m that points lie inside a surface, negative outside: along the normal of the nearest of
    many points of it.
    """
    places, faces = trimesh.sample.sample_surface_even(surface, 60000, seed=1)
    _, nearest = cKDTree(places).query(points)
    return -((points - places[nearest]) * surface.face_normals[faces[nearest]]).sum(1)


def assert_closed(surface: trimesh.Trimesh, name: str) -> None:
    assert surface.is_watertight, name
    assert surface.is_winding_consistent, name
    assert surface.volume > 0, name


def test_every_surface_of_both_legs_is_closed_and_faces_outward(legs):
    vertices = legs.posed(legs.reference_world_from_segment, SEGMENTS)
    for part, moved in zip(legs.phantom.parts, vertices, strict=True):
        assert_closed(mesh(legs, vertices, part.name), part.name)
        np.testing.assert_allclose(moved, part.vertices, atol=1e-12)


def test_left_and_right_mirror_each_other(legs):
    for part in legs.phantom.parts:
        if part.name.endswith("_l"):
            other = legs.phantom.parts[legs.part_index(f"{part.name[:-2]}_r")]
            np.testing.assert_allclose(part.vertices * [1, 1, -1], other.vertices, atol=1e-12)
            np.testing.assert_array_equal(part.triangles[:, ::-1], other.triangles)


@pytest.mark.parametrize(
    ("inner", "outer"),
    [
        ("fat", "skin"),
        ("muscle_quadriceps", "fat"),
        ("muscle_soleus", "fat"),
        ("femur_cancellous", "femur_cortex"),
        ("femur_marrow", "femur_cancellous"),
        ("tibia_cancellous", "tibia_cortex"),
        ("tibia_marrow", "tibia_cancellous"),
        ("fibula_cancellous", "fibula_cortex"),
        ("patella_cancellous", "patella_cortex"),
    ],
)
def test_layers_nest(legs, inner, outer):
    vertices = [part.vertices for part in legs.phantom.parts]
    assert (
        mesh(legs, vertices, f"{outer}_r").contains(vertices[legs.part_index(f"{inner}_r")]).all()
    )


def assert_bones_inside_fat_inside_skin(legs, poses) -> None:
    vertices = legs.posed(poses, SEGMENTS)
    for side in "lr":
        skin, fat = mesh(legs, vertices, f"skin_{side}"), mesh(legs, vertices, f"fat_{side}")
        assert skin.contains(fat.vertices).all(), side
        for part, moved in zip(legs.phantom.parts, vertices, strict=True):
            if part.name.endswith(f"cortex_{side}"):
                assert fat.contains(moved).all(), part.name


@pytest.mark.parametrize("degrees", [0, 35, 70, 110])
def test_flexed_bones_stay_inside_fat_inside_skin(legs, degrees):
    assert_bones_inside_fat_inside_skin(
        legs, pose(degrees, hip_flexion_l=0.6 * degrees, ankle_angle_r=0.25 * degrees)
    )


def test_random_poses_keep_bones_inside_and_volume_and_surfaces(legs, rng):
    before = {
        side: mesh(legs, [p.vertices for p in legs.phantom.parts], f"skin_{side}").volume
        for side in "lr"
    }
    for _ in range(4):
        poses = random_pose(rng)
        assert_bones_inside_fat_inside_skin(legs, poses)
        vertices = legs.posed(poses, SEGMENTS)
        for side in "lr":
            assert mesh(legs, vertices, f"skin_{side}").volume == pytest.approx(
                before[side], rel=0.03
            )
        for part in legs.phantom.parts:
            assert_closed(mesh(legs, vertices, part.name), part.name)


def joint_penetrations(legs, poses) -> dict[str, float]:
    """Deepest place (m) of one cartilage inside the other body of its joint, right leg."""
    vertices = legs.posed(poses, SEGMENTS)
    deepest = {}
    for name in ("tibia_cartilage_medial_r", "tibia_cartilage_lateral_r", "patella_cartilage_r"):
        points = vertices[legs.part_index(name)]
        inside = np.zeros(len(points), bool)
        for body in ("femur_cartilage_r", "femur_cortex_r"):
            inside |= mesh(legs, vertices, body).contains(points)
        depths = (
            depth_within(mesh(legs, vertices, "femur_cartilage_r"), points[inside])
            if inside.any()
            else np.zeros(1)
        )
        deepest[name] = float(depths.max())
    return deepest


@pytest.mark.parametrize("degrees", [0, 15, 30, 60, 90, 110])
def test_cartilages_do_not_cross_and_meet_closely(legs, degrees):
    poses = pose(degrees)
    for name, depth in joint_penetrations(legs, poses).items():
        assert depth < CARTILAGE_PENETRATION, name
    vertices = legs.posed(poses, SEGMENTS)
    femur = cKDTree(
        trimesh.sample.sample_surface_even(
            mesh(legs, vertices, "femur_cartilage_r"), 40000, seed=1
        )[0]
    )
    for side in ("medial", "lateral"):
        gap = np.min(femur.query(vertices[legs.part_index(f"tibia_cartilage_{side}_r")])[0])
        assert gap < 0.001, side


def test_the_joint_still_fits_when_thigh_and_shank_are_sized_apart():
    factors = np.ones((len(SEGMENTS), 3))
    for side in "lr":
        factors[SEGMENTS.index(f"femur_{side}")] = 1.08
        factors[SEGMENTS.index(f"tibia_{side}")] = 0.93
    scales = SegmentScales(factors)
    legs = leg_phantom.load_leg_phantom(scales=scales)
    for degrees in (0, 60, 100):
        poses = pose(degrees, scales=scales)
        assert max(joint_penetrations(legs, poses).values()) < CARTILAGE_PENETRATION
        assert_bones_inside_fat_inside_skin(legs, poses)


def recorded(subject: str, trial: str) -> tuple[SegmentScales, np.ndarray]:
    """Scales of a subject and world_from_segment (n, 13, 4, 4) of a trial that ships with legsim,
    as it was simulated.
    """
    with np.load(MOTIONS / subject / f"{trial}_truth.npz") as stored:
        scales = SegmentScales(stored["segment_scales"])
        values = 1e-6 * stored["coordinate_micros"].T
        trajectories = JointTrajectories(
            np.arange(len(values)) / 120, tuple(stored["coordinate_names"]), values
        )
    return scales, LegModel.load(scales).segment_poses(trajectories).world_from_segment


def assert_legs_hold_together(legs, poses) -> None:
    assert_bones_inside_fat_inside_skin(legs, poses)
    assert max(joint_penetrations(legs, poses).values()) < CARTILAGE_PENETRATION


def deepest(poses) -> int:
    return int(np.argmin(poses[:, SEGMENTS.index("femur_l"), 1, 3]))


@pytest.mark.parametrize("subject", [f"subject0{k}" for k in range(1, 8)])
def test_the_deepest_squat_of_every_recorded_person_holds_together(subject):
    scales, poses = recorded(subject, "squats")
    assert_legs_hold_together(leg_phantom.load_leg_phantom(scales=scales), poses[deepest(poses)])


@pytest.mark.slow
@pytest.mark.parametrize("trial", ["squat_30", "squat_60", "squats"])
@pytest.mark.parametrize("subject", [f"subject0{k}" for k in range(1, 8)])
def test_recordings_hold_together_throughout(subject, trial):
    scales, poses = recorded(subject, trial)
    legs = leg_phantom.load_leg_phantom(scales=scales)
    for frame in range(0, len(poses), 120):
        assert_legs_hold_together(legs, poses[frame])


def test_the_reference_pose_is_the_leg_models(rng):
    scales = SegmentScales(rng.uniform(0.85, 1.15, (len(SEGMENTS), 3)))
    expected, result = pose(scales=scales), _leg_template.reference_pose(scales)
    for side in "lr":
        members = [SEGMENTS.index(s) for s in SEGMENTS if s.endswith(f"_{side}")]
        hip = SEGMENTS.index(f"femur_{side}")
        for matrices in (expected, result):
            assert matrices.shape == (len(SEGMENTS), 4, 4)
        np.testing.assert_allclose(
            transforms.inverse(result[hip]) @ result[members],
            transforms.inverse(expected[hip]) @ expected[members],
            atol=1e-6,
        )


def test_size_follows_the_factors():
    large = leg_phantom.load_leg_phantom(scales=SegmentScales.uniform(1.1))
    plain = leg_phantom.load_leg_phantom()
    for a, b in zip(large.phantom.parts, plain.phantom.parts, strict=True):
        np.testing.assert_allclose(a.vertices, 1.1 * b.vertices, atol=1e-9)


def test_material_points_go_where_the_surfaces_go(legs, rng):
    start, end = pose(55, hip_flexion_r=40), pose(80, hip_flexion_r=60, ankle_angle_r=10)
    before, after = legs.posed(start, SEGMENTS), legs.posed(end, SEGMENTS)
    for name in ("skin_r", "muscle_soleus_r", "femur_cortex_r", "patella_cartilage_l", "skin_l"):
        k = legs.part_index(name)
        chosen = rng.choice(len(before[k]), min(300, len(before[k])), replace=False)
        (moved,) = legs.paths(
            before[k][chosen], legs.segments[k], start=start, poses=[end], segment_names=SEGMENTS
        )
        np.testing.assert_allclose(moved, after[k][chosen], atol=1e-7)


def test_rigid_motion_of_everything_is_carried_exactly(legs, rng):
    motion = transforms.rigid(
        transforms.rotation_from_vector(rng.normal(size=3)), rng.normal(size=3)
    )
    still = pose(70)
    for a, b in zip(legs.posed(still, SEGMENTS), legs.posed(motion @ still, SEGMENTS), strict=True):
        np.testing.assert_allclose(transforms.apply(motion, a), b, atol=1e-12)


def test_beads_stay_on_the_skin_and_fiducials_on_their_segment(legs):
    places = legs.skin_points("l", heights=[0.05, 0.0, -0.05], directions=[1.0, -1.2, 0.4])
    beads = legs.with_spheres("bead", places, segment="soft_l", radius=0.0005)
    both = beads.with_spheres(
        "fiducial", [[0.0, -0.14, 0.05]], segment="tibia_l", radius=0.001, material="steel"
    )
    poses = pose(65)
    vertices = both.posed(poses, SEGMENTS)
    skin = trimesh.Trimesh(
        vertices[both.part_index("skin_l")],
        both.phantom.parts[both.part_index("skin_l")].triangles,
        process=False,
    )
    for k in range(3):
        part = both.part_index(f"bead_{k}")
        center = vertices[part].mean(0)
        np.testing.assert_allclose(
            np.linalg.norm(vertices[part] - center, axis=1), 0.0005, rtol=1e-6
        )
        assert abs(depth_within(skin, center[None])[0]) < 0.0015
        assert both.phantom.parts[part].attenuation == materials.attenuation("tantalum")
    center = vertices[both.part_index("fiducial_0")].mean(0)
    np.testing.assert_allclose(
        center,
        transforms.apply(poses[SEGMENTS.index("tibia_l")], [[0.0, -0.14, 0.05]])[0],
        atol=1e-9,
    )
    assert len(legs.phantom.parts) == len(both.phantom.parts) - 4


def test_one_leg_is_that_leg_of_both_and_carries_on_alone(legs):
    poses, swung = pose(65), leg_phantom.load_leg_phantom(swinging=True)
    for side, whole in (("l", legs), ("r", legs), ("l", swung)):
        alone, vertices = whole.one_leg(side), whole.posed(poses, SEGMENTS)
        assert [p.name for p in alone.phantom.parts] == [
            p.name for p in whole.phantom.parts if p.name.endswith(f"_{side}")
        ]
        for part, found in zip(alone.phantom.parts, alone.posed(poses, SEGMENTS), strict=True):
            np.testing.assert_array_equal(found, vertices[whole.part_index(part.name)])
        places = alone.skin_points(side, heights=[0.05], directions=[1.0])
        beaded = alone.with_spheres("bead", places, segment=f"soft_{side}", radius=0.0005)
        assert len(beaded.posed(poses, SEGMENTS)) == len(alone.phantom.parts) + 1


def test_attenuation_follows_the_energy(legs):
    soft = leg_phantom.load_leg_phantom(energy_kev=100.0)
    for low, high in zip(legs.phantom.parts, soft.phantom.parts, strict=True):
        assert high.attenuation == materials.attenuation(high.material, 100.0) < low.attenuation


def test_refusals_name_the_cure(legs):
    with pytest.raises(LegsimError, match="no pose for the segment calcn_l"):
        legs.posed(legs.reference_world_from_segment[:2], SEGMENTS[:2])
    with pytest.raises(LegsimError, match=r"13 segments are named: expected \(s, 4, 4\)"):
        legs.posed(legs.reference_world_from_segment[:2], SEGMENTS)
    with pytest.raises(LegsimError, match="unknown part 'bone'; known: skin_l"):
        legs.part_index("bone")
    with pytest.raises(LegsimError, match="unknown segment 'arm'; known: soft_l"):
        legs.with_spheres("bead", [[0, 0, 0]], segment="arm", radius=0.001)
    with pytest.raises(LegsimError, match="positive radius"):
        legs.with_spheres("bead", [[0, 0, 0]], segment="tibia_l", radius=0.0)
    with pytest.raises(LegsimError, match="does not leave skin_l"):
        legs.skin_points("l", heights=[2.0], directions=[0.0])


@pytest.fixture
def build():
    from tools.leg_phantom import build as build_leg_phantom

    return build_leg_phantom


def test_the_script_rebuilds_what_is_stored(build):
    with np.load(build.FOLDER / "coarse.npz") as stored:
        for block in build.blocks()[-1:]:
            for name, surface in block.meshes(build.DETAILS["coarse"]).items():
                vertices, triangles = build.compact(surface)
                np.testing.assert_array_equal(triangles, stored[f"{name}.triangles"])
                np.testing.assert_allclose(vertices, stored[f"{name}.vertices"], atol=1e-7)


@pytest.mark.slow
def test_the_script_rebuilds_both_details_bit_for_bit(build, tmp_path):
    for detail in build.DETAILS:
        np.savez_compressed(tmp_path / f"{detail}.npz", allow_pickle=False, **build.build(detail))
        assert (tmp_path / f"{detail}.npz").read_bytes() == (
            build.FOLDER / f"{detail}.npz"
        ).read_bytes()


@pytest.mark.slow
def test_the_fine_phantom_obeys_the_same_laws(rng):
    fine = leg_phantom.load_leg_phantom(detail="fine")
    for degrees in (0, 60, 110):
        poses = pose(degrees)
        assert max(joint_penetrations(fine, poses).values()) < CARTILAGE_PENETRATION
        assert_bones_inside_fat_inside_skin(fine, poses)
    vertices = fine.posed(random_pose(rng), SEGMENTS)
    for part in fine.phantom.parts:
        assert_closed(mesh(fine, vertices, part.name), part.name)


def test_its_joint_centers_are_those_of_a_users_own_model(tmp_path):
    """Whose knee lies off the femur's axis and whose ankle off the tibia's."""
    joints = osim.two_legs()
    for k, z in ((2, 0.004), (5, -0.004)):
        joints[k] = replace(joints[k], at=f"0.01 -0.45 {z}", child_at=f"-0.008 -0.004 {z / 2}")
        joints[k + 1] = replace(joints[k + 1], at="-0.012 -0.37 0")
    leg = OsimLeg(osim_file.read(osim.saved(tmp_path, osim.version_4(joints))))
    rest = leg_phantom.load_leg_phantom(scales=leg.scales).reference_world_from_segment
    straight = leg.kinematics(np.zeros((1, len(leg.coordinate_names))))
    world = transforms.rigid(straight.rotations, straight.origins)[0]
    for side in "rl":
        for upper, lower in (("femur", "tibia"), ("tibia", "talus")):
            a, b = (SEGMENTS.index(f"{part}_{side}") for part in (upper, lower))
            theirs = (transforms.inverse(world[a]) @ world[b])[:3, 3]
            ours = (transforms.inverse(rest[a]) @ rest[b])[:3, 3]
            np.testing.assert_allclose(ours, theirs, atol=1e-12)
