"""Recordings are told by their content; every odd file known to us is read or refused as the table
in docs/formats.md says.
"""

import re
from pathlib import Path

import numpy as np
import pytest

from legsim.core import files as core_files
from legsim.core.errors import LegsimError
from legsim.mocap import files as mocap_files
from legsim.mocap import opensim, trc
from legsim.mocap.files import load_markers, read_raw
from legsim.mocap.raw import RawMarkers
from legsim.mocap.trajectories import JointTrajectories, MarkerTrajectories
from tests.references.c3d import c3d_bytes

FORMATS = Path(__file__).parents[2] / "docs/formats.md"
MOTION = MarkerTrajectories([0.0, 0.1], ("a", "b"), np.ones((2, 2, 3)))
ANGLES = JointTrajectories([0.0, 0.1], ("knee_angle_r",), [[0.1], [0.2]])


def odd_files() -> list[tuple[str, str]]:
    """(file, what becomes of it) of each row of the table."""
    return re.findall(r"^\| `(odd_\w+/[^`]+)` \| (.+?) \|$", FORMATS.read_text(), re.M)


@pytest.mark.parametrize("name", ["m.trc", "m.c3d", "m.mot", "m", "m.txt"])
def test_the_content_decides_and_not_the_name(tmp_path, name):
    path = tmp_path / name
    trc.save(path, MOTION)
    assert mocap_files.format_of(path).name == "TRC"
    path.write_bytes(c3d_bytes(MOTION.positions_world, MOTION.marker_names))
    assert mocap_files.format_of(path).name == "C3D"
    opensim.save(path, ANGLES)
    assert mocap_files.format_of(path).name == "storage"


def test_markers_and_coordinates_are_loaded_by_one_call(tmp_path):
    path = tmp_path / "motion"
    trc.save(path, MOTION)
    markers = mocap_files.load_recording(path, unit="mm")
    assert isinstance(markers, MarkerTrajectories)
    np.testing.assert_array_equal(markers.positions_world, MOTION.positions_world / 1000)
    opensim.save(path, ANGLES)
    angles, degrees = (mocap_files.load_recording(path, in_degrees=d) for d in (None, True))
    assert isinstance(angles, JointTrajectories)
    assert isinstance(degrees, JointTrajectories)
    np.testing.assert_array_equal(angles.values, ANGLES.values)
    np.testing.assert_allclose(degrees.values, np.deg2rad(ANGLES.values))


@pytest.mark.parametrize(("name", "recording"), [
    ("a.trc", MOTION), ("a.csv", MOTION), ("a.mot", ANGLES), ("a.sto", ANGLES), ("a.CSV", ANGLES),
])  # fmt: skip
def test_what_is_saved_by_its_name_is_loaded_as_it_was(tmp_path, name, recording):
    mocap_files.save_recording(tmp_path / name, recording)
    again = mocap_files.load_recording(tmp_path / name)
    assert type(again) is type(recording)
    np.testing.assert_array_equal(again.times, recording.times)
    if isinstance(recording, MarkerTrajectories):
        np.testing.assert_array_equal(
            load_markers(tmp_path / name, up="y" if name.endswith("trc") else None).positions_world,
            recording.positions_world,
        )
    else:
        assert isinstance(again, JointTrajectories)
        np.testing.assert_array_equal(again.values, recording.values)


@pytest.mark.parametrize(
    ("name", "recording", "cure"),
    [
        ("a.mot", MOTION, ".trc or .csv"),
        ("a", ANGLES, ".mot, .sto or .csv"),
        ("a.c3d", MOTION, ".trc"),
    ],
)
def test_a_name_that_does_not_fit_is_refused(tmp_path, name, recording, cure):
    with pytest.raises(LegsimError, match=f"cannot be written as .*; end the name in {cure}"):
        mocap_files.save_recording(tmp_path / name, recording)


def test_markers_alone_refuse_coordinates(tmp_path):
    path = tmp_path / "motion.mot"
    opensim.save(path, ANGLES)
    with pytest.raises(
        LegsimError, match=r"holds joint coordinates, not markers; give a marker file"
    ):
        load_markers(path)


@pytest.mark.parametrize(("name", "content", "message"), [
    ("x.txt", b"a,b\n1,2\n", ("no recording that can be told by its first bytes or its name; give a .c3d, .trc, "
        ".mot, .sto, .tsv or .csv file")),
    ("x.trc", b"a,b\n1,2\n", "should start with PathFileType"),
    ("x.csv", b"a,b\n1,2\n", "the header starts with 'a'"),
    ("x.c3d", b"", "the file is empty"),
    ("x.mot", b"abc", "no line says endheader"),
])  # fmt: skip
def test_other_files_are_refused(tmp_path, name, content, message):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(LegsimError, match=message):
        mocap_files.load_recording(path)


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    for path in (tmp_path / "none.trc", tmp_path):
        with pytest.raises(LegsimError, match="cannot be read"):
            mocap_files.load_recording(path)


def test_every_odd_file_has_a_row_in_the_table(shared_data):
    files = {
        f"{p.parent.name}/{p.name}"
        for folder in ("odd_trc", "odd_c3d")
        for p in (shared_data / "mocap" / folder).iterdir()
    }
    assert files == {name for name, _ in odd_files()}


@pytest.mark.parametrize(("name", "outcome"), odd_files())
def test_an_odd_file_becomes_what_the_table_says(shared_data, name, outcome):
    assert describe(shared_data / "mocap" / name) == outcome


def describe(path: Path) -> str:
    """What becomes of a file, in the words of the table."""
    try:
        raw = read_raw(path)
        assert isinstance(raw, RawMarkers)
        motion = raw.to_motion()
    except LegsimError as error:
        return "refused" + str(error).removeprefix(str(path)).replace("|", "\\|")
    seen = np.isfinite(motion.positions_world).all(-1).mean()
    what = (
        f"{len(motion.marker_names)} markers, {len(motion.times)} samples at "
        f"{motion.rate_hz:.6g} Hz from {motion.times[0]:.4g} s"
    )
    notes = "".join(f"; {note}" for note in raw.notes)
    return (
        f"{what}, unit {raw.resolved_unit()}, up {raw.resolved_up()}, {100 * seen:.1f} % "
        f"seen{notes}"
    )


def test_the_encodings_of_one_trial_give_the_same_markers(shared_data):
    folder = shared_data / "mocap/odd_c3d"
    whole = load_markers(folder / "pc_real.c3d")
    for name in ("pc_int", "dec_int", "dec_real", "sgi_int", "sgi_real"):
        other = load_markers(folder / f"{name}.c3d")
        assert other.marker_names == whole.marker_names
        np.testing.assert_allclose(
            other.positions_world, whole.positions_world, atol=2.9e-4
        )  # one step of the whole numbers is 0.28 mm


@pytest.mark.parametrize(
    "name",
    [
        "odd_c3d/dec_int.c3d",
        "odd_c3d/pc_real.c3d",
        "odd_c3d/duplicate_labels.c3d",
        "squat_dart/squat.c3d",
    ],
)
def test_an_independent_reader_finds_the_same_numbers(shared_data, name):
    ezc3d = pytest.importorskip("ezc3d")
    path = shared_data / "mocap" / name
    theirs = np.moveaxis(ezc3d.c3d(str(path))["data"]["points"][:3], [0, 1, 2], [2, 1, 0])
    raw = read_raw(path)
    assert isinstance(raw, RawMarkers)
    np.testing.assert_allclose(raw.positions, theirs, atol=1e-3)


@pytest.mark.parametrize(("name", "recording", "options", "message"), [
    ("a.csv", MOTION, {"unit": "mm", "up": "z"}, "in meters with y up: unit and up cannot apply; leave out unit and up"),
    ("a.csv", ANGLES, {"unit": "mm"}, "whose columns name their units: unit cannot apply"),
    ("a.csv", ANGLES, {"in_degrees": True}, "whose columns name their units: angles cannot apply"),
    ("a.mot", ANGLES, {"up": "z"}, "joint coordinates, not markers: up cannot apply"),
    ("a.trc", MOTION, {"in_degrees": True}, "markers, not joint coordinates: angles cannot apply"),
])  # fmt: skip
def test_an_option_that_cannot_apply_is_refused(tmp_path, name, recording, options, message):
    mocap_files.save_recording(tmp_path / name, recording)
    with pytest.raises(LegsimError, match=message):
        mocap_files.load_recording(tmp_path / name, **options)


def test_the_whole_of_a_table_is_read_once(tmp_path, monkeypatch):
    mocap_files.save_recording(tmp_path / "a.csv", ANGLES)
    reads = []
    read = core_files.content
    monkeypatch.setattr(core_files, "content", lambda path: reads.append(path) or read(path))
    mocap_files.load_recording(tmp_path / "a.csv")
    assert len(reads) == 1


def test_text_is_read_whatever_its_ending(tmp_path):
    trc.save(tmp_path / "a.trb", MOTION)
    assert mocap_files.labels_of(read_raw(tmp_path / "a.trb")) == MOTION.marker_names


def test_no_two_formats_share_an_ending():
    suffixes = [suffix for form in mocap_files.FORMATS for suffix in form.suffixes]
    assert len(set(suffixes)) == len(suffixes)


@pytest.mark.parametrize("lead", ["\n", "\t", "\r\n", " \n\t"])
def test_blanks_before_a_trc_make_it_no_c3d(tmp_path, lead):
    """A line end or tab before the P of PathFileType reads like the first two bytes of a C3D."""
    motion = MarkerTrajectories(np.arange(3) / 100, ("A",), np.ones((3, 1, 3)))
    trc.save(tmp_path / "a.trc", motion)
    (tmp_path / "a.trc").write_bytes(lead.encode() + (tmp_path / "a.trc").read_bytes())
    assert mocap_files.format_of(tmp_path / "a.trc").name == "TRC"
    assert len(mocap_files.load_recording(tmp_path / "a.trc", up="y").times) == 3


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.txt", b"PacketCounter,Acc_X,Acc_Y,Gyr_X\n1,0,0,0\n", "signals of sensors.*give it by"),
        ("a.csv", b"t;accel x;gyro x\n0;1;2\n", "signals of sensors.*give it by --imu"),
        ("a.txt", b"t,s1_gyrX,s1_FreeAccX\n0,1,2\n", "signals of sensors.*give it by --imu"),
        ("a.txt", b"Vaccaro; lab: Gyrus\nRASI x\n1\n", "is no recording that can be told"),
        ("a.txt", b"Vaccaro\ngyr x\n1\n", "is no recording that can be told"),
        ("a.txt", b"accuracy 1 mm\nGyrus\n1\n", "is no recording that can be told"),
        ("a.trb", b"a\0b", "is of the kind that Cortex keeps for itself"),
        ("a.csv", b"time_s,s_ax_m_s2,s_ay_m_s2\n0,1,2\n", "'s_ax_m_s2' is a sensor's; give it by"),
        ("a", b"", "the file is empty"),
        ("a.trc", b"\x1f\x8b\x08\x00", r"is packed \(gzip\)"),
        ("a.txt", b"RAcc,LAcc\n1,2\n", "is no recording that can be told"),
    ],
)
def test_what_is_no_recording_is_called_by_what_it_is(tmp_path, name, content, said):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(LegsimError, match=said):
        mocap_files.read_raw(tmp_path / name)
