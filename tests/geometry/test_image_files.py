"""Image files: positions, units, refusals, atomic writes."""

from pathlib import Path

import numpy as np
import pytest
import SimpleITK as sitk
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from legsim.core.errors import LegsimError
from legsim.geometry import image_files
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import Volume, VolumeGrid


def some_volume(rng: np.random.Generator) -> Volume:
    grid = VolumeGrid((3, 4, 5), (0.001, 0.002, 0.0005), (0.1, -0.2, 0.03))
    return Volume(grid, rng.uniform(0, 40, grid.shape_zyx).astype(np.float32))


@pytest.mark.parametrize("ending", image_files.WRITABLE)
def test_volume_comes_back(tmp_path: Path, rng: np.random.Generator, ending: str) -> None:
    volume = some_volume(rng)
    image_files.save_volume(tmp_path / f"v{ending}", volume)
    loaded = image_files.load_volume(tmp_path / f"v{ending}")
    np.testing.assert_allclose(loaded.attenuation, volume.attenuation, rtol=1e-6)
    np.testing.assert_allclose(loaded.grid.spacing_xyz, volume.grid.spacing_xyz, rtol=1e-6)
    np.testing.assert_allclose(loaded.grid.center, volume.grid.center, atol=1e-8)
    assert [p.name for p in tmp_path.iterdir()] == [f"v{ending}"]


@pytest.mark.parametrize("ending", image_files.WRITABLE)
def test_itk_finds_each_voxel_left_posterior_and_superior(
    tmp_path: Path, rng: np.random.Generator, ending: str
) -> None:
    """World is anterior, superior, right."""
    volume = some_volume(rng)
    path = tmp_path / f"v{ending}"
    image_files.save_volume(path, volume)
    image = sitk.ReadImage(str(path))
    anterior, superior, right = volume.grid.axes()
    index = image.TransformPhysicalPointToIndex(
        (-1e3 * right[2], -1e3 * anterior[4], 1e3 * superior[1])
    )
    assert index == (4, 1, 2)
    assert image[index] == pytest.approx(1e-3 * volume.attenuation[2, 1, 4], rel=1e-6)
    letters = sitk.DICOMOrientImageFilter.GetOrientationFromDirectionCosines(image.GetDirection())
    assert letters == "ASR", "x grows to anterior, y to superior, z to right"


def test_a_volume_without_directions_lies_along_worlds_axes(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    """As legsim wrote them before, and as RTK does."""
    volume = some_volume(rng)
    image = sitk.GetImageFromArray(volume.attenuation * np.float32(1e-3))
    image.SetSpacing([1e3 * s for s in volume.grid.spacing_xyz])
    image.SetOrigin((1e3 * volume.grid.origin).tolist())
    sitk.WriteImage(image, str(tmp_path / "old.mha"))
    loaded = image_files.load_volume(tmp_path / "old.mha")
    np.testing.assert_allclose(loaded.grid.center, volume.grid.center, atol=1e-9)
    np.testing.assert_allclose(loaded.attenuation, volume.attenuation, rtol=1e-6)
    assert not image_files.read_header(tmp_path / "old.mha").anatomical
    image_files.save_volume(tmp_path / "new.mha", volume)
    assert image_files.read_header(tmp_path / "new.mha").anatomical


@pytest.mark.parametrize("letters", ["RAS", "LPI", "PIR", "SAL", "RSA"])
@pytest.mark.parametrize("ending", [".nii.gz", ".nrrd", ".mha"])
def test_another_programs_axes_give_the_same_places_in_world(
    tmp_path: Path, rng: np.random.Generator, letters: str, ending: str
) -> None:
    volume = some_volume(rng)
    image_files.save_volume(tmp_path / "v.mha", volume)
    turned = sitk.DICOMOrient(sitk.ReadImage(str(tmp_path / "v.mha")), letters)
    sitk.WriteImage(turned, str(tmp_path / f"t{ending}"))
    loaded = image_files.load_volume(tmp_path / f"t{ending}")
    np.testing.assert_allclose(loaded.grid.center, volume.grid.center, atol=1e-7)
    np.testing.assert_allclose(loaded.grid.spacing_xyz, volume.grid.spacing_xyz, rtol=1e-6)
    np.testing.assert_allclose(loaded.attenuation, volume.attenuation, rtol=1e-6)


def test_axes_without_a_length_are_refused(tmp_path: Path) -> None:
    """1e-300 mm in a damaged header: ITK divides by the length's square, which is 0."""
    image_files.save_volume(tmp_path / "v.nrrd", some_volume(np.random.default_rng(3)))
    text = (tmp_path / "v.nrrd").read_bytes()
    at = text.index(b"space directions: (")
    end = text.index(b"\n", at)
    said = b"space directions: (0,-10,0) (0,0,10) (-11e-300,0,0)"
    (tmp_path / "v.nrrd").write_bytes(text[:at] + said + text[end:])
    with pytest.raises(LegsimError, match=r"its axes along .*nan"):
        image_files.load_volume(tmp_path / "v.nrrd")


@given(
    axes=st.permutations([0, 1, 2]), flips=st.tuples(st.booleans(), st.booleans(), st.booleans())
)
@settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_swapped_and_flipped_axes_are_put_in_order(
    tmp_path: Path, axes: list[int], flips: tuple[bool, bool, bool]
) -> None:
    volume = some_volume(np.random.default_rng(3))
    image_files.save_volume(tmp_path / "v.mha", volume)
    image = sitk.Flip(sitk.PermuteAxes(sitk.ReadImage(str(tmp_path / "v.mha")), axes), flips, False)
    sitk.WriteImage(image, str(tmp_path / "turned.mha"))
    # one of these orders leaves no turn at all, which only a reader who is told takes for a patient
    loaded = image_files.load_volume(tmp_path / "turned.mha", axes="lps")
    np.testing.assert_allclose(loaded.attenuation, volume.attenuation, rtol=1e-6)
    np.testing.assert_allclose(loaded.grid.center, volume.grid.center, atol=1e-9)


def test_projections_come_back_and_are_centered_for_rtk(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    geometry = circular(views=3)
    projections = Projections(geometry, rng.normal(size=(3, 4, 6)).astype(np.float32))
    image_files.save_projections(tmp_path / "p.mha", projections)
    np.testing.assert_array_equal(
        image_files.load_projections(tmp_path / "p.mha", geometry).line_integrals,
        projections.line_integrals,
    )
    header = image_files.read_header(tmp_path / "p.mha")
    assert header.size == (6, 4, 3)
    np.testing.assert_allclose(header.origin_mm, (-2.5 * 0.8, -1.5 * 0.8, 0.0))
    np.testing.assert_allclose(header.spacing_mm, (0.8, 0.8, 1.0))


def circular(views: int) -> ConeBeamGeometry:
    return ConeBeamGeometry.circular(
        times=np.arange(views) * 1.0,
        angles=np.linspace(0, 3, views),
        source_isocenter=0.8,
        source_detector=1.2,
        shape_vu=(4, 6),
        pixel_pitch=0.8e-3,
    )


def test_refusals_name_the_file_and_the_cure(tmp_path: Path) -> None:
    flat, color, oblique = tmp_path / "flat.mha", tmp_path / "color.mha", tmp_path / "oblique.mha"
    sitk.WriteImage(sitk.Image(4, 4, sitk.sitkFloat32), str(flat))
    sitk.WriteImage(sitk.Image([4, 4, 4], sitk.sitkVectorFloat32, 2), str(color))
    tilted = sitk.Image(4, 4, 4, sitk.sitkFloat32)
    tilted.SetDirection([0.8, -0.6, 0, 0.6, 0.8, 0, 0, 0, 1])
    sitk.WriteImage(tilted, str(oblique))
    (tmp_path / "text.mha").write_text("no image")
    for name, reason in (
        ("flat", "2 dimensions"),
        ("color", "2 channels"),
        ("oblique", "oblique"),
        ("text", "not an image"),
        ("none", "no such"),
    ):
        with pytest.raises(LegsimError, match=rf"{name}\.mha.*{reason}") as caught:
            image_files.load_volume(tmp_path / f"{name}.mha")
        assert "\n" not in str(caught.value)


def test_values_that_are_no_numbers_are_refused(tmp_path: Path) -> None:
    values = np.zeros((3, 4, 6), np.float32)
    values[1, 2, 3] = np.nan
    sitk.WriteImage(sitk.GetImageFromArray(values), str(tmp_path / "p.mha"))
    with pytest.raises(LegsimError, match="view 1"):
        image_files.load_projections(tmp_path / "p.mha", circular(3))
    with pytest.raises(LegsimError, match="not finite"):
        image_files.load_volume(tmp_path / "p.mha")


def test_a_cut_file_is_refused_in_one_line_and_itk_is_silent(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "v.mha"
    image_files.save_volume(
        path,
        Volume(VolumeGrid.cubic(12, 0.001, (0.0, 0.0, 0.0)), np.zeros((12, 12, 12), np.float32)),
    )
    path.write_bytes(path.read_bytes()[:-400])
    with pytest.raises(
        LegsimError, match=r"v\.mha: cannot be read to its end; write or copy it again$"
    ):
        image_files.load_volume(path)
    assert capfd.readouterr() == ("", "")


def test_projections_of_another_geometry_are_refused(tmp_path: Path) -> None:
    sitk.WriteImage(
        sitk.GetImageFromArray(np.zeros((3, 4, 6), np.float32)), str(tmp_path / "p.mha")
    )
    with pytest.raises(LegsimError, match=r"\(6, 4, 3\).*\(6, 4, 5\)"):
        image_files.load_projections(tmp_path / "p.mha", circular(5))


def test_a_failed_write_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "v.mha"
    target.write_text("old")

    def half_a_file(_image: sitk.Image, name: str, _compress: bool) -> None:
        Path(name).write_text("half")
        raise RuntimeError("disk full")

    monkeypatch.setattr(image_files.sitk, "WriteImage", half_a_file)
    with pytest.raises(LegsimError, match="disk full"):
        image_files.save_volume(target, some_volume(rng))
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_unknown_endings_are_refused(tmp_path: Path, rng: np.random.Generator) -> None:
    with pytest.raises(LegsimError, match=r"\.mha"):
        image_files.save_volume(tmp_path / "v.xyz", some_volume(rng))


def test_slabs_on_disk_are_the_volume(tmp_path: Path, rng: np.random.Generator) -> None:
    volume = some_volume(rng)
    with image_files.volume_writer(tmp_path / "v.mha", volume.grid) as writer:
        writer.write(0, volume.attenuation[:2])
        assert not (tmp_path / "v.mha").exists()
        writer.write(2, volume.attenuation[2:])
    image_files.save_volume(tmp_path / "whole.mha", volume)
    assert image_files.read_header(tmp_path / "v.mha") == image_files.read_header(
        tmp_path / "whole.mha"
    )
    np.testing.assert_array_equal(
        image_files.load_volume(tmp_path / "v.mha").attenuation,
        image_files.load_volume(tmp_path / "whole.mha").attenuation,
    )


def test_an_interrupted_writer_leaves_nothing(tmp_path: Path, rng: np.random.Generator) -> None:
    volume = some_volume(rng)
    with (
        pytest.raises(KeyboardInterrupt),
        image_files.volume_writer(tmp_path / "v.mha", volume.grid) as writer,
    ):
        writer.write(0, volume.attenuation[:2])
        raise KeyboardInterrupt
    with (
        pytest.raises(LegsimError, match="only 2 of 3 slices"),
        image_files.volume_writer(tmp_path / "v.mha", volume.grid) as writer,
    ):
        writer.write(0, volume.attenuation[:2])
    with (
        pytest.raises(LegsimError, match="do not follow"),
        image_files.volume_writer(tmp_path / "v.mha", volume.grid) as writer,
    ):
        writer.write(1, volume.attenuation[1:])
    with (
        pytest.raises(LegsimError, match=r"\.mha"),
        image_files.volume_writer(tmp_path / "v.nii", volume.grid),
    ):
        pass
    assert not list(tmp_path.iterdir())


def test_a_writer_needs_room_on_the_disk(tmp_path: Path) -> None:
    huge = VolumeGrid((1 << 16, 1 << 14, 1 << 14), (1e-4,) * 3, (0.0, 0.0, 0.0))
    with (
        pytest.raises(LegsimError, match="GiB"),
        image_files.volume_writer(tmp_path / "v.mha", huge),
    ):
        pass


def test_labels_must_lie_on_the_volumes_grid(tmp_path: Path) -> None:
    grid = VolumeGrid((3, 4, 5), (0.001, 0.002, 0.0005), (0.1, -0.2, 0.03))
    marks = np.arange(60).reshape(3, 4, 5)
    image = sitk.GetImageFromArray(marks.astype(np.uint8))
    image.SetSpacing([1.0, 2.0, 0.5])
    image.SetOrigin(list(1e3 * grid.origin))
    sitk.WriteImage(image, str(tmp_path / "labels.nii.gz"))
    np.testing.assert_array_equal(image_files.load_labels(tmp_path / "labels.nii.gz", grid), marks)
    image.SetOrigin(list(1e3 * grid.origin + [0.5, 0, 0]))
    sitk.WriteImage(image, str(tmp_path / "moved.mha"))
    with pytest.raises(LegsimError, match="resample"):
        image_files.load_labels(tmp_path / "moved.mha", grid)


@pytest.mark.parametrize("dimensions", ["11", "99999999999999999999", "-1", "0", "x", ""])
def test_a_header_of_too_many_dimensions_is_refused_before_itk_reads_it(tmp_path, dimensions):
    """MetaIO ends the process there."""
    grid = VolumeGrid.cubic(2, 0.1, [0, 0, 0])
    path = tmp_path / "v.mha"
    image_files.save_volume(path, Volume(grid, np.zeros((2, 2, 2))))
    path.write_bytes(path.read_bytes().replace(b"NDims = 3", f"NDims = {dimensions}".encode()))
    with pytest.raises(LegsimError, match=r"v\.mha: its header says NDims = .* from 1 to 10"):
        image_files.load_volume(path)


@pytest.mark.parametrize("name", ["%s", "%n%n%n", "a%d%d.raw 1 2 1", "%", "%9999999d"])
def test_a_data_file_that_is_no_name_is_refused_before_itk_reads_it(tmp_path, name):
    """MetaIO formats with it, and ends the process."""
    path = tmp_path / "v.mha"
    image_files.save_volume(path, Volume(VolumeGrid.cubic(2, 0.1, [0, 0, 0]), np.zeros((2, 2, 2))))
    path.write_bytes(path.read_bytes().replace(b"= LOCAL", f"= {name}".encode()))
    with pytest.raises(LegsimError, match=r"v\.mha: its header says ElementDataFile = "):
        image_files.load_volume(path)


def test_voxels_too_large_for_an_attenuation_are_refused(tmp_path: Path) -> None:
    """In 1/m they would be infinite."""
    values = np.zeros((2, 3, 4), np.float32)
    values[1, 1, 1] = 1e37
    sitk.WriteImage(sitk.GetImageFromArray(values), str(tmp_path / "a.mha"))
    with pytest.raises(LegsimError, match="1 voxels are not finite numbers, or too large"):
        image_files.load_volume(tmp_path / "a.mha")


@pytest.mark.parametrize("ending", image_files.WRITABLE)
@pytest.mark.parametrize("missing", [1, 3000, 30_000])
def test_half_a_file_is_never_left(tmp_path: Path, ending: str, missing: int, rng) -> None:
    resource = pytest.importorskip("resource")
    grid = VolumeGrid.cubic(20, 0.01, [0.0, 0.0, 0.0])
    volume = Volume(grid, rng.normal(size=grid.shape_zyx).astype(np.float32))
    path = tmp_path / f"v{ending}"
    image_files.save_volume(path, volume)
    size = path.stat().st_size
    path.unlink()
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    # no file may grow further, as on a full disk
    resource.setrlimit(resource.RLIMIT_FSIZE, (size - missing, before[1]))
    try:
        with pytest.raises(LegsimError, match=r"v\..* (is full|cannot be written)"):
            image_files.save_volume(path, volume)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["V.MHA", "V.NII", "V.NII.GZ", "V.NRRD"])
def test_endings_in_capitals_are_written_and_read(tmp_path, name, rng):
    grid = VolumeGrid((4, 5, 6), (1e-3, 2e-3, 3e-3), (0.1, 0.2, 0.3))
    values = rng.random(grid.shape_zyx, np.float32)
    image_files.save_volume(tmp_path / name, Volume(grid, values))
    assert [path.name for path in tmp_path.iterdir()] == [name]
    found = image_files.load_volume(tmp_path / name)
    np.testing.assert_allclose(found.attenuation, values, rtol=1e-6)
    assert found.grid.alike(grid)
