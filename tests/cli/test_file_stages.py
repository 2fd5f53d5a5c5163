import json
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
import SimpleITK as sitk
import trimesh

from legsim.cli import file_stages
from legsim.core.errors import LegsimError
from legsim.deformation.files import save_motion
from legsim.deformation.models import RigidMotion
from legsim.geometry import files as geometry_files
from legsim.geometry import image_files
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.kinematics import from_recording
from legsim.mocap import files as mocap_files
from legsim.mocap import opensim
from legsim.mocap.trajectories import JointTrajectories, MarkerTrajectories
from legsim.reconstruction import cgls, fdk, field_of_view
from legsim.reconstruction.fdk import FdkOptions


def quiet(*_: object) -> None:
    """No progress."""


@pytest.fixture(scope="module")
def ball_scan(tmp_path_factory):
    """Projections of a ball of 0.02/mm, made by the command, with their geometry."""
    folder = tmp_path_factory.mktemp("ball")
    ball = trimesh.creation.icosphere(subdivisions=4, radius=30.0)
    ball.apply_translation([10, 0, -5])
    ball.export(folder / "ball.ply")
    (folder / "phantom.toml").write_text(
        '[[part]]\nname = "ball"\nfile = "ball.ply"\nunit = "mm"\nattenuation_per_mm = 0.02\n'
    )
    angles = np.radians(np.arange(0, 360, 4.0))
    geometry = ConeBeamGeometry.circular(
        times=np.arange(90) / 30,
        angles=angles,
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=(64, 96),
        pixel_pitch=2e-3,
    )
    geometry_files.save_geometry(folder / "geometry.json", geometry)
    lines = file_stages.project(
        folder / "phantom.toml",
        folder / "geometry.json",
        folder / "p.mha",
        reading=file_stages.GeometryOptions(),
        energy_kev=60,
        device=None,
        on_progress=quiet,
    )
    assert any("90 views of 96x64 pixels" in line for line in lines)
    return folder


def project(folder, out, *settings):
    return file_stages.project(
        folder / "phantom.toml",
        folder / "geometry.json",
        out,
        reading=file_stages.GeometryOptions(),
        energy_kev=60,
        settings=settings,
        device=None,
        on_progress=quiet,
    )


def images_of(path):
    return sitk.GetArrayFromImage(sitk.ReadImage(path))


def test_projections_take_the_detectors_settings_and_the_seed(ball_scan, tmp_path):
    photons, clean, found = "scan.detector.photons=1e4", images_of(ball_scan / "p.mha"), []
    for settings in ((photons,), (photons, "seed=0"), (photons, "seed=7")):
        project(ball_scan, tmp_path / "a.mha", *settings)
        found.append(images_of(tmp_path / "a.mha"))
    assert found[0][clean == 0].std() == pytest.approx(0.01, rel=0.02)
    np.testing.assert_array_equal(found[0], found[1])
    assert (found[0] != found[2]).any()
    with pytest.raises(
        LegsimError,
        match=(
            r"--set scan\.views=7: .* uses scan\.spectrum\.<key>, scan\.detector\.<key> and "
            r"seed"
        ),
    ):
        project(ball_scan, tmp_path / "b.mha", "scan.views=7")


def test_a_phantom_beside_the_scan_and_parts_that_would_move_are_remarked(ball_scan, tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=2, radius=30.0)
    ball.apply_translation([0, 3000, 0])
    ball.export(tmp_path / "ball.ply")
    toml = (
        '[[part]]\nname = "ball"\nfile = "ball.ply"\nunit = "mm"\nmaterial = "water"\nsegment '
        '= "tibia_l"\n'
    )
    (tmp_path / "phantom.toml").write_text(toml)
    (tmp_path / "geometry.json").write_bytes((ball_scan / "geometry.json").read_bytes())
    lines = "\n".join(project(tmp_path, tmp_path / "p.mha"))
    assert "no ray meets anything: the phantom's middle is at [0.0, 3000.0, 0.0] mm" in lines
    assert "parts that move with a segment rest here, where their files have them: ball" in lines
    assert not images_of(tmp_path / "p.mha").any()


def reconstruct(folder, out, **changes):
    options = {
        "motion": None,
        "like": None,
        "shape_zyx": (40, 40, 40),
        "spacing_mm": (2.0, 2.0, 2.0),
        "center_mm": None,
    }
    return file_stages.reconstruct(
        folder / "p.mha",
        folder / "geometry.json",
        out,
        **(options | changes),
        device=None,
        on_progress=quiet,
    )


def test_a_projected_ball_is_reconstructed_where_it_was_with_its_attenuation(ball_scan):
    reconstruct(ball_scan, ball_scan / "v.mha")
    volume = image_files.load_volume(ball_scan / "v.mha")
    x, y, z = volume.grid.axes()
    distance = np.sqrt((x - 0.01) ** 2 + y[:, None] ** 2 + (z[:, None, None] + 0.005) ** 2)
    assert volume.attenuation[distance < 0.02].mean() == pytest.approx(20, rel=0.02)
    assert abs(volume.attenuation[(distance > 0.034) & (distance < 0.038)].mean()) < 0.5


@pytest.mark.filterwarnings("ignore:voxels of 2 mm")
def test_options_of_the_reconstruction_reach_it(ball_scan, tmp_path):
    geometry = geometry_files.load_geometry(ball_scan / "geometry.json")
    projections = image_files.load_projections(ball_scan / "p.mha", geometry)
    volumes = []
    for out, options in (
        ("a.mha", {}),
        ("b.mha", {"window": "hann", "water_attenuation_per_mm": 0.0, "redundancy": "none"}),
        ("c.mha", {"algorithm": "cgls", "iterations": 2, "nonnegative": True}),
    ):
        lines = reconstruct(ball_scan, tmp_path / out, options=options)
        volumes.append(image_files.load_volume(tmp_path / out))
        assert f"by {options.get('algorithm', 'fdk')} on" in lines[0]
    grid = volumes[0].grid
    hann = FdkOptions(window="hann", water_attenuation=None, redundancy="none")
    expected = (
        fdk.fdk(projections, grid),
        fdk.fdk(projections, grid, options=hann),
        cgls.cgls(projections, grid, iterations=2, nonnegative=True),
    )
    for found, right in zip(volumes, expected, strict=True):
        # files hold 1/mm
        np.testing.assert_allclose(found.attenuation, right.attenuation, rtol=1e-6, atol=1e-6)


def test_like_takes_the_grid_of_another_volume(ball_scan, tmp_path):
    grid = VolumeGrid((10, 12, 14), (0.004, 0.003, 0.002), (0.01, 0.0, 0.0))
    image_files.save_volume(
        tmp_path / "like.mha", Volume(grid, np.zeros(grid.shape_zyx, np.float32))
    )
    reconstruct(
        ball_scan, tmp_path / "v.mha", like=tmp_path / "like.mha", shape_zyx=None, spacing_mm=None
    )
    found = image_files.load_volume(tmp_path / "v.mha").grid
    assert found.shape_zyx == grid.shape_zyx
    np.testing.assert_allclose(found.center, grid.center, atol=1e-9)


def test_the_field_of_view_is_the_default_grid(ball_scan, tmp_path):
    lines = reconstruct(ball_scan, tmp_path / "v.mha", shape_zyx=None, spacing_mm=None)
    geometry = geometry_files.load_geometry(ball_scan / "geometry.json")
    expected = field_of_view.grid_of(geometry)
    found = image_files.load_volume(tmp_path / "v.mha").grid
    assert found.shape_zyx == expected.shape_zyx
    np.testing.assert_allclose(found.spacing_xyz, expected.spacing_xyz)
    assert lines[0].startswith("grid: the field of view, ")
    assert "MiB" in lines[0]
    moved = (0.0, 0.0, 9.0)
    reconstruct(ball_scan, tmp_path / "m.mha", shape_zyx=None, center_mm=moved)
    found = image_files.load_volume(tmp_path / "m.mha").grid
    np.testing.assert_allclose(found.center, (0, 0, 0.009), atol=1e-9)
    assert found.spacing_xyz == pytest.approx((0.002,) * 3)


def test_a_grid_must_be_said_once(ball_scan, tmp_path):
    with pytest.raises(LegsimError, match="give both, or neither"):
        reconstruct(ball_scan, tmp_path / "v.mha", spacing_mm=None)
    with pytest.raises(LegsimError, match="already says the grid"):
        reconstruct(ball_scan, tmp_path / "v.mha", like=ball_scan / "p.mha")


def test_a_motion_of_another_scan_is_named(ball_scan, tmp_path):
    save_motion(tmp_path / "m.npz", RigidMotion.identity(np.arange(60.0)))
    with pytest.raises(LegsimError, match=r"m\.npz: moves 60 views, but the geometry has 90; give"):
        reconstruct(ball_scan, tmp_path / "v.mha", motion=tmp_path / "m.npz")
    assert not (tmp_path / "v.mha").exists()


def test_a_motion_of_other_times_is_doubted_and_one_in_mm_is_refused(ball_scan, tmp_path):
    times = geometry_files.read_geometry(ball_scan / "geometry.json").geometry.times
    save_motion(tmp_path / "m.npz", RigidMotion.identity(1e3 * times))
    lines = "\n".join(reconstruct(ball_scan, tmp_path / "v.mha", motion=tmp_path / "m.npz"))
    assert "In doubt: the motion is from" in lines
    swayed = np.tile(np.eye(4), (len(times), 1, 1))
    swayed[:, 1, 3] = 8.0 * np.linspace(0, 1, len(times))
    save_motion(tmp_path / "mm.npz", RigidMotion(times, swayed))
    with pytest.raises(LegsimError, match=r"mm\.npz: the motion moves the rotation center by 8 m"):
        reconstruct(ball_scan, tmp_path / "w.mha", motion=tmp_path / "mm.npz")
    assert not (tmp_path / "w.mha").exists()


def test_a_volume_equals_itself_by_the_command(ball_scan, tmp_path):
    reconstruct(ball_scan, tmp_path / "v.mha")
    scores = file_stages.evaluate(
        tmp_path / "v.mha",
        tmp_path / "v.mha",
        tmp_path / "m.json",
        regions=None,
        register=True,
        scaling="extremes",
        window="gaussian",
    )
    assert scores.rows()[0][:3] == ("cylinder", "1.0000", "0.0000")
    written = json.loads((tmp_path / "m.json").read_text())
    assert written["regions"][0] == asdict(scores.regions[0])
    assert (written["scaling"], written["window"]) == ("extremes", "gaussian")


def test_labels_name_the_regions(ball_scan, tmp_path):
    reconstruct(ball_scan, tmp_path / "v.mha")
    grid = image_files.load_volume(tmp_path / "v.mha").grid
    labels = np.zeros(grid.shape_zyx, np.uint8)
    labels[:20, 10:30, 10:30], labels[20:, 10:30, 10:30] = 1, 7
    save_labels(tmp_path / "l.mha", labels, grid)
    scores = file_stages.evaluate(
        tmp_path / "v.mha",
        tmp_path / "v.mha",
        tmp_path / "m.json",
        regions=tmp_path / "l.mha",
        register=False,
    )
    assert [region.region for region in scores.regions] == ["label 1", "label 7"]
    save_labels(tmp_path / "l.mha", 0 * labels, grid)
    with pytest.raises(LegsimError, match="holds no label above 0"):
        file_stages.evaluate(
            tmp_path / "v.mha",
            tmp_path / "v.mha",
            tmp_path / "m.json",
            regions=tmp_path / "l.mha",
            register=False,
        )


def save_labels(path, labels, grid):
    image = sitk.GetImageFromArray(labels)
    image.SetSpacing([1e3 * s for s in grid.spacing_xyz])
    image.SetOrigin((1e3 * grid.origin).tolist())
    sitk.WriteImage(image, str(path))


def test_geometry_is_described_and_converted(ball_scan, tmp_path):
    assert any(
        "90" in line
        for line in file_stages.describe_geometry(
            ball_scan / "geometry.json",
            reading=file_stages.GeometryOptions(),
            phantom=ball_scan / "phantom.toml",
        )
    )
    file_stages.convert_geometry(
        ball_scan / "geometry.json", tmp_path / "g.xml", reading=file_stages.GeometryOptions()
    )
    back = geometry_files.load_geometry(tmp_path / "g.xml")
    np.testing.assert_allclose(
        back.matrices,
        geometry_files.load_geometry(ball_scan / "geometry.json").matrices,
        rtol=1e-7,
        atol=1e-6,
    )


def test_bare_matrices_take_their_detector_from_the_projections(ball_scan, tmp_path):
    file_stages.convert_geometry(
        ball_scan / "geometry.json", tmp_path / "g.npy", reading=file_stages.GeometryOptions()
    )
    grid = {
        "motion": None,
        "like": None,
        "shape_zyx": (20, 20, 20),
        "spacing_mm": (4.0, 4.0, 4.0),
        "center_mm": None,
    }
    for geometry, out in ((ball_scan / "geometry.json", "a.mha"), (tmp_path / "g.npy", "b.mha")):
        file_stages.reconstruct(
            ball_scan / "p.mha", geometry, tmp_path / out, **grid, device=None, on_progress=quiet
        )
    first, second = (
        image_files.load_volume(tmp_path / name).attenuation for name in ("a.mha", "b.mha")
    )
    np.testing.assert_allclose(first, second, atol=1e-2)


def test_pixels_are_where_rtks_projections_say(ball_scan, tmp_path):
    """Cut off a few columns and rows: the origin in the file tells, as it does RTK."""
    file_stages.convert_geometry(
        ball_scan / "geometry.json", tmp_path / "g.xml", reading=file_stages.GeometryOptions()
    )
    grid = {
        "motion": None,
        "like": None,
        "shape_zyx": (20, 20, 20),
        "spacing_mm": (4.0, 4.0, 4.0),
        "center_mm": None,
    }
    image = sitk.ReadImage(str(ball_scan / "p.mha"))
    sitk.WriteImage(image[6:, 4:62, :], str(tmp_path / "cut.nii.gz"))
    for name in (ball_scan / "p.mha", tmp_path / "cut.nii.gz"):
        file_stages.reconstruct(
            name,
            tmp_path / "g.xml",
            tmp_path / f"{name.name[0]}.nii",
            **grid,
            device=None,
            on_progress=quiet,
        )
    whole, cut = (
        image_files.load_volume(tmp_path / name).attenuation for name in ("p.nii", "c.nii")
    )
    inside = np.s_[5:15, 5:15, 5:15]
    np.testing.assert_allclose(cut[inside], whole[inside], atol=0.2)


def test_rows_of_half_the_pitch_give_the_same_volume(ball_scan, tmp_path):
    """A row between each two, their mean, as back-projection interpolates: spacing and origin of
    the header place the rows.
    """
    file_stages.convert_geometry(
        ball_scan / "geometry.json", tmp_path / "g.xml", reading=file_stages.GeometryOptions()
    )
    image = sitk.ReadImage(str(ball_scan / "p.mha"))
    rows = sitk.GetArrayFromImage(image)
    between = np.repeat(rows, 2, axis=1)[:, :-1]
    between[:, 1::2] = 0.5 * (rows[:, 1:] + rows[:, :-1])
    doubled = sitk.GetImageFromArray(between)
    doubled.SetSpacing((2.0, 1.0, 1.0))
    doubled.SetOrigin(image.GetOrigin())
    sitk.WriteImage(doubled, str(tmp_path / "high.mha"))
    reconstruct(ball_scan, tmp_path / "whole.mha", shape_zyx=(20, 20, 20), spacing_mm=(4, 4, 4))
    file_stages.reconstruct(
        tmp_path / "high.mha",
        tmp_path / "g.xml",
        tmp_path / "high_volume.mha",
        motion=None,
        like=None,
        shape_zyx=(20, 20, 20),
        spacing_mm=(4.0, 4.0, 4.0),
        center_mm=None,
        device=None,
        on_progress=quiet,
    )
    whole, high = (
        image_files.load_volume(tmp_path / name).attenuation
        for name in ("whole.mha", "high_volume.mha")
    )
    inside = np.s_[5:15, 5:15, 5:15]
    np.testing.assert_allclose(high[inside], whole[inside], atol=0.3)


def test_the_example_reconstructs_another_toolkits_scan(ball_scan, tmp_path):
    file_stages.convert_geometry(
        ball_scan / "geometry.json", tmp_path / "g.xml", reading=file_stages.GeometryOptions()
    )
    script = Path(__file__).parents[2] / "docs/examples/reconstruct_rtk.py"
    arguments = [
        str(ball_scan / "p.mha"),
        str(tmp_path / "g.xml"),
        str(tmp_path / "v.nii.gz"),
        "40",
        "2.0",
    ]
    done = subprocess.run(
        [sys.executable, script, *arguments], capture_output=True, text=True, check=True
    )
    assert "40x40x40" in done.stdout
    reconstruct(ball_scan, tmp_path / "v.mha")
    expected, found = (image_files.load_volume(tmp_path / name) for name in ("v.mha", "v.nii.gz"))
    np.testing.assert_allclose(found.grid.center, expected.grid.center, atol=1e-6)
    np.testing.assert_allclose(found.attenuation, expected.attenuation, atol=1e-2)


def test_a_folder_without_a_recording_is_named(tmp_path):
    with pytest.raises(LegsimError, match=r"recording\.rrd: no such recording"):
        file_stages.open_recording(tmp_path)


def converted(source, out, **changes):
    return file_stages.convert_motion(
        source, out, **({"unit": None, "up": None, "in_degrees": False} | changes)
    )


def test_markers_go_through_every_format_to_the_last_bit(tmp_path):
    source = from_recording.find_recording("subject01/squat_30.trc")
    lines = converted(source, tmp_path / "a.csv")
    assert lines[0] == "lengths in mm, y up (the body is upright along it)"
    assert lines[-1] == f"2400 samples of 7 markers (m, y up): {tmp_path / 'a.csv'}"
    converted(tmp_path / "a.csv", tmp_path / "new" / "b.trc")
    first, last = (
        mocap_files.load_recording(source),
        mocap_files.load_recording(tmp_path / "new" / "b.trc"),
    )
    assert isinstance(first, MarkerTrajectories)
    assert isinstance(last, MarkerTrajectories)
    np.testing.assert_array_equal(first.positions_world, last.positions_world)
    np.testing.assert_array_equal(first.times, last.times)
    assert (tmp_path / "new" / "b.trc").read_text().startswith("PathFileType\t4\t(X/Y/Z)\tb.trc\n")
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["b.trc"]


def test_coordinates_go_through_every_format_to_the_last_bit(tmp_path):
    values = np.random.default_rng(1).standard_normal((5, 2))
    first = JointTrajectories(np.arange(5) / 7, ("knee_angle_r", "pelvis_tx"), values)
    opensim.save(tmp_path / "a.mot", first)
    for source, out in (("a.mot", "b.csv"), ("b.csv", "c.sto"), ("c.sto", "d.mot")):
        converted(tmp_path / source, tmp_path / out)
    assert (tmp_path / "d.mot").read_bytes() == (tmp_path / "a.mot").read_bytes()
    converted(tmp_path / "a.mot", tmp_path / "degrees.mot", in_degrees=True)
    assert "inDegrees=yes" in (tmp_path / "degrees.mot").read_text()
    np.testing.assert_allclose(opensim.load(tmp_path / "degrees.mot").values, values, rtol=1e-15)


@pytest.mark.parametrize(
    ("out", "changes", "message"),
    [
        (
            "c.mot",
            {},
            r"/c\.mot: markers cannot be written as \.mot; end the name in \.trc or \.csv",
        ),
        ("c", {}, r"/c: markers cannot be written as a file without ending"),
        ("c.trc", {"up": "w"}, r"up = 'w' is no axis"),
    ],
)
def test_a_conversion_that_cannot_be_is_refused_and_leaves_nothing(tmp_path, out, changes, message):
    with pytest.raises(LegsimError, match=message):
        converted(
            from_recording.find_recording("subject01/squat_30.trc"), tmp_path / out, **changes
        )
    assert not list(tmp_path.iterdir())


def test_degrees_are_not_written_into_tables(tmp_path):
    opensim.save(
        tmp_path / "a.mot", JointTrajectories(np.arange(3.0), ("knee_angle_r",), np.zeros((3, 1)))
    )
    with pytest.raises(
        LegsimError,
        match=r"/b\.csv: degrees cannot be written as \.csv; end the name in \.mot or \.sto",
    ):
        converted(tmp_path / "a.mot", tmp_path / "b.csv", in_degrees=True)


def test_a_conversion_refuses_options_that_cannot_apply(tmp_path):
    opensim.save(tmp_path / "a.mot", JointTrajectories([0.0, 0.1], ("pelvis_tx",), [[0.1], [0.2]]))
    with pytest.raises(LegsimError, match="joint coordinates, not markers: up cannot apply"):
        converted(tmp_path / "a.mot", tmp_path / "b.mot", up="z")
    converted(tmp_path / "a.mot", tmp_path / "b.csv", unit="mm")
    assert (tmp_path / "b.csv").read_text() == "time_s,pelvis_tx_m\n0.0,0.0001\n0.1,0.0002\n"
    with pytest.raises(LegsimError, match="columns name their units: unit cannot apply"):
        converted(tmp_path / "b.csv", tmp_path / "c.csv", unit="mm")
