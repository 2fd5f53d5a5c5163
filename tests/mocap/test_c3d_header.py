"""Header and parameters of C3D files, decoded for every processor and never trusted."""

from pathlib import Path

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.mocap import _c3d_header
from tests.references.c3d import c3d_bytes, floats

POINTS = np.arange(2 * 3 * 3, dtype=float).reshape(2, 3, 3) + 1
PATH = Path("trial.c3d")


@pytest.mark.parametrize("processor", [84, 85, 86])
def test_every_processor_tells_the_same(processor):
    data = c3d_bytes(
        POINTS,
        ["A", "Bb", "C"],
        processor=processor,
        rate=119.88,
        first_frame=12,
        screens=("+X", "-Z"),
        analog_words=6,
    )
    header = _c3d_header.read_header(PATH, data)
    assert (header.points, header.analog_words, header.first_frame, header.last_frame) == (
        3,
        6,
        12,
        13,
    )
    assert header.rate == pytest.approx(119.88, rel=1e-6)
    assert header.scale == -1
    assert header.texts("POINT", "LABELS") == ("A", "Bb", "C")
    assert header.texts("POINT", "Y_SCREEN") == ("-Z",)
    assert header.numbers("POINT", "USED").tolist() == [3]
    assert header.notes == ()


@pytest.mark.parametrize("processor", [84, 85, 86])
def test_floats_of_every_processor_round_trip(processor, rng):
    values = np.r_[rng.normal(size=50) * 10.0 ** rng.integers(-10, 10, 50), 0.0, 1.0, -1.0].astype(
        "f4"
    )
    np.testing.assert_array_equal(_c3d_header.floats(floats(values, processor), processor), values)


def test_an_absent_parameter_is_empty():
    header = _c3d_header.read_header(PATH, c3d_bytes(POINTS, "ABC"))
    assert header.texts("POINT", "NONE") == ()
    assert header.numbers("NONE", "RATE").size == 0


@pytest.mark.parametrize(("change", "message"), [
    (lambda d: b"", "the file is empty"),
    (lambda d: d[:700], "the first block is not that of a C3D file"),
    (lambda d: b"PathFileType" + d, "the first block is not that of a C3D file"),
    (lambda d: bytes([200]) + d[1:], "should start at block 200, outside the file"),
    (lambda d: d[:515] + bytes([1]) + d[516:], "processor type 1 is not 84"),
    (lambda d: d[:516] + bytes(200) + d[716:], "the parameter section holds no parameter"),
])  # fmt: skip
def test_damage_is_refused_in_one_line(change, message):
    with pytest.raises(LegsimError, match=message):
        _c3d_header.read_header(PATH, change(c3d_bytes(POINTS, "ABC")))


@pytest.mark.parametrize("step", [0, 1])
def test_a_chain_of_records_that_bites_its_tail_ends(step):
    data = bytearray(c3d_bytes(POINTS, "ABC", processor=86))
    place = data.index(b"RATE") + 4
    data[place : place + 2] = bytes([0, step])
    header = _c3d_header.read_header(PATH, bytes(data))
    assert header.numbers("POINT", "RATE").size == 1
    assert header.texts("POINT", "LABELS") == ()
    assert header.notes == ()


def test_a_parameter_that_reaches_beyond_its_section_ends_the_chain_with_a_note():
    data = bytearray(c3d_bytes(POINTS, "ABC"))
    place = data.index(b"LABELS") + 6 + 2
    data[place + 1 : place + 4] = bytes([2, 255, 255])
    assert "breaks off at byte" in _c3d_header.read_header(PATH, bytes(data)).notes[0]


def test_texts_without_letters_are_none_however_many_are_claimed():
    data = bytearray(c3d_bytes(POINTS, "ABC"))
    place = data.index(b"LABELS") + 6 + 2
    data[place + 1 : place + 8] = bytes([6, 0, *[255] * 5])
    assert _c3d_header.read_header(PATH, bytes(data)).texts("POINT", "LABELS") == ()
