"""The recording of a run: solved by its [motion] settings, identified by its content."""

import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from legsim.config import IkConfig, MotionConfig, TremorConfig, ValueConfig
from legsim.core.constants import STANDARD_GRAVITY
from legsim.core.errors import file_error
from legsim.core.files import sha256
from legsim.kinematics.from_recording import files_read, find_recording, solve_kinematics
from legsim.kinematics.ik_options import (
    CoordinateLock,
    CoordinateTask,
    IkOptions,
    PriorStrengths,
    Unit,
)
from legsim.kinematics.moving_leg import MovingLeg
from legsim.kinematics.tremor import Tremor, trembling
from legsim.kinematics.zero_pose import with_zero

FEWEST_SAMPLES = 6
"""of a motion whose splines have accelerations"""


def solve(motion: MotionConfig, *, filter_coordinates: bool = False) -> MovingLeg:
    """Solves the configured recording and adds the configured tremor.

    Raises:
        LegsimError: as ``solve_kinematics`` and ``trembling``; too few samples for accelerations.
    """
    person = solve_kinematics(
        motion.file,
        marker_map=motion.marker_map,
        unit=None if motion.unit == "file" else motion.unit,
        up=None if motion.up == "file" else motion.up,
        filter_hz=motion.filter_hz,
        longest_gap=motion.longest_gap_s,
        marker_noise=1e-3 * motion.marker_noise_mm,
        scale_from=motion.scaling_file or None,
        model=motion.model or None,
        marker_set=motion.marker_set or None,
        scale_file=motion.scale_file or None,
        scale_model=motion.scale_model,
        filter_coordinates=filter_coordinates,
        in_degrees=None if motion.angles == "file" else motion.angles == "degrees",
        register=motion.registration,
        ik=ik_options(motion.ik),
    )
    count = len(person.trajectories.times)
    if count < FEWEST_SAMPLES:
        raise file_error(
            motion.file,
            f"holds {count} sample{'' if count == 1 else 's'} of joint angles, but accelerations "
            f"need {FEWEST_SAMPLES}",
            "record for longer",
        )
    if motion.zero_file:
        person = _with_zero(person, motion)
    return person if motion.tremor.acceleration_mg == 0 else _trembling(person, motion.tremor)


def _trembling(person: MovingLeg, settings: TremorConfig) -> MovingLeg:
    tremor = Tremor(1e-3 * STANDARD_GRAVITY * settings.acceleration_mg, settings.band_hz)
    rng = np.random.default_rng(settings.seed)
    low, high = tremor.band_hz
    note = f"a tremor of {settings.acceleration_mg:g} mg at {low:g}-{high:g} Hz was added"
    return replace(
        person,
        trajectories=trembling(person.leg, person.trajectories, tremor, rng),
        notes=(*person.notes, note),
    )


def _with_zero(person: MovingLeg, motion: MotionConfig) -> MovingLeg:
    angles = None if motion.angles == "file" else motion.angles == "degrees"
    return with_zero(
        person,
        motion.zero_file,
        marker_map=motion.marker_map,
        unit=None if motion.unit == "file" else motion.unit,
        up=None if motion.up == "file" else motion.up,
        filter_hz=motion.filter_hz,
        longest_gap=motion.longest_gap_s,
        in_degrees=angles,
    )


def ik_options(ik: IkConfig) -> IkOptions:
    """Options of inverse kinematics, in SI.

    Raises:
        LegsimError: a weight below 0.
    """
    return IkOptions(
        marker_weights=ik.marker_weights,
        tasks=tuple(CoordinateTask(n, t.weight, *_in_si(t)) for n, t in ik.tasks.items()),
        locked=tuple(CoordinateLock(n, *_in_si(lock)) for n, lock in ik.locked.items()),
        tasks_file=ik.tasks_file,
        strengths=PriorStrengths(**ik.priors.model_dump()),
    )


def _in_si(value: ValueConfig) -> tuple[float | None, Unit]:
    if value.value_mm is not None:
        return 1e-3 * value.value_mm, "m"
    return (None, "") if value.value_deg is None else (math.radians(value.value_deg), "rad")


def fingerprint(motion: MotionConfig) -> list[str]:
    """Hashes the files that :func:`solve` reads."""
    read = files_read(
        motion.file,
        marker_map=motion.marker_map,
        scale_from=motion.scaling_file or None,
        model=motion.model or None,
        marker_set=motion.marker_set or None,
        scale_file=motion.scale_file or None,
        tasks_file=motion.ik.tasks_file or None,
    )
    read += (find_recording(motion.zero_file),) if motion.zero_file else ()
    return [_hash(path, path.stat().st_mtime_ns, path.stat().st_size) for path in read]


@cache
def _hash(path: Path, _changed_ns: int, _size: int) -> str:
    """Hashes a recording, read once however many stages ask for it."""
    return sha256(path)
