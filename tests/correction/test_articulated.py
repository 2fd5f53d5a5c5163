"""A scanned knee of simple solids whose bones move each by itself."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.correction import articulated
from legsim.correction.articulated import Articulated, follow_limbs, limbs_of
from legsim.correction.control_points import AttachedPoint
from legsim.correction.limb_motion import Limb, articulated_motion, patella_motion
from legsim.correction.method import Scan
from legsim.deformation.models import FieldMotion, RigidMotion
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.imu.signals import ImuSignals, SensorStart
from legsim.phantom.meshes import Part, Phantom
from legsim.scan import projector
from tests.examples import knee

pytestmark = pytest.mark.filterwarnings("ignore::legsim.reconstruction.weights.ShortScanWarning")
VIEWS = np.arange(124) / 15.5
NODES = VolumeGrid.cubic(1, 0.19, [0.0, 0.0, 0.0]).coarse(0.012)
HIP, KNEE, ANKLE = knee.JOINTS


def geometry() -> ConeBeamGeometry:
    return ConeBeamGeometry.circular(
        times=VIEWS,
        angles=np.radians(1.6) * np.arange(124),
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=(96, 124),
        pixel_pitch=3.08e-3,
        isocenter=(0.0, 0.0, 0.0),
    )


def moving() -> Limb:
    """The thigh sways by 2 degrees, the knee bends by 4."""
    share = np.sin(2 * np.pi * VIEWS / 9)[:, None]
    sway = transforms.rigid(
        transforms.rotation_from_vector(0.03 * share * [1.0, 0.4, 0.2]), 0.004 * share
    )
    bend = transforms.rigid(
        transforms.axis_rotation((0, 0, 1), -np.radians(4) * VIEWS / VIEWS[-1]), np.zeros(3)
    )
    return Limb(knee.JOINTS, sway, sway @ bend)


def true_motions() -> dict[str, RigidMotion]:
    limb = moving()
    thigh, shank = np.moveaxis(limb.motions(), 1, 0)
    cap = patella_motion(thigh, shank, limb.joints, knee.PATELLA)
    named = {"femur": thigh, "tibia": shank, "patella": cap}
    return {name: RigidMotion(VIEWS, moved) for name, moved in named.items()}


def rod(start: FloatArray, end: FloatArray, radius: float) -> trimesh.Trimesh:
    return trimesh.creation.cylinder(radius=radius, segment=np.stack([start, end]), sections=32)


def ball(center: FloatArray, radius: float) -> trimesh.Trimesh:
    made = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    return made.apply_translation(center)


def solids() -> dict[str, list[trimesh.Trimesh]]:
    down = (ANKLE - KNEE) / np.linalg.norm(ANKLE - KNEE)
    return {
        "femur": [ball(KNEE, 0.024), rod(KNEE, np.array([0, 0.15, 0]), 0.014)],
        "tibia": [
            rod(0.029 * down, 0.05 * down, 0.03),
            rod(0.045 * down, 0.15 * down, 0.014),
        ],
        "patella": [ball(knee.PATELLA, 0.014)],
    }


def exposed(device) -> Projections:
    """Bones in flesh, which moves with thigh and shank."""
    truth, down = true_motions(), (ANKLE - KNEE) / np.linalg.norm(ANKLE - KNEE)
    up = np.array([0, 0.15, 0])
    flesh = [("femur", rod(KNEE, up, 0.05)), ("tibia", rod(KNEE, 0.15 * down, 0.05))]
    flesh += [("femur", ball(KNEE, 0.05)), ("patella", ball(knee.PATELLA, 0.02))]
    bones = [(name, mesh) for name, meshes in solids().items() for mesh in meshes]
    parts, motions = [], []
    for number, (name, mesh) in enumerate([*flesh, *bones]):
        value = knee.SOFT if number < len(flesh) else knee.CORTEX
        vertices, triangles = np.asarray(mesh.vertices), np.asarray(mesh.faces)
        parts.append(Part(f"{name}_{number}", "made", value, vertices, triangles))
        motions.append(truth[name].moved_from_reference)
    placed = [
        tuple(transforms.apply(m[view], p.vertices) for p, m in zip(parts, motions, strict=True))
        for view in range(len(VIEWS))
    ]
    return projector.project(
        Phantom(tuple(parts)), geometry(), device, posed=lambda view: placed[view]
    )


def missed(motion: FieldMotion, name: str) -> float:
    """m, RMS error over a bone's points within the nodes and views."""
    points = np.concatenate([np.asarray(mesh.vertices) for mesh in solids()[name]])
    points = points[(np.abs(points) < 0.08).all(-1)]
    true = true_motions()[name].carry(points)
    return float(np.sqrt(((motion.carry(points) - true) ** 2).sum(-1).mean()))


def test_each_bone_is_found_and_followed(device):
    motion, (note,) = follow_limbs(exposed(device), [moving()], NODES, device)
    assert "cm^3 of the femur" in note
    assert "patella" in note
    loose = articulated_motion(VIEWS, [moving()], NODES).on_grid(NODES)
    for name in ("femur", "tibia", "patella"):
        assert missed(motion, name) < 2e-4
        assert missed(motion, name) < 0.5 * missed(loose, name)


def test_without_bones_the_axes_alone_decide_and_that_is_reported(device):
    air = Projections(geometry(), np.zeros((124, 96, 124), np.float32))
    motion, (note,) = follow_limbs(air, [moving()], NODES, device)
    assert "nothing but air" in note
    assert "not rigid" in note
    np.testing.assert_array_equal(
        motion.displacements,
        articulated_motion(VIEWS, [moving()], NODES).on_grid(NODES).displacements,
    )


def test_bones_are_looked_for_where_half_the_views_look():
    """Along the motion: what goes out of the detector in most views is not known."""
    grid = NODES
    volume = Volume(grid, np.ones(grid.shape_zyx, np.float32))
    still = RigidMotion.identity(VIEWS).on_grid(NODES)
    away = np.tile(np.eye(4), (124, 1, 1))
    away[50:, 1, 3] = 0.4
    gone = RigidMotion(VIEWS, away).on_grid(NODES)
    middle = tuple(n // 2 for n in grid.shape_zyx)
    assert articulated._seen(volume, geometry(), still).attenuation[middle] == 1
    assert (articulated._seen(volume, geometry(), gone).attenuation == 0).all()


def test_a_patella_that_the_first_reconstruction_smears_is_put_where_the_model_has_it(
    device, monkeypatch: pytest.MonkeyPatch
):
    """As in whole squats; here a knee that bends by 4 degrees is said to smear it."""
    monkeypatch.setattr(articulated, "_SMEARED", 1e-6)
    motion, (note,) = follow_limbs(exposed(device), [moving()], NODES, device)
    assert "taken to be where the published knee has it" in note
    assert "cm^3 of the patella" not in note
    assert missed(motion, "femur") < 1e-3


def test_a_note_says_only_of_a_patella_that_was_replaced_that_it_was(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
):
    """Nothing tells forward in a straight leg: its patella stays where it was seen."""
    monkeypatch.setattr(articulated, "_SMEARED", 1e-6)
    still = RigidMotion.identity(VIEWS).on_grid(NODES)
    led = replace(moving(), kneecap=true_motions()["patella"].moved_from_reference)
    limb, note = articulated._with_bones(led, knee.volume(rng), still)
    assert "fill a ball, which follows the motion that was given" in note
    monkeypatch.setattr(articulated, "expected_patella", lambda _: None)
    limb, note = articulated._with_bones(led, knee.volume(rng), still)
    assert "taken to be" not in note
    assert "cm^3 of the patella" in note
    assert limb.patella is not None
    np.testing.assert_allclose(limb.patella, knee.PATELLA, atol=1e-3)


def scan(signals: ImuSignals, starts: tuple[SensorStart, ...], joints=()) -> Scan:
    air = Projections(geometry(), np.zeros((124, 96, 124), np.float32))
    return Scan(air, signals, starts, joints)


def resting() -> Scan:
    """Two upright sensors at rest, half a meter and a meter above the ground."""
    times = np.arange(966) / 120
    force = np.broadcast_to([0, 9.80665, 0], (966, 2, 3))
    signals = ImuSignals(times, ("shank_l", "thigh_l"), np.zeros((966, 2, 3)), force)
    starts = tuple(
        SensorStart(transforms.translation(p), np.zeros(3)) for p in (0.5 * ANKLE, 0.5 * HIP)
    )
    places = (("thigh_l", 0.5 * HIP), ("shank_l", -0.5 * ANKLE), ("shank_l", 0.5 * ANKLE))
    leg = tuple(AttachedPoint(name, place) for name, place in places)
    return scan(signals, starts, (leg,))


def test_a_limb_is_where_its_joints_are_and_rests_where_it_rests():
    (limb,) = limbs_of(resting())
    np.testing.assert_allclose(limb.joints, knee.JOINTS, atol=1e-12)
    np.testing.assert_allclose(limb.motions(), np.tile(np.eye(4), (124, 2, 1, 1)), atol=1e-9)
    between = AttachedPoint("shank_l", np.zeros(3))  # further points of a segment come last
    (same,) = limbs_of(replace(resting(), joints=((*resting().joints[0], between),)))
    np.testing.assert_array_equal(same.joints, limb.joints)


def test_nodes_lie_around_the_center_where_none_are_given(device, monkeypatch):
    monkeypatch.setattr(articulated, "_SEEN_AT", 0.02)
    found = Articulated(device=device)(resting())
    assert isinstance(found.motion, FieldMotion)
    np.testing.assert_allclose(found.motion.grid.center, 0, atol=1e-9)
    assert found.motion.grid.spacing_xyz == (0.008, 0.008, 0.008)
    assert np.abs(found.motion.displacements).max() < 1e-9


def test_a_scan_that_knows_no_joint_is_refused():
    with pytest.raises(LegsimError, match="knows the place of hip, knee and ankle on no sensor"):
        Articulated(NODES)(replace(resting(), joints=()))


def test_bones_are_looked_for_around_the_legs_alone():
    """In the voxels of the whole grid; all of it where the leg is beside it."""
    fine = NODES.coarse(0.01)
    part = articulated._around_legs(fine, [moving()])
    assert np.prod(part.shape_zyx) < 0.9 * np.prod(fine.shape_zyx)
    offset = (part.origin - fine.origin) / fine.spacing_xyz
    np.testing.assert_allclose(offset, np.round(offset), atol=1e-9)
    beside = replace(moving(), joints=knee.JOINTS + np.array([5.0, 0, 0]))
    assert articulated._around_legs(fine, [beside]) == fine


def test_a_source_of_the_patella_reaches_the_scanned_leg(monkeypatch: pytest.MonkeyPatch):
    """A sensor by its name, and a motion as it is."""
    seen: list[Limb] = []

    def kept(_: Projections, limbs: Sequence[Limb], *__: object) -> tuple[None, tuple[str, ...]]:
        seen.extend(limbs)
        return None, ()

    monkeypatch.setattr(articulated, "follow_limbs", kept)
    motion = true_motions()["patella"]
    at_rest = resting()
    for source in (None, at_rest.joints[0][2].sensor, motion):
        Articulated(NODES, kneecap=source)(at_rest)
    assert seen[0].kneecap is None
    np.testing.assert_array_equal(seen[1].kneecap, seen[1].shank)
    np.testing.assert_array_equal(seen[2].kneecap, motion.moved_from_reference)


def test_a_patella_of_other_times_or_an_unknown_sensor_is_refused():
    late = RigidMotion.identity(VIEWS + 1.0)
    with pytest.raises(LegsimError, match="give it at the views' times"):
        Articulated(NODES, kneecap=late)(resting())
    with pytest.raises(LegsimError, match="unknown sensor 'nobody'"):
        Articulated(NODES, kneecap="nobody")(resting())
