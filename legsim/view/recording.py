"""Writing a recording: one stream, two timelines, a name that follows from the content, whole or
not at all.
"""

import dataclasses
import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from legsim.core.files import whole
from legsim.core.values import FloatArray
from legsim.scene.values import ReplayScene, ScanScene
from legsim.view import curves, layout, motion
from legsim.view.scan import log_c_arm, log_slices, log_surface
from legsim.view.stream import Recorder


def write_replay(path: Path, scene: ReplayScene) -> None:
    """Writes the recording of a replay; the same scene gives an equal recording (``rerun rrd
    compare --unordered``).
    """
    with _recorder(
        path, scene.name, scene, scene.trajectories.times, layout.replay(scene)
    ) as recorder:
        _record_replay(recorder, scene)


def write_scan(path: Path, scene: ScanScene) -> None:
    """Writes the recording of a whole scan: the replay, C-arm, projections, skin and slices."""
    with _recorder(
        path, scene.replay.name, scene, scene.replay.trajectories.times, layout.scan(scene)
    ) as recorder:
        _record_replay(recorder, scene.replay)
        log_c_arm(recorder, scene.projections)
        for surface in scene.surfaces:
            log_surface(recorder, surface)
        if scene.planes is not None:
            log_slices(recorder, scene.volumes, scene.planes)


def _record_replay(recorder: Recorder, scene: ReplayScene) -> None:
    motion.log_floor(recorder, scene)
    motion.log_skeleton(recorder, scene)
    motion.log_segments(recorder, scene)
    motion.log_markers(recorder, scene)
    curves.log_coordinates(recorder, scene.trajectories)
    curves.log_residuals(recorder, scene)
    if scene.imu is not None:
        curves.log_imu(recorder, scene.imu)
    if scene.sensor_poses is not None:
        motion.log_sensors(recorder, scene.sensor_poses)


@contextmanager
def _recorder(
    path: Path, name: str, content: Any, clock: FloatArray, blueprint: rrb.Blueprint
) -> Iterator[Recorder]:
    with whole(path) as partial:
        stream = rr.RecordingStream(
            "legsim", recording_id=content_id(content), send_properties=False
        )
        try:
            stream.save(partial, default_blueprint=blueprint)
            stream.send_recording_name(name)
            stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Y_UP, static=True)
            yield Recorder(stream, clock)
        finally:
            stream.disconnect()  # writes all that waits and the footer


def content_id(value: Any) -> str:
    """A hash of a value with all that it holds: equal for equal scenes, whenever and wherever they
    are made.
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
