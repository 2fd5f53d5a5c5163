"""TIFF: stacks, and what is refused."""

import contextlib

import numpy as np
import pytest
import SimpleITK as sitk
import tifffile
from PIL import Image, TiffImagePlugin

from legsim.core.errors import LegsimError
from legsim.geometry import tiff


def some_views(rng, views=12):
    return rng.integers(0, 60000, (views, 5, 7)).astype(np.uint16)


@pytest.mark.parametrize(
    "options", [{}, {"imagej": True}, {"compression": "zlib"}, {"bigtiff": True}]
)
def test_a_stack_is_its_views(tmp_path, rng, options):
    tifffile.imwrite(tmp_path / "s.tif", some_views(rng), **options)
    found = tiff.read(tmp_path / "s.tif").values
    np.testing.assert_array_equal(found, some_views(np.random.default_rng(20260)))
    assert found.dtype == np.uint16


def test_three_views_are_no_colors(tmp_path, rng):
    """What tifffile itself writes of three images, without a word on colors."""
    values = some_views(rng, 3)
    tifffile.imwrite(tmp_path / "p.tif", values, photometric="rgb", planarconfig="separate")
    np.testing.assert_array_equal(tiff.read(tmp_path / "p.tif").values, values)


def test_colors_previews_and_broken_files_are_refused(tmp_path, rng):
    tifffile.imwrite(tmp_path / "c.tif", np.zeros((9, 9, 3), np.uint8), photometric="rgb")
    with pytest.raises(LegsimError, match="not colors"):
        tiff.read(tmp_path / "c.tif")
    with tifffile.TiffWriter(tmp_path / "p.tif") as writer:
        writer.write(some_views(rng)[0])
        writer.write(np.zeros((2, 2), np.uint8))
    with pytest.raises(LegsimError, match="without previews"):
        tiff.read(tmp_path / "p.tif")
    (tmp_path / "b.tif").write_bytes(b"II*\0nothing")
    with pytest.raises(LegsimError, match="cannot be read as TIFF"):
        tiff.read(tmp_path / "b.tif")
    (tmp_path / "e.tif").write_bytes(b"II*\0" + bytes(4))
    with pytest.raises(LegsimError, match=r"cannot be read as TIFF \(no page\)"):
        tiff.read(tmp_path / "e.tif")


def test_a_list_of_more_pages_than_a_file_can_describe_is_refused(tmp_path, rng):
    """Damaged files have them, in circles or overlapping."""
    tifffile.imwrite(tmp_path / "s.tif", some_views(rng, 1))
    data = bytearray((tmp_path / "s.tif").read_bytes())
    first = int.from_bytes(data[4:8], "little")
    next_at = first + 2 + 12 * int.from_bytes(data[first : first + 2], "little")
    data[next_at : next_at + 4] = len(data).to_bytes(4, "little")
    for _ in range(500):  # pages without a tag: their count, and where the next one is
        data += bytes(2) + (len(data) + 6).to_bytes(4, "little")
    (tmp_path / "s.tif").write_bytes(bytes(data))
    with pytest.raises(LegsimError, match="its list of pages runs in circles"):
        tiff.read(tmp_path / "s.tif")


def test_images_longer_than_any_detector_are_refused_before_they_are_unpacked(tmp_path, rng):
    """A hundred million rows by one wrong byte of the header."""
    image = Image.fromarray(some_views(rng, 1)[0])
    image.save(tmp_path / "s.tif")
    data = bytearray((tmp_path / "s.tif").read_bytes())
    with tifffile.TiffFile(tmp_path / "s.tif") as file:
        tag = file.pages.first.tags["ImageLength"]
    data[tag.offset + 2 : tag.offset + 12] = (
        (4).to_bytes(2, "little") + (1).to_bytes(4, "little") + (100663302).to_bytes(4, "little")
    )
    (tmp_path / "s.tif").write_bytes(bytes(data))
    with pytest.raises(LegsimError, match="100663302 x 7 pixels, more along one side"):
        tiff.read(tmp_path / "s.tif")


def test_broken_tags_are_refused_without_a_word_elsewhere(tmp_path, rng, caplog):
    tifffile.imwrite(tmp_path / "s.tif", some_views(rng), compression="zlib")
    whole = (tmp_path / "s.tif").read_bytes()
    for at in range(8, 200, 3):
        (tmp_path / "s.tif").write_bytes(whole[:at] + b"\xff\x7f" + whole[at + 2 :])
        with contextlib.suppress(LegsimError):
            tiff.read(tmp_path / "s.tif")
    assert not caplog.records


def test_what_tifffile_cannot_decompress_is_read_by_itk(tmp_path, rng):
    values = rng.integers(0, 60000, (4, 5, 7)).astype(np.uint16)
    writer = sitk.ImageFileWriter()
    writer.SetFileName(str(tmp_path / "s.tif"))
    writer.UseCompressionOn()
    writer.SetCompressor("LZW")
    writer.Execute(sitk.GetImageFromArray(values))
    found = tiff.read(tmp_path / "s.tif").values
    np.testing.assert_array_equal(found, values)
    assert found.dtype == np.uint16


def test_numbers_are_calibrated_as_imagej_says(tmp_path, rng):
    """It stores signed numbers as unsigned ones less 32768."""
    values = rng.integers(-3000, 3000, (4, 5, 7))
    stored = (values + 32768).astype(np.uint16)
    for function, expected in ((0, values), (20, stored)):
        stated = {"axes": "ZYX", "cf": function, "c0": -32768.0, "c1": 1.0}
        tifffile.imwrite(tmp_path / "s.tif", stored, imagej=True, metadata=stated)
        np.testing.assert_array_equal(tiff.read(tmp_path / "s.tif").values, expected)
    tifffile.imwrite(tmp_path / "s.tif", stored, imagej=True, metadata={"axes": "ZYX", "cf": 4})
    with pytest.raises(LegsimError, match="ImageJ's function 4, no line"):
        tiff.read(tmp_path / "s.tif")


@pytest.mark.parametrize("options", [{"imagej": True}, {"ome": True}])
def test_images_along_several_axes_are_refused(tmp_path, rng, options):
    """Their pages would be taken for views, channels among them."""
    values = some_views(rng).reshape(6, 2, 5, 7)
    tifffile.imwrite(tmp_path / "s.tif", values, metadata={"axes": "ZCYX"}, **options)
    with pytest.raises(LegsimError, match="several axes: 6 slices, 2 channels"):
        tiff.read(tmp_path / "s.tif")
    tifffile.imwrite(tmp_path / "s.tif", values[:, 0], metadata={"axes": "TYX"}, **options)
    np.testing.assert_array_equal(tiff.read(tmp_path / "s.tif").values, values[:, 0])


def test_numbers_of_colors_are_refused(tmp_path, rng):
    values = rng.integers(0, 250, (4, 5, 7)).astype(np.uint8)
    colors = np.zeros((3, 256), np.uint16)
    tifffile.imwrite(tmp_path / "p.tif", values, photometric="palette", colormap=colors)
    with pytest.raises(LegsimError, match="not colors"):
        tiff.read(tmp_path / "p.tif")


@pytest.mark.parametrize("compression", ["raw", "tiff_deflate", "tiff_lzw"])
def test_rows_are_as_stored_whatever_orientation_and_compression(tmp_path, rng, compression):
    stored = rng.integers(0, 60000, (6, 9)).astype(np.uint16)
    path = tmp_path / "x.tif"
    for orientation in (1, 4):
        tags = TiffImagePlugin.ImageFileDirectory_v2()
        tags[274] = orientation
        Image.fromarray(stored).save(path, compression=compression, tiffinfo=tags)
        found = tiff.read(path)
        np.testing.assert_array_equal(found.values[0], stored)
        assert any("orientation 4" in note for note in found.notes) == (orientation == 4)
