"""Files of single views: their order, patterns, and names that say none."""

from pathlib import Path

import pytest

from legsim.core.errors import LegsimError
from legsim.geometry import view_files


def series(place: Path) -> tuple[list[Path], tuple[str, ...]]:
    """The images of a folder in order, and all notes."""
    members, notes = view_files.members(place)
    ordered, more = view_files.by_number(place, members)
    return ordered, (*more, *notes)


def test_views_are_taken_by_the_number_that_differs_between_their_names(tmp_path):
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


def test_the_number_that_differs_need_not_be_the_last(tmp_path):
    for k in (10, 2, 1):
        (tmp_path / f"scan7_{k}_2024-01-02.tif").touch()
    assert [path.name.split("_")[1] for path in series(tmp_path)[0]] == ["1", "2", "10"]


def test_names_that_differ_in_several_numbers_are_refused(tmp_path):
    """Two scans in a folder, or angles with decimals."""
    for name in ("scan1_1.tif", "scan1_2.tif", "scan2_1.tif"):
        (tmp_path / name).touch()
    with pytest.raises(LegsimError, match="names differ in 2 numbers"):
        series(tmp_path)
    assert [path.name for path in series(tmp_path / "scan1_*.tif")[0]] == [
        "scan1_1.tif", "scan1_2.tif",
    ]  # fmt: skip


def test_patterns_take_brackets_as_they_are(tmp_path):
    for name in ("leg [2]_1.tif", "leg [2]_2.tif", "leg 2_1.tif", "leg [2]_10.tif"):
        (tmp_path / name).touch()
    pattern = tmp_path / "leg [2]_?.tif"
    assert view_files.is_pattern(pattern)
    assert [path.name for path in series(pattern)[0]] == ["leg [2]_1.tif", "leg [2]_2.tif"]
    assert not view_files.is_pattern(tmp_path / "leg [2]_1.tif")


@pytest.mark.parametrize(
    "names",
    [
        ["view_001_000deg.tif", "view_002_004deg.tif", "view_010_036deg.tif"],
        ["p_0001_20260101_115959.tif", "p_0002_20260101_120002.tif", "p_0003_20260101_120005.tif"],
        ["a1_t99ms.tif", "a2_t1099ms.tif", "a3_t2099ms.tif"],
    ],
)
def test_a_number_beside_an_angle_or_a_time_gives_one_order(tmp_path, names):
    found, _ = view_files.by_number(tmp_path, [tmp_path / name for name in reversed(names)])
    assert [path.name for path in found] == names


def test_numbers_that_disagree_on_the_order_are_refused(tmp_path):
    names = ["a1_t3.tif", "a2_t2.tif", "a3_t1.tif"]
    with pytest.raises(LegsimError, match="differ in 2 numbers"):
        view_files.by_number(tmp_path, [tmp_path / name for name in names])


def test_negative_view_numbers_are_refused(tmp_path):
    """By their digits alone they would come in reverse order."""
    for k in (-3, -2, -1):
        (tmp_path / f"view_{k}.npy").touch()
    with pytest.raises(LegsimError, match="negative view numbers, as view_-"):
        series(tmp_path)


def test_a_hyphen_between_name_and_number_is_no_sign(tmp_path):
    for k in (1, 2, 3):
        (tmp_path / f"view-{k}.npy").touch()
    assert [path.name for path in series(tmp_path)[0]] == ["view-1.npy", "view-2.npy", "view-3.npy"]


@pytest.mark.parametrize(
    ("names", "noted"),
    [
        (["0.0", "0.125", "0.25", "0.5"], True),
        (["0.0", "0.1", "0.2"], False),
        (["1.2.840.9", "1.2.840.10"], False),
        (["IM.9", "IM.10"], False),
    ],
)
def test_decimals_in_names_are_noted(tmp_path, names, noted):
    for name in names:
        (tmp_path / f"{name}.npy").touch()
    notes = series(tmp_path)[1]
    assert any("if they are decimals" in note for note in notes) is noted


@pytest.mark.parametrize("ending", [".tif", ".mhd", ".dcm", ""])
def test_files_beside_the_views_are_left_out_with_a_word(tmp_path, ending):
    for number in range(3):
        (tmp_path / f"view_{number}{ending}").touch()
        if ending == ".mhd":
            (tmp_path / f"view_{number}.raw").touch()
    for name in (".DS_Store", "Thumbs.db", "info.json", "README.txt", "desktop.ini"):
        (tmp_path / name).touch()
    if ending:
        (tmp_path / "README").touch()
    found, (note,) = view_files.members(tmp_path)
    assert sorted(path.name for path in found) == [f"view_{n}{ending}" for n in range(3)]
    assert "left out" in note
    assert "info.json" in note


@pytest.mark.parametrize("before", ["leg(80kV)-", "scan--", "leg_-", "a [1]-"])
def test_a_hyphen_before_numbers_with_leading_zeros_is_no_sign(tmp_path, before):
    for k in range(3):
        (tmp_path / f"{before}{k:03d}.npy").touch()
    assert [path.name[-7:] for path in series(tmp_path)[0]] == ["000.npy", "001.npy", "002.npy"]


def test_one_image_beside_slices_without_an_ending_does_not_displace_them(tmp_path):
    for k in range(3):
        (tmp_path / f"IM{k:04d}").touch()
    (tmp_path / "preview.tif").touch()
    with pytest.raises(LegsimError, match="several names"):
        series(tmp_path)
