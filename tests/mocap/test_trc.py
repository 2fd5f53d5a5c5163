"""TRC: exact round trips, tolerance for what is unusual, refusal of what would be a guess."""

import re
import string

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from legsim.core.errors import LegsimError
from legsim.mocap import trc
from legsim.mocap.trajectories import MarkerTrajectories

NAMES = st.lists(
    st.text(string.ascii_letters + string.digits + "._:-#* é", min_size=1, max_size=8)
    .map(str.strip)
    .filter(bool),
    min_size=1,
    max_size=4,
    unique=True,
)
COORDINATE = st.floats(-1e4, 1e4, allow_subnormal=False).filter(lambda x: x != 0)
FIXTURES_ARE_SAFE = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
HEADER = "PathFileType\t4\t(X/Y/Z)\tx.trc\nDataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n"


def text(
    rows,
    *,
    rate="100",
    frames=3,
    unit="mm",
    names="A\t\t\tB",
    axes="\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n\n",
):
    """A small file of two markers."""
    return (
        f"{HEADER}{rate}\t{rate}\t{frames}\t2\t{unit}\t{rate}\t1\t{frames}\nFrame#\tTime\t{names}\t\t\n{axes}"
        + "\n".join(rows)
        + "\n"
    )


ROWS = ["1\t0.00\t1\t2\t3\t4\t5\t6", "2\t0.01\t1\t2\t3\t4\t5\t6", "3\t0.02\t1\t2\t3\t4\t5\t6.5"]


@pytest.fixture
def write(tmp_path):
    """Writes a file and gives its path."""

    def _write(content: str | bytes):
        path = tmp_path / "trial.trc"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return _write


@st.composite
def motions(draw):
    names = draw(NAMES)
    n = draw(st.integers(1, 6))
    times = np.cumsum(draw(st.lists(st.floats(1e-4, 10), min_size=n, max_size=n)))
    positions = np.array(
        draw(st.lists(COORDINATE, min_size=3 * n * len(names), max_size=3 * n * len(names)))
    ).reshape(n, len(names), 3)
    positions[
        np.array(
            draw(st.lists(st.booleans(), min_size=n * len(names), max_size=n * len(names)))
        ).reshape(n, -1)
    ] = np.nan
    positions[0, 0] = 1.0
    return MarkerTrajectories(times, tuple(names), positions)


@FIXTURES_ARE_SAFE
@given(motion=motions())
def test_what_is_saved_is_loaded_to_the_last_bit(tmp_path, motion):
    path = tmp_path / "motion.trc"
    trc.save(path, motion)
    again = trc.load(path, up="y")
    assert again.marker_names == motion.marker_names
    np.testing.assert_array_equal(again.times, motion.times)
    np.testing.assert_array_equal(again.positions_world, motion.positions_world)


@FIXTURES_ARE_SAFE
@given(motion=motions(), where=st.floats(0, 1), junk=st.binary(max_size=4), cut=st.booleans())
def test_damage_gives_an_error_in_one_line_or_a_motion(tmp_path, motion, where, junk, cut):
    path = tmp_path / "motion.trc"
    trc.save(path, motion)
    data = path.read_bytes()
    place = int(where * len(data))
    path.write_bytes(data[:place] + (b"" if cut else junk + data[place + len(junk) :]))
    problem = f"{path}: one line"
    try:
        assert isinstance(trc.load(path), MarkerTrajectories)
    except LegsimError as error:
        problem = str(error)
    assert problem.startswith(str(path))
    assert "\n" not in problem


@FIXTURES_ARE_SAFE
@given(motion=motions(), where=st.floats(0, 1))
def test_a_file_cut_off_before_its_last_row_never_gives_shortened_numbers(tmp_path, motion, where):
    path = tmp_path / "motion.trc"
    trc.save(path, motion)
    data = path.read_bytes()
    last = data.rstrip(b"\n").rfind(b"\n")
    path.write_bytes(data[: int(where * last)])
    try:
        found = trc.load(path, up="y")
    except LegsimError:
        return
    np.testing.assert_array_equal(found.positions_world, motion.positions_world[: len(found.times)])


@FIXTURES_ARE_SAFE
@given(data=st.binary(max_size=300))
def test_any_bytes_give_an_error_in_one_line(tmp_path, data):
    path = tmp_path / "any.trc"
    path.write_bytes(data)
    with pytest.raises(LegsimError):
        trc.load(path)


@pytest.mark.parametrize("change", [
    lambda s: s.replace("\n", "\r\n"),
    lambda s: s.replace("\n", "\r"),
    lambda s: s.replace("\t", ","),
    lambda s: s.replace("\t", ";"),
    lambda s: s.encode("utf-16"),
    lambda s: s.replace("0.01", "10").replace("0.02", "20"),
    lambda s: re.sub(r"\n(?=[123]\t)", "\n\t", s),
    lambda s: s.replace("\t6\n", "\t6\t\t\t\n"),
    lambda s: s.replace("\t1\t2\t3", "\t1.0E+00\t2e0\t3.000"),
    lambda s: s.replace("\n\n", "\n\t\t\t\n\n"),
    lambda s: s.replace("\n\n", "\n\t\x0b\t\n"),
    lambda s: s.replace("\n\n", "\n"),
    lambda s: s.replace("\tX1\tY1\tZ1\tX2\tY2\tZ2", ""),
    lambda s: s.replace("A\t\t\tB", " A \t\t\tB "),
    lambda s: s.replace("A\t\t\tB", "A\tB"),
    lambda s: s.replace("DataRate\tCameraRate", "DATARATE\tCameraRate"),
    lambda s: s.replace("mm\t", "MM\t"),
    lambda s: s.replace("Frame#\tTime\tA\t\t\tB\t\t", "Frame#\tTime     A             B"),
])  # fmt: skip
def test_unusual_but_plain_files_read_the_same(write, change):
    found = trc.load(write(change(text(ROWS))), up="y")
    assert found.marker_names == ("A", "B")
    np.testing.assert_array_equal(found.times, [0, 0.01, 0.02])
    np.testing.assert_array_equal(
        found.positions_world[2], [[0.001, 0.002, 0.003], [0.004, 0.005, 0.0065]]
    )


@pytest.mark.parametrize(
    "missing",
    [
        "\t\t\t",
        "\tNaN\tnan\tNAN",
        "\t   NaN\tnan \tNaN",
        "\t0\t0.0\t-0",
        "\t1.#QNAN\t-1.#IND\t1.#QNAN",
        "\t \t \t ",
    ],
)
def test_blank_nan_and_exact_zero_are_not_seen(write, missing):
    rows = [ROWS[0], f"2\t0.01{missing}\t4\t5\t6", ROWS[2]]
    found = trc.load(write(text(rows)), up="y")
    assert np.isnan(found.positions_world[1, 0]).all()
    assert np.isfinite(np.delete(found.positions_world.reshape(6, 3), 2, axis=0)).all()


def test_rows_that_leave_out_closing_blanks_are_padded(write):
    found = trc.load(write(text([ROWS[0], "2\t0.01\t1\t2\t3", "3\t0.02"])), up="y")
    assert np.isnan(found.positions_world[1:, 1]).all()
    assert np.isnan(found.positions_world[2, 0]).all()


def test_columns_beyond_the_named_markers_are_unlabeled_and_left_out(write):
    raw = trc.read(write(text([ROWS[0] + "\t7\t8\t9", *ROWS[1:]])))
    assert raw.labels == ("A", "B")
    assert raw.notes == ("1 rows hold columns beyond the named markers: unlabeled, ignored",)


def test_a_column_without_a_name_between_named_ones_is_left_out(write):
    rows = [row + "\t7\t8\t9" for row in ROWS]
    found = trc.load(write(text(rows, names="A\t\t\t\t\t\tC", axes="\n")), up="y")
    assert found.marker_names == ("A", "C")
    np.testing.assert_array_equal(found.positions_world[0, 1], [0.007, 0.008, 0.009])


def test_equal_names_are_told_apart(write):
    assert trc.load(write(text(ROWS, names="A\t\t\tA")), up="y").marker_names == ("A#1", "A#2")


def test_a_wrong_frame_count_is_noted(write):
    assert trc.read(write(text(ROWS, frames=900))).notes == (
        "the header says 900 frames; 3 are there and read",
    )


@pytest.mark.parametrize(
    ("unit", "factor"), [("m", 1), ("cm", 100), ("mm", 1000), ("mete", 1), ("Millimeters", 1000)]
)
def test_units_become_metres(write, unit, factor):
    found = trc.load(write(text(ROWS, unit=unit)), up="y")
    np.testing.assert_allclose(
        found.positions_world[0, 0], np.array([1, 2, 3]) / factor, rtol=1e-15
    )


def test_a_given_unit_overrides_the_header(write):
    found = trc.load(write(text(ROWS, unit="parsec")), unit="m", up="z")
    np.testing.assert_array_equal(found.positions_world[0, 0], [1, 3, -2])


@pytest.mark.parametrize("rate", [150.0, 60.0, 400.0, 119.88])
@pytest.mark.parametrize("first", [1, 185])
def test_times_published_in_milliseconds_become_those_of_the_rate(write, rate, first):
    frames = np.arange(first, first + 20)
    rows = [f"{k}\t{np.floor((k - 1) / rate * 1000) / 1000:.3f}\t1\t2\t3\t4\t5\t6" for k in frames]
    found = trc.load(write(text(rows, rate=f"{rate:.2f}", frames=20)), up="y")
    np.testing.assert_allclose(found.times, (frames - 1) / rate, atol=1e-12)


def test_times_that_start_elsewhere_than_frame_one_are_kept(write):
    rows = [f"{k}\t{k / 100:.2f}\t1\t2\t3\t4\t5\t6" for k in range(1, 21)]
    np.testing.assert_array_equal(
        trc.load(write(text(rows, frames=20)), up="y").times,
        [float(f"{k / 100:.2f}") for k in range(1, 21)],
    )


def test_a_time_column_of_another_rate_is_kept(write):
    rows = [f"{k}\t{(k - 1) / 100:.2f}\t1\t2\t3\t4\t5\t6" for k in range(1, 21)]
    found = trc.read(write(text(rows, rate="200", frames=20)))
    np.testing.assert_allclose(found.times, np.arange(20) / 100)
    assert found.notes == ("the header says 200 Hz, the time column 100 Hz, which is taken",)


@pytest.mark.parametrize(("unit", "seconds", "digits"), [
    ("milliseconds", 1e-3, 1), ("microseconds", 1e-6, 0), ("minutes", 60.0, 8),
])  # fmt: skip
@pytest.mark.parametrize("rate", [100.0, 119.88])
def test_a_time_column_in_another_unit_becomes_seconds(write, rate, unit, seconds, digits):
    rows = [f"{k}\t{k / rate / seconds:.{digits}f}\t1\t2\t3\t4\t5\t6" for k in range(20)]
    found = trc.read(write(text(rows, rate=f"{rate:g}", frames=20)))
    np.testing.assert_allclose(found.times, np.arange(20) / rate, atol=1e-6)
    assert found.notes == (f"the time column is in {unit}",)


def test_a_sample_every_second_is_warned_of(write):
    rows = [f"{k + 1}\t{k}.0\t1\t2\t3\t4\t5\t6" for k in range(20)]
    (note,) = trc.read(write(text(rows, rate="1", frames=20))).notes
    assert note.startswith("warning: a sample every 1 s: no movement is followed so slowly")


def test_an_empty_first_column_leaves_names_with_blanks_whole(write):
    plain = text(ROWS, names="R ASIS\t\t\tL ASIS")
    head, _, rest = plain.partition("Frame#")
    shifted = head + "".join(f"\t{line}\n" for line in ("Frame#" + rest).splitlines())
    for content in (plain, shifted):
        found = trc.read(write(content))
        assert found.labels == ("R ASIS", "L ASIS")
        np.testing.assert_array_equal(found.positions[0], [[1, 2, 3], [4, 5, 6]])


def test_a_last_row_of_blanks_without_line_end_is_whole(write):
    blank = [*ROWS[:2], "3\t0.02\t1\t2\t3\t\t\t"]
    found = trc.read(write(text(blank).rstrip("\n")))
    assert np.isnan(found.positions[2, 1]).all()
    with pytest.raises(LegsimError, match=r"line 9\): the file breaks off in this row"):
        trc.read(write(text(blank).rstrip("\n")[:-1]))


def test_a_time_column_that_counts_frames_becomes_seconds(write):
    rows = [f"{k + 1}\t{k}\t1\t2\t3\t4\t5\t6" for k in range(20)]
    found = trc.read(write(text(rows, rate="120", frames=20)))
    np.testing.assert_allclose(found.times, np.arange(20) / 120, atol=1e-12)
    assert found.notes == (
        "the time column counts frames: times are from it and DataRate (120 Hz)",
    )


@pytest.mark.parametrize("rate", ["0", "", "nan"])
def test_without_a_rate_the_time_columns_is_taken(write, rate):
    found = trc.read(write(text(ROWS).replace("100\t100", f"{rate}\t100", 1)))
    np.testing.assert_allclose(found.times, [0, 0.01, 0.02], atol=1e-12)
    assert found.notes == (f"DataRate is {rate!r}: the rate is the time column's, 100 Hz",)


def of_no_rate(rows, camera="100"):
    """A file whose DataRate is 0."""
    return text(rows, rate=camera, frames=len(rows)).replace(f"\n{camera}\t", "\n0\t", 1)


@pytest.mark.parametrize(("unit", "seconds", "digits"), [
    ("milliseconds", 1e-3, 1), ("microseconds", 1e-6, 0), ("minutes", 60.0, 6),
])  # fmt: skip
def test_without_a_rate_the_cameras_shows_the_unit_of_the_times(write, unit, seconds, digits):
    rows = [f"{k}\t{k / 100 / seconds:.{digits}f}\t1\t2\t3\t4\t5\t6" for k in range(20)]
    found = trc.read(write(of_no_rate(rows)))
    np.testing.assert_allclose(found.times, np.arange(20) / 100, atol=5e-5)
    assert found.notes == (
        "DataRate is '0': the rate is CameraRate, 100 Hz",
        f"the time column is in {unit}",
    )


def test_without_a_rate_one_other_than_the_cameras_is_doubted(write):
    slower = trc.read(write(of_no_rate(ROWS, "250")))
    np.testing.assert_allclose(slower.times, [0, 0.01, 0.02], atol=1e-12)
    (note,) = slower.notes
    assert note.startswith(
        "warning: DataRate is '0': the rate is the time column's, 100 Hz, though"
    )
    with pytest.raises(
        LegsimError, match=r"line 3\): .* column's 100 Hz are more than CameraRate 30"
    ):
        trc.read(write(of_no_rate(ROWS, "30")))


@pytest.mark.parametrize("time", ["0.25", ""])
def test_a_single_frame_needs_no_rate(write, time):
    found = trc.read(write(of_no_rate([f"1\t{time}\t1\t2\t3\t4\t5\t6"])))
    np.testing.assert_array_equal(found.times, [float(time or 0)])
    assert found.notes[0] == "DataRate is '0': a single frame needs none"


@pytest.mark.parametrize("mark", ["\t", ",", ";"])
def test_the_line_of_axes_may_begin_with_words(write, mark):
    axes = "Frame#\ts\tX1\tY1\tZ1\tX2\tY2\tZ2\n\n"
    found = trc.read(write(text(ROWS, axes=axes).replace("\t", mark)))
    np.testing.assert_array_equal(found.positions[0], [[1, 2, 3], [4, 5, 6]])


def test_rows_that_were_left_out_keep_their_times(write):
    rows = [f"{k}\t{(k - 1) / 100:.2f}\t1\t2\t3\t4\t5\t6" for k in range(1, 21) if k not in (7, 8)]
    np.testing.assert_allclose(
        trc.load(write(text(rows, frames=18)), up="y").times, np.delete(np.arange(20), [6, 7]) / 100
    )


def test_a_row_without_time_gets_it_from_its_frame(write):
    raw = trc.read(write(text([ROWS[0], "2", ROWS[2]])))
    np.testing.assert_allclose(raw.times, [0, 0.01, 0.02])
    assert raw.notes == ("1 rows have no time: filled from their frame numbers",)


@pytest.mark.parametrize(("change", "message"), [
    (lambda s: s.replace("PathFileType", "Something"), r"line 1\): the header line should start with PathFileType"),
    (lambda s: s[: s.index("Frame#")], r"line 4\): the file ends before the header line with Frame#"),
    (lambda s: re.sub(r"\t0\.0\d\t", "\t\t", s.replace("100\t100", "0\t100")), r"line 3\): DataRate is '0', not a positive number"),
    (lambda s: s.replace("A\t\t\tB", ""), r"line 4\): no marker is named"),
    (lambda s: s[: s.index("1\t0.00")], r"there is no row of data"),
    (lambda s: s.replace("2\t0.01\t1", "2\t0.01\tone"), (r"line 8\): 'one' of marker 'A' is not a number; write decimal "
        r"points")),
    (lambda s: s.replace("2\t0.01\t1", "2\t0.01\t1,5"), r"line 8\): '1,5' of marker 'A'"),
    (lambda s: s.replace("2\t0.01\t1", "2\t0.01\tinf"), r"line 8\): 'inf' of marker 'A'"),
    (lambda s: s.replace("2\t0.01\t1\t2\t3", "2\t0.01\t1\t\t3"), r"line 8\): marker 'A' has 2 of its 3 coordinates"),
    (lambda s: s.replace("2\t0.01\t1\t2\t3", "2\t0.01\t1\t2"), (r"line 8\): the row holds 5 coordinates, not a multiple of "
        r"three")),
    (lambda s: s.replace("2\t0.01\t1", "2\t0.00\t1"), r"line 8\): time 0.00 does not come after 0.00"),
    (lambda s: s + "\n" + s, r"line 1\d\): another TRC file begins here; split the file"),
    (lambda s: s.replace("3\t0.02", "3\t-1"), r"line 9\): time -1 does not come after 0.01; another trial begins there"),
    (lambda s: s.replace("2\t0.01\t1", "2.5\t0.01\t1"), r"line 8\): frame number '2.5' is not a whole number"),
    (lambda s: s[: s.rindex("\t4")], r"line 9\): the file breaks off in this row, number 3 of 3"),
    (lambda s: s.replace("mm", "parsec"), r"unit\): unit 'parsec' is not one of m, dm, cm, mm"),
    (lambda s: s.replace("mm", ""), (r"unit\): the file does not say its unit of length; give the "
        r"unit")),
    (lambda s: re.sub(r"\t[1-6](\.5)?(?=[\t\n])", "\t0", s), r"none of its 2 markers is seen at any time"),
])  # fmt: skip
def test_what_would_be_a_guess_is_refused_with_its_line(write, change, message):
    with pytest.raises(LegsimError, match=message):
        trc.load(write(change(text(ROWS))))


@pytest.mark.parametrize("name", ["a\tb", " a", "", "a\nb"])
def test_names_that_cannot_stand_in_the_format_are_not_written(tmp_path, name):
    with pytest.raises(LegsimError, match="cannot be written"):
        trc.save(tmp_path / "x.trc", MarkerTrajectories([0.0, 1.0], (name,), np.ones((2, 1, 3))))


def test_nothing_is_not_written(tmp_path):
    with pytest.raises(LegsimError, match="no marker or no sample"):
        trc.save(tmp_path / "x.trc", MarkerTrajectories([0.0, 1.0], (), np.ones((2, 0, 3))))


@pytest.mark.peer
def test_opensim_opens_ours(tmp_path):
    opensim = pytest.importorskip("opensim")
    path = tmp_path / "motion.trc"
    positions = np.arange(1, 19, dtype=float).reshape(3, 2, 3) / 7
    positions[1, 0] = np.nan
    trc.save(path, MarkerTrajectories([0.0, 0.01, 0.02], ("R.ASIS", "L.ASIS"), positions))
    table = opensim.TimeSeriesTableVec3(str(path))
    assert tuple(table.getColumnLabels()) == ("R.ASIS", "L.ASIS")
    assert table.getTableMetaDataString("Units") == "m"
    found = [
        [[table.getRowAtIndex(k).getElt(0, m).get(c) for c in range(3)] for m in range(2)]
        for k in range(3)
    ]
    np.testing.assert_allclose(found, positions, rtol=1e-15)


@pytest.mark.parametrize("numbers", [
    "  100.0\t\t  100.0\t\t      3\t\t      2\t\t mm\t  100.0\t      1\t      3",
    "100\t\t100\t\t3\t\t2\t\tmm\t\t100\t\t1\t\t3\t\t",
    "\t100\t100\t3\t2\tmm\t100\t1\t3",
    "100;100;3;2;mm;100;1;3",
])  # fmt: skip
def test_a_header_with_doubled_tabs_is_read_as_if_they_were_single(write, numbers):
    content = text(ROWS)
    plain = content.splitlines()[2]
    keys = content.splitlines()[1]
    marked = content.replace(keys, keys.replace("\t", ";")) if ";" in numbers else content
    raw = trc.read(write(marked.replace(plain, numbers)))
    assert (raw.unit, raw.notes) == ("mm", ())


def test_a_blank_unit_between_doubled_tabs_stays_blank(write):
    doubled = "100\t\t100\t\t3\t\t2\t\t\t\t100\t\t1\t\t3"
    raw = trc.read(write(text(ROWS).replace(text(ROWS).splitlines()[2], doubled)))
    assert raw.unit == ""
    assert raw.notes == ()


@pytest.mark.parametrize("spelled", ["-nan(ind)", "1.#QNAN0", "-1.#IND", "N/A"])
def test_a_marker_not_seen_in_any_programs_words_is_nan(write, spelled):
    row = f"2\t0.01\t{spelled}\t{spelled}\t{spelled}\t4\t5\t6"
    raw = trc.read(write(text([ROWS[0], row, ROWS[2]])))
    assert np.isnan(raw.positions[1, 0]).all()
    assert np.isfinite(raw.positions[1, 1]).all()


@pytest.mark.parametrize("spelled", ["inf", "-Infinity", "1.#INF", "-1.#INF00", "9e298"])
def test_infinity_and_what_is_no_place_are_refused(write, spelled):
    row = f"2\t0.01\t{spelled}\t1\t2\t4\t5\t6"
    with pytest.raises(LegsimError, match=r"line 8\): '.*' of marker 'A' is not a number"):
        trc.read(write(text([ROWS[0], row, ROWS[2]])))
