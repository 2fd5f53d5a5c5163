"""Writes a recording: one stream, two timelines, a name from a hash of the content.

It is written as a whole or not at all.
"""

import dataclasses
import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import rerun_bindings as bindings

from legsim.core.files import write_bytes
from legsim.scene.values import MeasuredScene, ReplayScene, ScanScene
from legsim.view import curves, layout, motion
from legsim.view.scan import log_c_arm, log_slices, log_surface
from legsim.view.stream import Recorder

AnyScene = ReplayScene | ScanScene | MeasuredScene


def write_replay(path: Path, scene: ReplayScene) -> None:
    """Writes the recording of a replay.

    The same scene gives an equal recording (``rerun rrd compare --unordered``).
    """
    _write(path, scene)


def write_scan(path: Path, scene: ScanScene) -> None:
    """Writes the recording of a whole scan: the replay, C-arm, projections, skin and slices."""
    _write(path, scene)


def write_measured(path: Path, scene: MeasuredScene) -> None:
    """Writes the recording of a measured scan: C-arm, projections, sensors, slices."""
    _write(path, scene)


def new_stream(scene: AnyScene) -> rr.RecordingStream:
    """Creates a stream named by the content of a scene, still empty and without a sink."""
    return rr.RecordingStream("legsim", recording_id=content_id(scene), send_properties=False)


def blueprint(scene: AnyScene) -> rrb.Blueprint:
    """Layout with which the viewer opens."""
    if isinstance(scene, MeasuredScene):
        return layout.measured(scene)
    return layout.scan(scene) if isinstance(scene, ScanScene) else layout.replay(scene)


def record(stream: rr.RecordingStream, scene: AnyScene) -> None:
    """Logs the contents of a scene."""
    if isinstance(scene, MeasuredScene):
        _record_measured(stream, scene)
        return
    replay = scene.replay if isinstance(scene, ScanScene) else scene
    stream.send_recording_name(replay.name)
    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Y_UP, static=True)
    recorder = Recorder(stream, replay.trajectories.times)
    _record_replay(recorder, replay)
    if isinstance(scene, ScanScene):
        log_c_arm(recorder, scene.projections)
        for surface in scene.surfaces:
            log_surface(recorder, surface)
        log_slices(recorder, scene.slices)


def _record_measured(stream: rr.RecordingStream, scene: MeasuredScene) -> None:
    stream.send_recording_name("measured scan")
    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Y_UP, static=True)
    recorder = Recorder(stream, scene.projections.geometry.times)
    log_c_arm(recorder, scene.projections)
    log_slices(recorder, scene.slices)
    curves.log_imu(recorder, scene.imu)
    if scene.sensor_poses is not None:
        motion.log_sensors(recorder, scene.sensor_poses)


def _record_replay(recorder: Recorder, scene: ReplayScene) -> None:
    motion.log_floor(recorder, scene)
    motion.log_skeleton(recorder, scene)
    motion.log_segments(recorder, scene)
    motion.log_markers(recorder, scene)
    curves.log_coordinates(recorder, scene)
    curves.log_residuals(recorder, scene)
    if scene.imu is not None:
        curves.log_imu(recorder, scene.imu)
    if scene.sensor_poses is not None:
        motion.log_sensors(recorder, scene.sensor_poses)


def _write(path: Path, scene: AnyScene) -> None:
    content = _encoded(scene)
    # the stream's threads stay until rerun looks for streams that nobody holds
    bindings.flush_and_cleanup_orphaned_recordings()
    write_bytes(path, content)


def _encoded(scene: AnyScene) -> bytes:
    """Content of the recording's file.

    It is collected in memory: where rerun itself writes a file and its disk is full, it leaves half
    of it without an error, and the process never ends.
    """
    stream = new_stream(scene)
    try:
        collected = stream.memory_recording()
        stream.send_blueprint(blueprint(scene), make_active=False, make_default=True)
        record(stream, scene)
        return collected.drain_as_bytes()
    finally:
        stream.disconnect()  # else the collected memory holds the stream


def content_id(value: Any) -> str:
    """Hashes a value with all that it holds.

    Equal scenes give equal hashes, whenever and wherever they are made.
    """
    digest = hashlib.blake2b(digest_size=16)
    for leaf in _leaves(value):
        digest.update(leaf)
    return digest.hexdigest()


def _leaves(value: Any) -> Iterator[bytes]:
    if isinstance(value, np.ndarray):
        yield f"{value.dtype}{value.shape}".encode()
        yield np.ascontiguousarray(value).tobytes()
    elif dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            yield from _leaves(getattr(value, field.name))
    elif isinstance(value, tuple):
        yield f"tuple{len(value)}".encode()
        for part in value:
            yield from _leaves(part)
    else:
        yield repr(value).encode()
