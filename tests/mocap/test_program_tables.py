"""Tables of markers of Motive, Nexus and Qualisys: the same markers out of each, and refusals."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.mocap import files, program_tables
from legsim.mocap.raw import RawMarkers
from tests.examples.capture_tables import NAMES, RATE, motive, nexus, qualisys


@pytest.fixture
def positions(rng) -> np.ndarray:
    """(n, m, 3) mm of a body 1 m tall along z; LKNE is not seen in one frame."""
    places = rng.uniform(10, 900, (12, 3, 3)).round(3)
    places[4, 2] = np.nan
    return places


Writer = Callable[[np.ndarray], str]
WRITERS: dict[str, Writer] = {
    "motive.csv": motive,
    "nexus.csv": nexus,
    "qualisys.tsv": qualisys,
    "no_times.tsv": lambda positions: qualisys(positions, timed=False),
}


@pytest.mark.parametrize("name", WRITERS)
def test_markers_times_and_units_are_those_of_the_program(tmp_path, positions, name):
    path = tmp_path / name
    path.write_text(WRITERS[name](positions), encoding="utf-8")
    found = files.load_markers(path, up="z")
    assert [label.split(":")[-1] for label in found.marker_names] == list(NAMES)
    np.testing.assert_allclose(found.times, np.arange(12) / RATE, rtol=0, atol=1e-12)
    x, y, z = np.moveaxis(positions / 1e3, -1, 0)
    np.testing.assert_allclose(found.positions_world, np.stack([x, z, -y], -1), atol=1e-12)


def test_what_is_up_is_the_programs_habit_where_the_body_does_not_say(tmp_path, positions):
    for name, up in (("motive.csv", "y"), ("nexus.csv", "z"), ("qualisys.tsv", "z")):
        (tmp_path / name).write_text(WRITERS[name](positions), encoding="utf-8")
        raw = files.read_raw(tmp_path / name)
        assert isinstance(raw, RawMarkers)
        assert raw.usual_up == up


def test_frames_that_are_left_out_are_noted_and_keep_their_times(tmp_path, positions):
    lines = nexus(positions).split("\n")
    del lines[15:17]
    (tmp_path / "n.csv").write_text("\n".join(lines))
    raw = program_tables.read_nexus(tmp_path / "n.csv")
    np.testing.assert_allclose(raw.times[2:5], np.array([2, 5, 6]) / RATE)
    assert raw.notes == ("2 frames are left out",)


def read_text(tmp_path: Path, text: str) -> RawMarkers:
    (tmp_path / "q.tsv").write_text(text, encoding="utf-8")
    return program_tables.read_qualisys(tmp_path / "q.tsv")


@pytest.mark.parametrize("timed", [True, False])
@pytest.mark.parametrize("closed", ["", "\t"])
def test_frames_in_which_nothing_is_seen_keep_their_times(tmp_path, positions, timed, closed):
    lines = qualisys(positions, timed=timed).split("\n")
    first = len(lines) - 1 - len(positions)
    for k in (first, first + 1):
        cells = lines[k].split("\t")
        lines[k] = "\t".join(cells[: 2 * timed] + [""] * 9)
    text = "\n".join([*lines[:first], *(line + closed for line in lines[first:-1])]) + "\n"
    raw = read_text(tmp_path, text)
    np.testing.assert_allclose(raw.times, np.arange(12) / RATE, atol=1e-12)
    assert np.isnan(raw.positions[:2]).all()
    assert np.isfinite(raw.positions[3:]).any((1, 2)).all()


@pytest.mark.parametrize("timed", [True, False])
@pytest.mark.parametrize("closed", ["", "\t"])
def test_a_last_marker_that_is_never_seen_has_its_columns(tmp_path, positions, timed, closed):
    lines = qualisys(positions, timed=timed).split("\n")
    for k in range(len(lines) - 1 - len(positions), len(lines) - 1):
        cells = lines[k].split("\t")
        lines[k] = "\t".join(cells[: 2 * timed + 6] + [""] * 3) + closed
    raw = read_text(tmp_path, "\n".join(lines))
    assert len(raw.times) == 12
    whole = read_text(tmp_path, qualisys(positions, timed=timed))
    np.testing.assert_array_equal(raw.positions[:, :2], whole.positions[:, :2])
    assert np.isnan(raw.positions[:, 2]).all()


def test_a_quote_in_a_description_is_text_and_those_around_a_name_are_not(tmp_path, positions):
    text = qualisys(positions)
    raw = read_text(
        tmp_path,
        text.replace("DATA_INCLUDED", 'DESCRIPTION\t"quote\nDATA_INCLUDED').replace(
            f"\t{NAMES[0]}\t", f'\t"{NAMES[0]}"\t', 1
        ),
    )
    np.testing.assert_array_equal(raw.positions, read_text(tmp_path, text).positions)
    assert raw.labels[0] == NAMES[0]


def broken(text: str, old: str, new: str) -> str:
    assert old in text
    return text.replace(old, new)


@pytest.mark.parametrize(
    ("name", "change", "said"),
    [
        ("m.csv", lambda p: motive(p, kind="Rigid Body"), "holds Bone, Rigid Body, .*no markers"),
        ("m.csv", lambda p: motive(p, space="Local"), "positions in the space 'Local'"),
        (
            "m.csv",
            lambda p: broken(motive(p), ",Export Frame Rate,120.000000", ""),
            "no rate of a camera in Hz",
        ),
        ("m.csv", lambda p: motive(p).split("Frame,Time")[0], "has no line Frame, Time"),
        ("n.csv", lambda p: broken(nexus(p), "Trajectories", "Model Outputs"), "no line Traject"),
        ("n.csv", lambda p: broken(nexus(p), "mm,mm,mm", "mm,deg,mm"), "several units .*deg, mm"),
        ("n.csv", lambda p: broken(nexus(p), "\n3,0,", "\n2,0,"), r"line 15\): has no time after"),
        ("n.csv", lambda p: broken(nexus(p), "\n3,0,", "\n3,0,x"), r"line 15\): 'x.* is not a num"),
        (
            "n.csv",
            lambda p: nexus(np.where(np.arange(3) == 1, np.nan, p)),
            "one or two coordinates",
        ),
        ("q.tsv", lambda p: qualisys(p, included="6D"), "DATA_INCLUDED.: holds 6D, no markers"),
        (
            "force.tsv",
            lambda p: (
                "NO_OF_SAMPLES\t9\nFREQUENCY\t200\nDATA_INCLUDED\tForce\nSample\tTime\n1\t0\n"
            ),
            "DATA_INCLUDED.: holds Force, no markers; export 3D data",
        ),
        ("q.tsv", lambda p: broken(qualisys(p), "RASI", "RASI\tC7"), "11 columns for 4 markers"),
        ("q.tsv", lambda p: broken(qualisys(p), "FREQUENCY\t120", "FREQUENCY\t0"), "no rate of a"),
        ("q.tsv", lambda p: broken(qualisys(p), "Y\t120", "Y\t1e-320"), "no rate of a camera"),
    ],
)
def test_a_table_that_would_need_a_guess_is_refused(tmp_path, positions, name, change, said):
    path: Path = tmp_path / name
    path.write_text(change(positions), encoding="utf-8")
    with pytest.raises(LegsimError, match=said):
        files.read_recording(path)
