"""C3D: every processor, both number formats, damage refused, agreement with an independent
reader.
"""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from legsim.core.errors import LegsimError
from legsim.mocap import c3d
from legsim.mocap.trajectories import MarkerTrajectories
from tests.references.c3d import c3d_bytes

LABELS = ("LASI", "RASI", "SACR")


@pytest.fixture
def positions(rng):
    """Positions (20, 3, 3) in mm, one marker unseen for a while."""
    positions = rng.uniform(10, 1500, (20, 3, 3))
    positions[5:9, 1] = np.nan
    return positions


@pytest.fixture
def write(tmp_path):
    """Writes a file and gives its path."""

    def _write(data: bytes):
        path = tmp_path / "trial.c3d"
        path.write_bytes(data)
        return path

    return _write


@pytest.mark.parametrize("processor", [84, 85, 86])
@pytest.mark.parametrize(("scale", "tolerance"), [(-0.1, 1e-4), (0.1, 0.051)])
def test_every_processor_and_number_format_gives_the_same_markers(
    write, positions, processor, scale, tolerance
):
    data = c3d_bytes(
        positions, LABELS, processor=processor, scale=scale, analog_words=8, rate=120.0
    )
    found = c3d.load(write(data), up="y")
    assert found.marker_names == LABELS
    np.testing.assert_allclose(found.positions_world * 1000, positions, atol=tolerance)
    np.testing.assert_allclose(found.times, np.arange(20) / 120, atol=1e-12)


@pytest.mark.parametrize("processor", [84, 85])
@pytest.mark.parametrize("scale", [-0.1, 0.1])
def test_an_independent_reader_finds_the_same(write, positions, processor, scale):
    ezc3d = pytest.importorskip("ezc3d")
    path = write(c3d_bytes(positions, LABELS, processor=processor, scale=scale, analog_words=0))
    theirs = np.moveaxis(ezc3d.c3d(str(path))["data"]["points"][:3], [0, 1, 2], [2, 1, 0])
    np.testing.assert_allclose(c3d.load(path, up="y").positions_world * 1000, theirs, atol=1e-4)


def test_times_start_at_the_first_frame(write, positions):
    found = c3d.load(write(c3d_bytes(positions, LABELS, first_frame=121)), up="y")
    np.testing.assert_allclose(found.times[[0, -1]], [1.2, 1.39])


@pytest.mark.parametrize("processor", [84, 86])
@pytest.mark.parametrize(("header", "actual", "first"), [
    (70000 - 65536, 70000, 70000),  # wrapped
    (65535, 70000, 70000),  # at its limit
    (121, 121, 121),
    (121, 1, 121),  # a parameter that the file was cut after
])  # fmt: skip
def test_a_first_frame_beyond_16_bits_is_that_of_its_parameter(
    write, positions, processor, header, actual, first
):
    count = len(positions)
    data = c3d_bytes(
        positions, LABELS, processor=processor, first_frame=header,
        actual=(actual, actual + count - 1),
    )  # fmt: skip
    times = c3d.read(write(data)).times
    np.testing.assert_allclose(times, (first - 1 + np.arange(count)) / 100)


def test_a_count_of_frames_that_wraps_at_16_bits_is_known_by_the_files_length(write, positions):
    more = np.zeros((65536, len(LABELS), 4), "<f4")
    more[..., :3] = np.arange(1, 65537)[:, None, None] / 100
    data = c3d_bytes(positions, LABELS) + more.tobytes()
    found = c3d.read(write(data))
    assert len(found.times) == 65536 + len(positions)
    np.testing.assert_allclose(found.positions[-1, 0], 655.36, rtol=1e-6)


def test_a_file_that_is_longer_than_its_header_says_is_reported(write, positions):
    data = c3d_bytes(positions, LABELS) + np.ones(50 * len(LABELS) * 4, "<f4").tobytes()
    found = c3d.read(write(data))
    assert len(found.times) == len(positions)
    assert "long enough for 70 frames, the header says 20: 20 are read" in found.notes[0]


def test_a_rate_of_zero_gives_way_to_the_headers(write, positions):
    data = bytearray(c3d_bytes(positions, LABELS, rate=100.0))
    place = data.index(b"RATE") + 4 + 2 + 2
    data[place : place + 4] = np.zeros(1, "<f4").tobytes()
    found = c3d.read(write(bytes(data)))
    np.testing.assert_allclose(np.diff(found.times), 0.01)
    assert found.notes == ("POINT:RATE says 0 Hz, the header 100 Hz; 100 Hz is taken",)


@pytest.mark.parametrize(("unit", "factor"), [("mm", 1000), ("m", 1), ("cm", 100), ("mete", 1)])
def test_units_become_metres(write, positions, unit, factor):
    found = c3d.load(write(c3d_bytes(positions, LABELS, unit=unit)), up="y")
    np.testing.assert_allclose(found.positions_world, positions / factor, rtol=1e-6)


def test_without_a_unit_the_file_is_refused_unless_one_is_given(write, positions):
    path = write(c3d_bytes(positions, LABELS, unit=""))
    with pytest.raises(
        LegsimError, match=r"unit\): the file does not say its unit of length; give the unit"
    ):
        c3d.load(path)
    assert np.nanmax(c3d.load(path, unit="mm").positions_world) < 2


@pytest.mark.parametrize(
    ("screens", "up"), [(("+X", "+Y"), "y"), (("+X", "+Z"), "z"), (("+Y", "+Z"), "z"), (None, "z")]
)
def test_the_screen_axes_tell_what_is_up_where_the_markers_do_not(write, rng, screens, up):
    path = write(c3d_bytes(rng.uniform(-100, 100, (4, 2, 3)), ("P1", "P2"), screens=screens))
    np.testing.assert_array_equal(
        c3d.load(path).positions_world, c3d.load(path, up=up).positions_world
    )


def test_results_of_a_body_model_are_no_markers(write, positions):
    path = write(c3d_bytes(positions, LABELS, model_outputs=["RASI"]))
    raw = c3d.read(path)
    assert raw.labels == ("LASI", "SACR")
    assert "1 trajectories are results of a body model" in raw.notes[0]


def test_a_file_of_segments_poses_is_refused_with_what_to_export(write):
    data = c3d_bytes(np.zeros((5, 0, 3)), (), rotations=("pelvis_4X4", "l_thigh_4X4"))
    with pytest.raises(LegsimError, match=r"poses of 2 segments.* no marker; export the joint ang"):
        c3d.read(write(data))


def test_points_beyond_the_labels_are_unlabelled(write, positions):
    assert c3d.read(write(c3d_bytes(positions, LABELS[:2]))).labels == ("LASI", "RASI", "*3")


def test_equal_labels_are_told_apart(write, positions):
    assert c3d.read(write(c3d_bytes(positions, ("A", "B", "A")))).labels == ("A#1", "B", "A#2")


@pytest.mark.parametrize(("change", "message"), [
    (lambda d: d[:-100], "the file ends after frame 17 of 20"),
    (lambda d: d[:2] + b"\0\0" + d[4:], "the file holds no point"),
    (lambda d: d[:12] + bytes(4) + d[16:], "the file has the scale 0"),
    (lambda d: d[:16] + b"\xff\x7f" + d[18:], "should start at block 32767, outside the file"),
    (lambda d: d[:6] + b"\x20\0" + d[8:], "frames 32 to 20 are none"),
    (lambda d: d.replace(b"LABELS", b"LAPELS"), r"POINT:LABELS\): no point has a label"),
    (lambda d: d[:-12] + b"\xff\xff\x7f\x7f" + d[-8:], "cannot be a position"),
])  # fmt: skip
def test_damage_is_refused_in_one_line(write, positions, change, message):
    data = c3d_bytes(positions, LABELS)
    with pytest.raises(LegsimError, match=message):
        c3d.load(write(change(data)))


@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    place=st.integers(0, 1600),
    junk=st.binary(min_size=1, max_size=6),
    keep=st.integers(0, 2200),
    processor=st.sampled_from([84, 85, 86]),
)
def test_any_damage_gives_an_error_in_one_line_or_a_motion(tmp_path, place, junk, keep, processor):
    data = bytearray(c3d_bytes(np.full((10, 3, 3), 7.0), LABELS, processor=processor))
    data[place : place + len(junk)] = junk
    path = tmp_path / "trial.c3d"
    path.write_bytes(data if keep > 2000 else data[:keep])
    problem = f"{path}: none"
    try:
        assert isinstance(c3d.load(path), MarkerTrajectories)
    except LegsimError as error:
        problem = str(error)
    assert problem.startswith(str(path))
    assert "\n" not in problem


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(LegsimError, match="cannot be read"):
        c3d.load(tmp_path / "none.c3d")
