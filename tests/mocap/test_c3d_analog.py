"""Analog channels of every processor and number format, beside an independent reader."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.mocap import c3d_analog
from tests.references.c3d import Channels, c3d_bytes

PER_FRAME, FRAMES = 4, 30


def channels(*, unsigned: bool = False) -> Channels:
    low, high = (0, 65536) if unsigned else (-32768, 32768)
    stored = np.random.default_rng(5).integers(low, high, (FRAMES * PER_FRAME, 3))
    offsets = [32768, 1000, 2048] if unsigned else [-5, 2048, 0]
    return Channels(
        stored, ["ACC X", "ACC Y", "GYR X"], ["g", "g", "deg/s"], [0.01, 0.02, 0.5], offsets, 0.25,
        unsigned=unsigned,
    )  # fmt: skip


def written(
    path: Path, one: Channels, *, points: int = 2, scale: float = -0.1, **more: int
) -> Path:
    positions, labels = np.ones((FRAMES, points, 3)), ["A", "B"][:points]
    path.write_bytes(c3d_bytes(positions, labels, scale=scale, channels=one, **more))
    return path


@pytest.mark.parametrize("processor", [84, 85, 86])
@pytest.mark.parametrize("scale", [-0.1, 0.1])
@pytest.mark.parametrize("unsigned", [False, True])
def test_every_processor_and_number_format_gives_the_same(tmp_path, processor, scale, unsigned):
    one = channels(unsigned=unsigned)
    path = written(tmp_path / "a.c3d", one, processor=processor, scale=scale)
    found = c3d_analog.load_analog(path)
    assert (list(found.labels), list(found.units)) == (one.labels, one.units)
    np.testing.assert_allclose(found.values, one.values, rtol=1e-6, atol=1e-5)


@pytest.mark.parametrize("scale", [-0.1, 0.1])
def test_an_independent_reader_finds_the_same(tmp_path, scale):
    """It knows neither offsets below 0 nor samples without a sign, so there are none of them."""
    ezc3d = pytest.importorskip("ezc3d")
    one = replace(channels(), offsets=[5, 2048, 0])
    path = written(tmp_path / "a.c3d", one, scale=scale)
    theirs = ezc3d.c3d(str(path))["data"]["analogs"][0].T
    np.testing.assert_allclose(c3d_analog.load_analog(path).values, theirs, rtol=1e-6, atol=1e-3)


@pytest.mark.parametrize("points", [0, 2])
def test_markers_beside_the_channels_are_seen(tmp_path, points):
    path = written(tmp_path / "a.c3d", channels(), points=points)
    assert c3d_analog.has_points(path) == (points > 0)
    assert c3d_analog.load_analog(path).values.shape == (FRAMES * PER_FRAME, 3)


def test_samples_have_the_clock_of_the_markers(tmp_path):
    path = written(tmp_path / "a.c3d", channels(), first_frame=51)
    times = c3d_analog.load_analog(path).times
    np.testing.assert_allclose(times, 0.5 + np.arange(FRAMES * PER_FRAME) / 400, atol=1e-12)


def test_a_file_without_points_has_its_channels(tmp_path):
    found = c3d_analog.load_analog(written(tmp_path / "a.c3d", channels(), points=0))
    np.testing.assert_allclose(found.values, channels().values, rtol=1e-6, atol=1e-5)


def test_a_file_without_channels_is_refused(tmp_path):
    (tmp_path / "a.c3d").write_bytes(c3d_bytes(np.ones((20, 2, 3)), ("A", "B"), analog_words=8))
    with pytest.raises(LegsimError, match="holds no analog channel"):
        c3d_analog.load_analog(tmp_path / "a.c3d")


def test_a_rate_that_contradicts_the_samples_is_refused(tmp_path):
    path = written(tmp_path / "a.c3d", replace(channels(), rate=1000.0))
    with pytest.raises(
        LegsimError, match=r"ANALOG:RATE.*states 1000 Hz, and holds samples at 400 Hz"
    ):
        c3d_analog.load_analog(path)


def test_a_rate_that_is_no_number_is_refused(tmp_path):
    path = written(tmp_path / "a.c3d", replace(channels(), rate=np.nan))
    with pytest.raises(LegsimError, match=r"ANALOG:RATE.*states nan Hz"):
        c3d_analog.load_analog(path)


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e35])
@pytest.mark.parametrize("where", ["scales", "gen_scale"])
def test_a_scale_that_is_no_number_is_refused(tmp_path, where, value):
    wrong = [0.01, value, 0.5] if where == "scales" else value
    path = written(tmp_path / "a.c3d", replace(channels(), **{where: wrong}))
    with pytest.raises(LegsimError, match=r"ANALOG.*a scale or offset is no number"):
        c3d_analog.load_analog(path)


def test_samples_that_are_no_numbers_are_missing_and_infinite_ones_refused(tmp_path):
    one = channels()
    stored = one.stored.astype(float)
    stored[7, 1] = np.nan
    found = c3d_analog.load_analog(written(tmp_path / "a.c3d", replace(one, stored=stored)))
    assert np.argwhere(np.isnan(found.values)).tolist() == [[7, 1]]
    stored[7, 1] = np.inf
    path = written(tmp_path / "b.c3d", replace(one, stored=stored))
    with pytest.raises(LegsimError, match="a sample is infinite"):
        c3d_analog.load_analog(path)


@pytest.mark.parametrize("size", [0, 100, 700, 3000])
def test_a_file_that_breaks_off_is_refused_in_one_line(tmp_path, size: int):
    data = written(tmp_path / "a.c3d", channels()).read_bytes()
    (tmp_path / "b.c3d").write_bytes(data[:size])
    with pytest.raises(LegsimError) as error:
        c3d_analog.load_analog(tmp_path / "b.c3d")
    assert "\n" not in str(error.value)
