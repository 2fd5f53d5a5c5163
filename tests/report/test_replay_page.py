import json
import re

import numpy as np
import pytest

from legsim import config
from legsim.kinematics import from_recording
from legsim.mocap import trc
from legsim.mocap.trajectories import MarkerTrajectories
from legsim.run import replay as run_replay


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A replay of four seconds with a gap, a spike and a header in millimeters."""
    whole = trc.load(from_recording.find_recording("subject01/squat_60.trc"))
    positions = whole.positions_world[:480].copy()
    positions[100:112, whole.marker_names.index("LKNE")] = np.nan
    positions[200, whole.marker_names.index("RANK")] += 0.3
    place = tmp_path_factory.mktemp("replay")
    trc.save(
        place / "squat.trc", MarkerTrajectories(whole.times[:480], whole.marker_names, positions)
    )
    settings = config.load_settings(overrides=(f"motion.file={place / 'squat.trc'}",))
    run_replay.replay(
        settings, place / "out", filtered=False, image=None, on_progress=lambda *_: None
    )
    return place / "out"


def test_the_numbers_tell_what_was_done_to_each_marker(folder):
    summary = json.loads((folder / "kinematics.json").read_text())
    markers = {m["role"]: m for m in summary["markers"]}
    knee, ankle = markers["epicondyle_lateral_l"], markers["malleolus_lateral_r"]
    assert (knee["labels"], knee["missing"] >= 12, knee["filled"] >= 12, knee["left_missing"]) == (
        ["LKNE"],
        True,
        True,
        0,
    )
    assert ankle["jumps_removed"] >= 1
    assert all(m["rms_mm"] <= m["worst_mm"] for m in summary["markers"])
    assert any(note.startswith("lengths in m, y up") for note in summary["notes"])


def test_the_numbers_tell_where_each_coordinate_goes(folder):
    summary = json.loads((folder / "kinematics.json").read_text())
    knee = next(c for c in summary["coordinates"] if c["name"] == "knee_angle_l")
    assert -75 < knee["lowest"] <= knee["mean"] <= knee["highest"] < -45
    assert (knee["unit"], knee["decided_by_markers"] > 0.9, knee["frames_at_limit"]) == (
        "deg",
        True,
        0,
    )
    assert {c["unit"] for c in summary["coordinates"] if c["name"].startswith("pelvis_t")} == {
        "mm",
        "deg",
    }


@pytest.mark.parametrize(
    "words",
    [
        "LKNE",
        "epicondyle_lateral_l",
        "worst frame",
        "rebuilt",
        "knee_angle_l",
        "decided by markers",
        "frames by prior",
        "lengths in m",
        "thigh",
    ],
)
def test_the_page_tells(folder, words):
    assert words in (folder / "report.html").read_text()


def test_the_page_needs_nothing_from_outside_and_names_files_that_are_there(folder):
    page = (folder / "report.html").read_text()
    assert not re.search(r'(src|href)="(?!data:|#)[a-z]+:', page)
    assert page.count("data:image/png;base64,") == 5
    linked = re.findall(r'<dt><a href="([^"]+)">', page)
    assert linked
    assert all((folder / name).is_file() for name in linked)


@pytest.mark.end_to_end
def test_a_page_of_coordinates_has_no_markers(folder, tmp_path):
    settings = config.load_settings(overrides=(f"motion.file={folder / 'coordinates.mot'}",))
    run_replay.replay(settings, tmp_path, filtered=False, image=None, on_progress=lambda *_: None)
    page = (tmp_path / "report.html").read_text()
    assert "knee_angle_l" in page
    assert "worst frame" not in page
