"""The clock of a recording: frames by the nearest time, and a scan that waits at its first view."""

import numpy as np
import rerun as rr

from legsim.view.stream import Recorder, entity_path
from tests.examples.recordings import read

CLOCK = np.arange(5) / 10


def test_samples_between_two_frames_take_the_nearer_ones_number(tmp_path):
    stream = rr.RecordingStream("test", recording_id="test")
    stream.save(tmp_path / "s.rrd")
    times = np.array([0.04, 0.06, 0.29, 5.0])
    Recorder(stream, CLOCK).columns("/a", times, rr.Scalars.columns(scalars=np.arange(4.0)))
    stream.flush()
    stream.disconnect()
    frames, values = read(tmp_path / "s.rrd", "/a", "Scalars:scalars", timeline="frame")
    np.testing.assert_array_equal(frames, [0, 1, 3, 4])
    np.testing.assert_array_equal(np.ravel(values), np.arange(4))


def test_what_begins_later_than_the_clock_waits_at_its_first_row():
    recorder = Recorder(rr.RecordingStream("test"), CLOCK)
    times, rows = recorder.from_start(np.array([0.2, 0.3]))
    np.testing.assert_array_equal(times, [0.0, 0.2, 0.3])
    np.testing.assert_array_equal(rows, [0, 0, 1])
    times, rows = recorder.from_start(CLOCK)
    np.testing.assert_array_equal(rows, np.arange(5))


def test_a_name_is_one_part_of_a_path_whatever_it_holds(tmp_path):
    stream = rr.RecordingStream("test", recording_id="test")
    stream.save(tmp_path / "s.rrd")
    names = ["a/b", "a", "x [y] $z", "ä:é"]
    for k, name in enumerate(names):
        entity = entity_path("imu", name, "force")
        column = rr.Scalars.columns(scalars=np.full(2, float(k)))
        Recorder(stream, CLOCK).columns(entity, CLOCK[:2], column)
    stream.flush()
    stream.disconnect()
    for k, name in enumerate(names):
        path = f"/{entity_path('imu', name, 'force')}"
        _, values = read(tmp_path / "s.rrd", path, "Scalars:scalars")
        np.testing.assert_array_equal(np.ravel(values), [k, k])
    assert entity_path("world", "sensors", "shank_l") == "world/sensors/shank_l"
