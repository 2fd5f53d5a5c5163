import json

import numpy as np
import pytest
import SimpleITK as sitk
import trimesh

from legsim import geometry_files, images, tasks
from legsim.errors import LegsimError
from legsim.geometry import ConeBeamGeometry, Volume, VolumeGrid


def quiet(*_: object) -> None:
    """No progress."""


@pytest.fixture(scope="module")
def ball_scan(tmp_path_factory):
    """Projections of a ball of 0.02/mm, made by the command, with their geometry."""
    folder = tmp_path_factory.mktemp("ball")
    ball = trimesh.creation.icosphere(subdivisions=4, radius=30.0)
    ball.apply_translation([10, 0, -5])
    ball.export(folder / "ball.ply")
    (folder / "phantom.toml").write_text('[[part]]\nname = "ball"\nfile = "ball.ply"\nunit = "mm"\nattenuation_per_mm = 0.02\n')
    angles = np.radians(np.arange(0, 360, 4.0))
    geometry = ConeBeamGeometry.circular(
        times=np.arange(90) / 30, angles=angles, source_isocenter=0.78, source_detector=1.198, shape_vu=(64, 96), pixel_pitch=2e-3
    )
    geometry_files.save(folder / "geometry.json", geometry)
    lines = tasks.project(
        folder / "phantom.toml",
        folder / "geometry.json",
        folder / "p.mha",
        detector=tasks.Detector(),
        energy_kev=60,
        device=None,
        on_progress=quiet,
    )
    assert any("90 views of 96x64 pixels" in line for line in lines)
    return folder


def project(folder, out, *settings):
    return tasks.project(
        folder / "phantom.toml",
        folder / "geometry.json",
        out,
        detector=tasks.Detector(),
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
    with pytest.raises(LegsimError, match=r"--set scan\.views=7: .* heeds scan\.spectrum\.<key>, scan\.detector\.<key> and seed"):
        project(ball_scan, tmp_path / "b.mha", "scan.views=7")


def test_a_phantom_beside_the_scan_and_parts_that_would_move_are_remarked(ball_scan, tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=2, radius=30.0)
    ball.apply_translation([0, 3000, 0])
    ball.export(tmp_path / "ball.ply")
    toml = '[[part]]\nname = "ball"\nfile = "ball.ply"\nunit = "mm"\nmaterial = "water"\nsegment = "tibia_l"\n'
    (tmp_path / "phantom.toml").write_text(toml)
    (tmp_path / "geometry.json").write_bytes((ball_scan / "geometry.json").read_bytes())
    lines = "\n".join(project(tmp_path, tmp_path / "p.mha"))
    assert "no ray meets anything: the phantom's middle is at [0.0, 3000.0, 0.0] mm" in lines
    assert "parts that move with a segment rest here, where their files have them: ball" in lines
    assert not images_of(tmp_path / "p.mha").any()


def reconstruct(folder, out, **changes):
    options = {"motion": None, "like": None, "shape_zyx": (40, 40, 40), "spacing_mm": (2.0, 2.0, 2.0), "center_mm": None}
    return tasks.reconstruct(folder / "p.mha", folder / "geometry.json", out, **(options | changes), device=None, on_progress=quiet)


def test_a_projected_ball_is_reconstructed_where_it_was_with_its_attenuation(ball_scan):
    reconstruct(ball_scan, ball_scan / "v.mha")
    volume = images.load_volume(ball_scan / "v.mha")
    x, y, z = volume.grid.axes()
    distance = np.sqrt((x - 0.01) ** 2 + y[:, None] ** 2 + (z[:, None, None] + 0.005) ** 2)
    assert volume.attenuation[distance < 0.02].mean() == pytest.approx(20, rel=0.02)
    assert abs(volume.attenuation[(distance > 0.034) & (distance < 0.038)].mean()) < 0.5


def test_like_takes_the_grid_of_another_volume(ball_scan, tmp_path):
    grid = VolumeGrid((10, 12, 14), (0.004, 0.003, 0.002), (0.01, 0.0, 0.0))
    images.save_volume(tmp_path / "like.mha", Volume(grid, np.zeros(grid.shape_zyx, np.float32)))
    reconstruct(ball_scan, tmp_path / "v.mha", like=tmp_path / "like.mha", shape_zyx=None, spacing_mm=None)
    found = images.load_volume(tmp_path / "v.mha").grid
    assert found.shape_zyx == grid.shape_zyx
    np.testing.assert_allclose(found.center, grid.center, atol=1e-9)


def test_a_grid_must_be_said_once(ball_scan, tmp_path):
    with pytest.raises(LegsimError, match="which grid"):
        reconstruct(ball_scan, tmp_path / "v.mha", shape_zyx=None)
    with pytest.raises(LegsimError, match="already says the grid"):
        reconstruct(ball_scan, tmp_path / "v.mha", like=ball_scan / "p.mha")


def test_a_volume_equals_itself_by_the_command(ball_scan, tmp_path):
    reconstruct(ball_scan, tmp_path / "v.mha")
    rows = tasks.evaluate(tmp_path / "v.mha", tmp_path / "v.mha", tmp_path / "m.json", regions=None, register=True)
    assert rows[0][:3] == ("cylinder", "1.0000", "0.0000")
    written = json.loads((tmp_path / "m.json").read_text())["regions"][0]
    assert written["ssim"] == pytest.approx(1)
    assert rows[0][3] == f"{written['gradient_entropy']:.4f}"


def test_labels_name_the_regions(ball_scan, tmp_path):
    reconstruct(ball_scan, tmp_path / "v.mha")
    grid = images.load_volume(tmp_path / "v.mha").grid
    labels = np.zeros(grid.shape_zyx, np.uint8)
    labels[:20, 10:30, 10:30], labels[20:, 10:30, 10:30] = 1, 7
    save_labels(tmp_path / "l.mha", labels, grid)
    rows = tasks.evaluate(tmp_path / "v.mha", tmp_path / "v.mha", tmp_path / "m.json", regions=tmp_path / "l.mha", register=False)
    assert [row[0] for row in rows] == ["label 1", "label 7"]
    save_labels(tmp_path / "l.mha", 0 * labels, grid)
    with pytest.raises(LegsimError, match="holds no label above 0"):
        tasks.evaluate(tmp_path / "v.mha", tmp_path / "v.mha", tmp_path / "m.json", regions=tmp_path / "l.mha", register=False)


def save_labels(path, labels, grid):
    image = sitk.GetImageFromArray(labels)
    image.SetSpacing([1e3 * s for s in grid.spacing_xyz])
    image.SetOrigin((1e3 * grid.origin).tolist())
    sitk.WriteImage(image, str(path))


def test_geometry_is_described_and_converted(ball_scan, tmp_path):
    assert any(
        "90" in line
        for line in tasks.describe_geometry(ball_scan / "geometry.json", detector=tasks.Detector(), phantom=ball_scan / "phantom.toml")
    )
    tasks.convert_geometry(ball_scan / "geometry.json", tmp_path / "g.xml", detector=tasks.Detector())
    back = geometry_files.load(tmp_path / "g.xml")
    np.testing.assert_allclose(back.matrices, geometry_files.load(ball_scan / "geometry.json").matrices, rtol=1e-7, atol=1e-6)


def test_bare_matrices_take_their_detector_from_the_projections(ball_scan, tmp_path):
    tasks.convert_geometry(ball_scan / "geometry.json", tmp_path / "g.npy", detector=tasks.Detector())
    grid = {"motion": None, "like": None, "shape_zyx": (20, 20, 20), "spacing_mm": (4.0, 4.0, 4.0), "center_mm": None}
    for geometry, out in ((ball_scan / "geometry.json", "a.mha"), (tmp_path / "g.npy", "b.mha")):
        tasks.reconstruct(ball_scan / "p.mha", geometry, tmp_path / out, **grid, device=None, on_progress=quiet)
    first, second = (images.load_volume(tmp_path / name).attenuation for name in ("a.mha", "b.mha"))
    np.testing.assert_allclose(first, second, atol=1e-2)


def test_a_folder_without_a_recording_is_named(tmp_path):
    with pytest.raises(LegsimError, match=r"recording\.rrd: no such recording"):
        tasks.open_recording(tmp_path)
