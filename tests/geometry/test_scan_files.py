"""A scan from two files: whose pixel size counts, and where RTK's geometry puts the pixels."""

import json

import numpy as np
import pytest
import SimpleITK as sitk

from legsim.core.errors import LegsimError
from legsim.geometry import files, projection_images
from legsim.geometry.scan_files import read_scan
from tests.geometry.test_files import circular


@pytest.fixture
def images(tmp_path, rng):
    np.save(tmp_path / "p.npy", rng.uniform(0, 3, (5, 48, 62)).astype(np.float32))
    return tmp_path / "p.npy"


@pytest.mark.parametrize(
    ("format", "given"),
    [
        ("legsim", {}),
        ("rtk", {}),
        ("matrices", {"pixel_mm": 0.616}),
        ("astra", {}),
        ("tigre", {}),
        ("conrad", {}),
        ("projtable", {"pixel_mm": 0.616}),
    ],
)
def test_every_geometry_places_the_images(tmp_path, images, format, given):
    path = tmp_path / f"g{files.FORMATS[format][0]}"
    files.save_geometry(path, circular(), format=format)
    scan = read_scan(images, path, **given)
    point = np.array([[0.01, 0.02, -0.03]])
    expected = circular().project(point)[0]
    np.testing.assert_allclose(scan.geometry.project(point)[0], expected, atol=1e-6)
    np.testing.assert_array_equal(scan.projections.line_integrals, np.load(images))
    assert scan.geometry.pixel_pitch == pytest.approx(0.616e-3)


def test_rtks_pixels_start_at_the_origin(tmp_path, images):
    files.save_geometry(tmp_path / "g.xml", circular())
    centered = read_scan(images, tmp_path / "g.xml")
    assert "do not say where they start" in centered.notes[0]
    origin = (-30.5 * 0.616 + 1.232, -23.5 * 0.616)
    shifted = read_scan(images, tmp_path / "g.xml", origin_mm=origin)
    moved = (
        shifted.geometry.project(np.zeros((1, 3)))[0]
        - centered.geometry.project(np.zeros((1, 3)))[0]
    )
    np.testing.assert_allclose(moved[:, 0], np.tile([-2.0, 0.0], (5, 1)), atol=1e-9)
    assert not shifted.notes
    corner = read_scan(images, tmp_path / "g.xml", origin_mm=(0.0, 0.0))
    assert "49 % of their size from where a centered detector does" in corner.notes[0]


def test_an_origin_is_refused_where_matrices_place_the_pixels(tmp_path, images):
    files.save_geometry(tmp_path / "g.json", circular())
    with pytest.raises(LegsimError, match="an origin places pixels for RTK's geometries only"):
        read_scan(images, tmp_path / "g.json", origin_mm=(0.0, 0.0))


def test_a_headers_spacing_does_not_overrule_the_geometry(tmp_path, images):
    """Many programs write 1 mm where they know nothing."""
    sitk.WriteImage(sitk.GetImageFromArray(np.load(images)), str(tmp_path / "p.mha"))
    files.save_geometry(tmp_path / "g.json", circular())
    scan = read_scan(tmp_path / "p.mha", tmp_path / "g.json")
    assert scan.geometry.pixel_pitch == pytest.approx(0.616e-3)
    with pytest.raises(LegsimError, match=r"says pixels of 0\.616 mm, not 1"):
        read_scan(tmp_path / "p.mha", tmp_path / "g.json", pixel_mm=1.0)


def test_pixels_that_nobody_knows_are_asked_for(tmp_path, images):
    files.save_geometry(tmp_path / "g.xml", circular())
    text = (tmp_path / "g.xml").read_text()
    (tmp_path / "g.xml").write_text(
        "\n".join(line for line in text.splitlines() if "legsim" not in line)
    )
    with pytest.raises(LegsimError, match="does not say how large its pixels are"):
        read_scan(images, tmp_path / "g.xml")
    assert read_scan(images, tmp_path / "g.xml", pixel_mm=0.616).geometry.shape_vu == (48, 62)


def test_pixels_that_images_state_otherwise_are_noted(tmp_path, rng):
    files.save_geometry(tmp_path / "g.json", circular())
    image = sitk.GetImageFromArray(rng.uniform(0, 3, (5, 48, 62)).astype(np.float32))
    for pixel, noted in ((0.616, False), (1.0, False), (0.308, True)):
        image.SetSpacing([pixel, pixel, 1.0])
        sitk.WriteImage(image, str(tmp_path / "p.mha"))
        notes = read_scan(tmp_path / "p.mha", tmp_path / "g.json").notes
        said = "the images state pixels of 0.308 x 0.308 mm, the geometry 0.616 x 0.616 mm"
        assert any(said in note for note in notes) == noted


def test_pixels_that_are_exchanged_are_doubted(tmp_path, rng):
    turned = {"nDetector": [48, 62], "dDetector": [0.616, 0.308], "angles": [0, 1, 2, 3, 4]}
    (tmp_path / "g.json").write_text(json.dumps({"DSD": 1198, "DSO": 780, **turned}))
    image = sitk.GetImageFromArray(rng.uniform(0, 3, (5, 48, 62)).astype(np.float32))
    for pixel, doubted in ((0.308, 0.616), False), ((0.616, 0.308), True), ((0.5, 0.5), False):
        image.SetSpacing([*pixel, 1.0])
        sitk.WriteImage(image, str(tmp_path / "p.mha"))
        notes = read_scan(tmp_path / "p.mha", tmp_path / "g.json", up="z").notes
        assert any("the other way around" in note for note in notes) == doubted


@pytest.mark.parametrize(("stated", "doubted"), [(1198, False), (1250, False), (1080, True)])
def test_another_distance_than_the_images_state_is_doubted(
    tmp_path, rng, monkeypatch, stated, doubted
):
    files.save_geometry(tmp_path / "g.json", circular())
    values = rng.uniform(0, 3, (5, 48, 62)).astype(np.float32)
    read = projection_images.ProjectionImages(values, detector_mm=stated)
    monkeypatch.setattr(projection_images, "read_images", lambda *_, **__: read)
    notes = read_scan("p.dcm", tmp_path / "g.json").notes
    said = f"In doubt: the images state {stated} mm from source to detector, the geometry has 1198"
    assert any(note.startswith(said) for note in notes) == doubted


@pytest.mark.parametrize("size", [0.616, np.float32(0.616), [0.616, 0.616], np.full(2, 0.616)])
def test_a_pixels_size_is_a_number_or_two_of_any_kind(tmp_path, images, size):
    path = tmp_path / "g.txt"
    files.save_geometry(path, circular(), format="matrices")
    found = read_scan(images, path, pixel_mm=size).geometry
    assert found.pixel_pitch == pytest.approx(0.616e-3)
    with pytest.raises(LegsimError, match="give one size, or"):
        read_scan(images, path, pixel_mm=(1.0, 2.0, 3.0))
