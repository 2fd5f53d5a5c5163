"""TIFF: stacks, folders in the order of their numbers, and what is refused."""

import contextlib
from pathlib import Path

import numpy as np
import pytest
import tifffile

from legsim.core.errors import LegsimError
from legsim.geometry import tiff


def some_views(rng, views=12):
    return rng.integers(0, 60000, (views, 5, 7)).astype(np.uint16)


def series(place: Path) -> tuple[list[Path], tuple[str, ...]]:
    """The images of a folder in order, and all notes."""
    members, notes = tiff.members(place)
    ordered, more = tiff.by_number(place, members)
    return ordered, (*more, *notes)


@pytest.mark.parametrize(
    "options", [{}, {"imagej": True}, {"compression": "zlib"}, {"bigtiff": True}]
)
def test_a_stack_is_its_views(tmp_path, rng, options):
    tifffile.imwrite(tmp_path / "s.tif", some_views(rng), **options)
    found = tiff.read(tmp_path / "s.tif")
    np.testing.assert_array_equal(found, some_views(np.random.default_rng(20260)))
    assert found.dtype == np.uint16


def test_views_are_taken_by_the_last_number_in_their_names(tmp_path):
    for k in (10, 2, 1, 3, 12, 11):
        (tmp_path / f"scan7_view{k}.tif").touch()
    (tmp_path / "notes.txt").touch()
    members, notes = series(tmp_path)
    assert [int(path.stem.rpartition("view")[2]) for path in members] == [1, 2, 3, 10, 11, 12]
    assert "view numbers jump from 3 to 10" in notes[0]
    assert "left out: notes.txt" in notes[1]


def test_a_pattern_picks_one_series(tmp_path):
    for name in ("flat_1.tif", "v_1.tif", "v_2.tif"):
        (tmp_path / name).touch()
    with pytest.raises(LegsimError, match=r"holds images of several names: .*flat_#\.tif \(1\)"):
        series(tmp_path)
    members, notes = series(tmp_path / "v_*.tif")
    assert [path.name for path in members] == ["v_1.tif", "v_2.tif"]
    assert not notes


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ([], "holds no images"),
        (["v_1.tif", "v_01.tif"], "has the same view number, 1, as"),
        (["v_1.tif", "v_1.png"], "several names"),
    ],
)
def test_folders_without_an_order_are_refused(tmp_path, names, message):
    for name in names:
        (tmp_path / name).touch()
    with pytest.raises(LegsimError, match=message):
        series(tmp_path)


def test_three_views_are_no_colors(tmp_path, rng):
    """What tifffile itself writes of three images, without a word on colors."""
    values = some_views(rng, 3)
    tifffile.imwrite(tmp_path / "p.tif", values, photometric="rgb", planarconfig="separate")
    np.testing.assert_array_equal(tiff.read(tmp_path / "p.tif"), values)


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


def test_broken_tags_are_refused_without_a_word_elsewhere(tmp_path, rng, caplog):
    tifffile.imwrite(tmp_path / "s.tif", some_views(rng), compression="zlib")
    whole = (tmp_path / "s.tif").read_bytes()
    for at in range(8, 200, 3):
        (tmp_path / "s.tif").write_bytes(whole[:at] + b"\xff\x7f" + whole[at + 2 :])
        with contextlib.suppress(LegsimError):
            tiff.read(tmp_path / "s.tif")
    assert not caplog.records
