"""A scale of the wrong sign neither scatters markers nor cuts a file in half."""

import struct

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.mocap import c3d, c3d_analog
from tests.references.c3d import ORDER, Channels, c3d_bytes, floats

POSITIONS = np.random.default_rng(4).uniform(-900, 1800, (60, 5, 3)).round(1)
LABELS = ["A", "B", "C", "D", "E"]


def with_other_sign(data: bytes, processor: int) -> bytes:
    """The same file with the header's scale turned."""
    turned = bytearray(data)
    scale = np.frombuffer(data[12:16], ORDER[processor] + "f4").astype(float)
    if processor == 85:
        words = struct.unpack("<2H", data[12:16])
        scale = np.frombuffer(struct.pack("<2H", *words[::-1]), "<f4").astype(float) / 4
    turned[12:16] = floats(-scale, processor)
    return bytes(turned)


@pytest.mark.parametrize("processor", [84, 85, 86])
@pytest.mark.parametrize("scale", [-0.1, 0.1])
def test_the_numbers_decide_which_they_are(tmp_path, processor: int, scale: float):
    data = c3d_bytes(POSITIONS, LABELS, scale=scale, processor=processor)
    (tmp_path / "a.c3d").write_bytes(with_other_sign(data, processor))
    found = c3d.read(tmp_path / "a.c3d")
    np.testing.assert_allclose(found.positions, POSITIONS, atol=1e-3)
    what = "whole" if scale > 0 else "floating-point"
    assert any(f"read as {what} numbers" in note for note in found.notes)


@pytest.mark.parametrize("processor", [84, 85, 86])
@pytest.mark.parametrize("scale", [-0.1, 0.1])
def test_a_right_sign_is_believed(tmp_path, processor: int, scale: float):
    (tmp_path / "a.c3d").write_bytes(c3d_bytes(POSITIONS, LABELS, scale=scale, processor=processor))
    found = c3d.read(tmp_path / "a.c3d")
    np.testing.assert_allclose(found.positions, POSITIONS, atol=1e-3)
    assert found.notes == ()


def test_channels_alone_are_no_markers_and_a_wrong_sign_does_not_hide_them(tmp_path):
    stored = np.random.default_rng(5).integers(-2000, 2000, (60, 3))
    one = Channels(stored, ["Fx", "Fy", "Fz"], ["N"] * 3, [0.5] * 3, [0] * 3, rate=100.0)
    data = c3d_bytes(np.ones((60, 0, 3)), [], scale=-0.1, channels=one)
    (tmp_path / "a.c3d").write_bytes(with_other_sign(data, 84))
    np.testing.assert_allclose(c3d_analog.load_analog(tmp_path / "a.c3d").values, one.values)
    with pytest.raises(LegsimError, match=r"holds analog channels .* and no marker; export"):
        c3d.read(tmp_path / "a.c3d")


def test_a_file_of_floats_that_was_cut_short_stays_one(tmp_path):
    """Channels of small numbers look like no usual floats."""
    positions = np.vstack([POSITIONS] * 4)
    positions[:, 2:] = 1e-9
    data = c3d_bytes(positions, LABELS, scale=-0.1)
    (tmp_path / "a.c3d").write_bytes(data[: int(0.9 * len(data))])
    with pytest.raises(LegsimError, match="the file ends"):
        c3d.read(tmp_path / "a.c3d")
