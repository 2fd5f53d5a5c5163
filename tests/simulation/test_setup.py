"""A person placed in the C-arm: on either side, about any point, with or without the other leg."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.ndimage import maximum_filter, minimum_filter

from legsim.core.errors import LegsimError
from legsim.geometry.volume import VolumeGrid
from legsim.imu.sensors import Sensor
from legsim.imu.skin_mount import SkinMount
from legsim.kinematics.moving_leg import MovingLeg
from legsim.opencl import device
from legsim.phantom import voxelize
from legsim.phantom.imaged_leg import ImagedLegWarning
from legsim.phantom.skinning import swing_of
from legsim.scan.c_arm import CArm
from legsim.simulation import setup as simulation_setup
from legsim.simulation.setup import PhantomOptions, prepare_scan
from tests.examples.squat import ARM, GRID_VOXELS, squatting


@pytest.fixture(scope="module")
def person() -> MovingLeg:
    return squatting()


def test_its_times_are_those_of_the_views(person):
    setup = prepare_scan(person, ARM)
    np.testing.assert_array_equal(setup.times, setup.geometry.times)
    np.testing.assert_array_equal(setup.times, ARM.view_times(person.trajectories.times))


@pytest.mark.parametrize("late", [1e-3, None])
def test_poses_at_other_times_are_refused(person, late):
    setup = prepare_scan(person, ARM)
    poses = replace(setup.poses, times=setup.times + late) if late else setup.poses.held_at(0)
    geometry = setup.geometry if late else setup.geometry[:2]
    with pytest.raises(LegsimError, match="at the times of the geometry"):
        replace(setup, poses=poses, geometry=geometry)


@pytest.mark.parametrize("side", ["left", "right"])
def test_the_axis_goes_through_the_knee_of_the_scanned_leg_at_the_first_view(person, side):
    setup = prepare_scan(person, ARM, side=side)
    knee = person.leg.joint_centers(setup.poses).of(f"knee_{side[0]}")[0]
    np.testing.assert_allclose(setup.geometry.rotation_center(), knee, atol=1e-9)
    assert (setup.named("tibia"), setup.side) == (f"tibia_{side[0]}", side)
    assert {sensor.segment for sensor in setup.sensors} == {f"tibia_{side[0]}", f"femur_{side[0]}"}


def test_a_center_in_the_world_is_where_the_c_arm_turns(person):
    center = np.array([0.05, 0.6, 0.0])
    knee, elsewhere = prepare_scan(person, ARM), prepare_scan(person, ARM, center=center)
    np.testing.assert_allclose(elsewhere.geometry.rotation_center(), center, atol=1e-9)
    shift = center - knee.geometry.rotation_center()
    np.testing.assert_allclose(
        elsewhere.geometry.sources(), knee.geometry.sources() + shift, atol=1e-9
    )
    np.testing.assert_array_equal(elsewhere.poses.world_from_segment, knee.poses.world_from_segment)


@pytest.mark.parametrize("side", ["left", "right"])
def test_the_scanned_leg_alone_has_no_part_of_the_other(person, side):
    both, alone = (
        prepare_scan(
            person, ARM, side=side, phantom=PhantomOptions(legs=legs)
        ).phantom.phantom.parts
        for legs in ("both", "scanned")
    )
    expected = [part.name for part in both if part.name.endswith(f"_{side[0]}")]
    assert [part.name for part in alone] == expected
    assert len(both) == 2 * len(alone)


def test_swinging_tissue_is_in_the_poses_and_none_where_it_has_no_amplitude(person):
    tissue = SkinMount(10.0, 0.25)
    swung, still = (
        prepare_scan(person, ARM, phantom=PhantomOptions(tissue_swing=t)).poses.segment_names
        for t in (tissue, replace(tissue, amplitude=0.0))
    )
    assert set(swung) - set(still) == {
        swing_of(f"{bone}_{side}") for bone in ("femur", "tibia") for side in "lr"
    }


@pytest.mark.parametrize("side", ["left", "right"])
def test_regions_are_of_the_scanned_leg(person, side):
    """All of a leg's voxels lie nearer to its own knee than to the other."""
    setup = prepare_scan(person, ARM, side=side)
    grid = VolumeGrid.cubic(GRID_VOXELS, 6e-3, setup.geometry.rotation_center().tolist())
    leg, shank, thigh = simulation_setup.scan_regions(setup, grid, device.open_device())
    centers = person.leg.joint_centers(setup.poses)
    own, other = (centers.of(f"knee_{s}")[0, 2] for s in (side[0], "lr".replace(side[0], "")))
    z = grid.axes()[2][np.nonzero(leg.mask)[0]]
    assert leg.mask.sum() > 100
    assert (np.abs(z - own) < np.abs(z - other)).all()
    assert shank.mask.any()
    assert thigh.mask.any()
    assert not (shank.mask & thigh.mask).any()


@pytest.mark.parametrize("side", ["left", "right"])
def test_the_true_volume_is_the_phantom_around_the_regions(person, side):
    """Where a voxel's neighbors are of one part, it has that part's attenuation."""
    setup = prepare_scan(person, ARM, side=side)
    grid = VolumeGrid.cubic(GRID_VOXELS, 6e-3, setup.geometry.rotation_center().tolist())
    opened = device.open_device()
    regions = simulation_setup.scan_regions(setup, grid, opened)
    phantom, posed = setup.phantom.phantom, setup.scanned_leg()
    found = simulation_setup.true_volume(setup, grid, opened, regions).attenuation
    labels = voxelize.labels(phantom, grid, opened, posed=posed)
    even = (maximum_filter(labels, 3) == minimum_filter(labels, 3)) & regions[0].mask
    table = np.array([0.0, *(part.attenuation for part in phantom.parts)])
    # a part thinner than a voxel may lie between centers
    close = np.isclose(found[even], table[labels[even]], rtol=1e-5)
    assert close.mean() > 0.95
    assert len(np.unique(labels[even])) > 2
    assert (found <= table.max() * (1 + 1e-6)).all()


def test_a_leg_without_both_sensors_has_no_joints_on_them(person):
    shank = Sensor.placed("shank_l", "tibia_l", 0.14)
    setup = prepare_scan(person, ARM, sensors=(shank,))
    assert simulation_setup.joints_on_sensors(setup) == ()


def test_joints_on_sensors_are_the_true_ones_at_the_first_view(person):
    setup = prepare_scan(person, ARM, side="right")
    (leg,) = simulation_setup.joints_on_sensors(setup, points_per_segment=1)
    centers = person.leg.joint_centers(setup.poses)
    hip, knee, ankle = (centers.of(f"{j}_r")[0] for j in ("hip", "knee", "ankle"))
    carried = {s.name: s for s in setup.sensors}
    for point, expected in zip(
        leg, (hip, knee, ankle, (hip + knee) / 2, (knee + ankle) / 2), strict=True
    ):
        sensor = carried[point.sensor]
        pose = setup.poses.of(sensor.segment)[0] @ sensor.segment_from_sensor
        np.testing.assert_allclose(
            pose[:3, :3] @ point.position_sensor + pose[:3, 3], expected, atol=1e-9
        )
    assert [p.sensor for p in leg] == ["thigh_r", "shank_r", "shank_r", "thigh_r", "shank_r"]


def test_the_knee_on_the_thigh_is_where_the_shanks_sensor_has_it(person):
    setup = prepare_scan(person, ARM, side="right")
    knee = simulation_setup.knee_on_thigh(setup)
    assert knee is not None
    (leg,) = simulation_setup.joints_on_sensors(setup)
    carried = {s.name: s for s in setup.sensors}
    places = []
    for point in (knee, leg[1]):
        carrier = carried[point.sensor]
        pose = setup.poses.of(carrier.segment)[0] @ carrier.segment_from_sensor
        places.append(pose[:3, :3] @ point.position_sensor + pose[:3, 3])
    assert (knee.sensor, leg[1].sensor) == ("thigh_r", "shank_r")
    np.testing.assert_allclose(*places, atol=1e-9)
    shank = prepare_scan(person, ARM, sensors=(Sensor.placed("shank_l", "tibia_l", 0.14),))
    assert simulation_setup.knee_on_thigh(shank) is None


def test_its_repr_names_leg_person_and_c_arm(person):
    shown = repr(prepare_scan(person, ARM, side="right"))
    assert shown == f"ScanSetup(right leg of {person.name} in {ARM!r})"


def test_what_is_no_side_is_refused(person):
    with pytest.raises(LegsimError, match="the scanned side is 'l'; give left or right"):
        prepare_scan(person, ARM, side="l")  # type: ignore[arg-type]


def test_a_recording_shorter_than_the_scan_is_refused(person):
    slow = CArm.half(rate_hz=3.0)
    with pytest.raises(LegsimError, match=r"the recording lasts 19\.99 s, the scan 82\.33 s"):
        prepare_scan(person, slow)


@pytest.mark.parametrize(
    ("center", "message"),
    [
        ([0.0, np.nan, 0.0], "the center of the scan is .*nan.*; give three finite numbers in m"),
        ([0.0, 1.0], r"center of the scan has shape \(2,\)"),
    ],
)
def test_a_center_that_is_no_point_is_refused(person, center, message):
    with pytest.raises(LegsimError, match=message):
        prepare_scan(person, ARM, center=center)


def imaged(folder, legs) -> Path:
    """A PHANTOM.toml of the skin and bones of the person's left leg, around the knee."""
    lines = ['overlaps = "intended"']
    for part, segment in zip(legs.phantom.parts, legs.segments, strict=True):
        if part.name in ("skin_l", "femur_cortex_l", "tibia_cortex_l", "patella_cortex_l"):
            mesh = trimesh.Trimesh(part.vertices, part.triangles, process=False)
            mesh.export(str(folder / f"{part.name}.ply"))
            lines += ["[[part]]", f'name = "{part.name}"', f'file = "{part.name}.ply"']
            lines += ['unit = "m"', f'material = "{part.material}"', f'segment = "{segment}"']
    (folder / "PHANTOM.toml").write_text("\n".join(lines))
    return folder / "PHANTOM.toml"


def test_an_imaged_leg_is_scanned_in_place_of_the_shipped_one(person, tmp_path):
    shipped = prepare_scan(person, ARM)
    file = imaged(tmp_path, shipped.phantom)
    setup = prepare_scan(person, ARM, phantom=PhantomOptions(file=file))
    assert [part.name for part in setup.phantom.phantom.parts] == [
        part.name
        for part in shipped.phantom.phantom.parts
        if part.name in ("skin_l", "femur_cortex_l", "tibia_cortex_l", "patella_cortex_l")
    ]
    there = {
        p.name: v for p, v in zip(shipped.phantom.phantom.parts, shipped.scanned_leg(), strict=True)
    }
    for part, vertices in zip(setup.phantom.phantom.parts, setup.scanned_leg(), strict=True):
        # the very same meshes; landmarks on meshes in single precision
        np.testing.assert_allclose(vertices, there[part.name], atol=1e-5)
    with pytest.raises(LegsimError, match="holds no right leg"):
        prepare_scan(person, ARM, side="right", phantom=PhantomOptions(file=file))


def test_a_scan_that_sees_beyond_the_imaged_leg_says_so(person, tmp_path):
    file = imaged(tmp_path, prepare_scan(person, ARM).phantom)
    high = prepare_scan(person, ARM).geometry.rotation_center() + np.array([0, 0.35, 0])
    with pytest.warns(ImagedLegWarning, match="ends .* above the center"):
        prepare_scan(person, ARM, center=high, phantom=PhantomOptions(file=file))
