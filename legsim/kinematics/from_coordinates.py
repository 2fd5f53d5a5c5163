"""From joint coordinates in a file to a person that moves: completed, checked, and in the model's
signs.
"""

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np

from legsim.core.errors import LegsimError, file_error
from legsim.core.values import FloatArray
from legsim.kinematics.leg_model import COORDINATES, LegModel
from legsim.kinematics.moving_leg import MovingLeg
from legsim.mocap.low_pass import low_pass
from legsim.mocap.trajectories import JointTrajectories

_Result = TypeVar("_Result")

_LARGEST_EXTENSION_DEG = 20.0
"""more than any knee overextends"""


def named(path: Path, compute: Callable[[], _Result]) -> _Result:
    """Puts the file's name before what a stage that knows no files objects to."""
    try:
        return compute()
    except LegsimError as error:
        raise LegsimError(f"{path}: {error}") from error


def moving_leg(
    loaded: JointTrajectories, path: Path, leg: LegModel, *, low_pass_hz: float = 0.0
) -> MovingLeg:
    """The person who moves as the coordinates say.

    Args:
        loaded: coordinates in rad and m, of any order; those of other parts of the body are
            ignored.
        path: the file they come from, for messages.
        leg: the model, scaled to the person.
        low_pass_hz: cut-off of a zero-phase low-pass; 0 leaves the coordinates as they are.

    Raises:
        LegsimError: a coordinate of the leg is missing, or is what no joint can be.
    """
    completed, filled = _with_feet(loaded)
    values, turned = _with_our_knee_sign(
        named(path, lambda: leg.values_of(completed)), loaded.coordinate_names
    )
    _check_angles(path, values, loaded.times)
    if low_pass_hz > 0:
        rate = (len(loaded.times) - 1) / float(loaded.times[-1] - loaded.times[0])
        values = named(path, lambda: low_pass(values, rate, low_pass_hz))
    return MovingLeg(
        path.name,
        leg,
        JointTrajectories(loaded.times, leg.coordinate_names, values),
        None,
        (*filled, *turned, *_gap_note(loaded.times)),
    )


def _with_feet(loaded: JointTrajectories) -> tuple[JointTrajectories, tuple[str, ...]]:
    """Subtalar and toe joints at zero where a model had none, and a note; whatever else is missing
    stays so.
    """
    lacking = [
        name
        for name in COORDINATES
        if name.startswith(("subtalar", "mtp")) and name not in loaded.coordinate_names
    ]
    if not lacking:
        return loaded, ()
    values = np.hstack([loaded.values, np.zeros((len(loaded.times), len(lacking)))])
    completed = JointTrajectories(loaded.times, (*loaded.coordinate_names, *lacking), values)
    return completed, (f"the file has no {', '.join(lacking)}: taken as 0",)


def _check_angles(path: Path, values: FloatArray, times: FloatArray) -> None:
    """Refuses joints turned by more than half a turn: degrees that the header calls radians."""
    joints = [k for k, name in enumerate(COORDINATES) if not name.startswith("pelvis")]
    beyond = np.argwhere(np.abs(values[:, joints]) > np.pi)
    if len(beyond):
        row, column = beyond[0]
        name, angle = COORDINATES[joints[column]], np.degrees(values[row, joints[column]])
        problem = f"{name} is {angle:.0f} degrees at {times[row]:g} s, which no joint can be"
        raise file_error(
            path,
            problem,
            "if its angles are in degrees, write inDegrees=yes into the header",
            place="coordinates",
        )


def _gap_note(times: FloatArray) -> tuple[str, ...]:
    """A word on samples left out, across which the curves are only guessed."""
    steps = np.diff(times)
    if len(steps) == 0 or steps.max() <= 2.5 * np.median(steps):
        return ()
    k = int(steps.argmax())
    return (
        f"{steps[k]:.3g} s are missing after {times[k]:g} s (elsewhere a sample every "
        f"{np.median(steps):.3g} s): bridged by splines",
    )


def _with_our_knee_sign(
    values: FloatArray, file_names: tuple[str, ...]
) -> tuple[FloatArray, tuple[str, ...]]:
    """Knee angles negative in flexion, as in gait2392, and a note where the file had them the other
    way round.

    Rajagopal2016 and its kin count flexion positive: they have a patella coordinate
    (knee_angle_r_beta), or bend where no knee of gait2392 can (its limit is 10 degrees of
    extension).
    """
    knees = [COORDINATES.index(f"knee_angle_{side}") for side in "rl"]
    bends = np.degrees(values[:, knees])
    rajagopal = "knee_angle_r_beta" in file_names or (
        bends.max() > _LARGEST_EXTENSION_DEG and bends.max() > -bends.min()
    )
    if not rajagopal:
        return values, ()
    turned = values.copy()
    turned[:, knees] *= -1
    return turned, (
        "knee angles were positive in flexion (as in Rajagopal2016); their sign was turned to "
        "gait2392's",
    )
