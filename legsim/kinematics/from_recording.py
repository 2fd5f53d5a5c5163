"""From a motion file to a person that moves: cleaned markers, a scaled leg, joint coordinates, and
a report on each.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np

from legsim.config import MotionConfig
from legsim.core import files as core_files
from legsim.core import resources
from legsim.core.errors import LegsimError, file_error
from legsim.core.values import FloatArray
from legsim.kinematics import inverse_kinematics, marker_sites, scaling, smoothing
from legsim.kinematics.leg_model import COORDINATES, LegModel
from legsim.kinematics.moving_leg import MarkerFit, MovingLeg
from legsim.mocap import cleaning as mocap_cleaning
from legsim.mocap import files as mocap_files
from legsim.mocap import marker_sets
from legsim.mocap.cleaning import CleaningReport
from legsim.mocap.files import load_markers, read_markers
from legsim.mocap.labels import PAPER_ROLES
from legsim.mocap.trajectories import JointTrajectories, MarkerTrajectories

_Result = TypeVar("_Result")

_LARGEST_EXTENSION_DEG = 20.0


def source(file: str) -> Path:
    """The path of a motion file: as given, or one that ships with legsim under motions/.

    Raises:
        LegsimError: it is neither.
    """
    if Path(file).is_file():
        return Path(file)
    try:
        return resources.motion_file(file)
    except LegsimError:
        raise file_error(
            file,
            "no such motion file, here or among the shipped ones",
            "give a .trc, .c3d, .mot or .sto file",
        ) from None


def fingerprint(config: MotionConfig) -> list[str]:
    """Hashes of the files that a recovery reads."""
    files = [source(config.file), _scaling_source(config)]
    if config.marker_map.endswith(".toml") and Path(config.marker_map).is_file():
        files.append(Path(config.marker_map))
    return [core_files.sha256(path) for path in files]


def solve_recording(config: MotionConfig, *, filter_coordinates: bool = False) -> MovingLeg:
    """Reads, cleans, scales and solves. Coordinates (.mot, .sto) are taken as they are, unless
    ``filter_coordinates``.

    Raises:
        LegsimError: anything that a careful person would object to, with file, place and cure.
    """
    path = source(config.file)
    if mocap_files.kind(path) in ("storage", "csv") and isinstance(
        mocap_files.load_recording(path), JointTrajectories
    ):
        return _from_coordinates(config, path, filter_coordinates)
    # a trial that is scaled from another may go without the landmarks that only scaling needs
    measured, cleaning, notes = _cleaned(
        config, path, required=() if config.scaling_file else PAPER_ROLES
    )
    scaled_from = _scaling_source(config)
    reference = measured if scaled_from == path else _cleaned(config, scaled_from)[0]
    sites = marker_sites.load()
    fitted = _named(path, lambda: scaling.fit(LegModel.load(), reference, sites))
    leg = LegModel.load(fitted.scales)
    placed = fitted.sites
    loose = marker_sites.calibrated_roles() & set(measured.marker_names)
    if loose:
        placed = inverse_kinematics.calibrate(leg, reference, placed, loose)
    solution = _named(path, lambda: inverse_kinematics.solve(leg, measured, placed))
    names = solution.modelled.marker_names
    shown = MarkerTrajectories(
        measured.times, names, np.stack([measured.marker(n) for n in names], 1)
    )
    settled, settled_hz = smoothing.smooth_below_noise(
        leg,
        solution.trajectories,
        placed.only(names),
        noise=1e-3 * config.marker_noise_mm,
        filter_hz=config.filter_hz,
    )
    fit = MarkerFit(
        shown, solution.modelled, cleaning, fitted, solution.report, scaled_from.name, settled_hz
    )
    return MovingLeg(path.name, leg, settled, fit, notes)


def _scaling_source(config: MotionConfig) -> Path:
    """The recording that the model is scaled from: the one that is named; for legsim's own held
    squats the person's active squats, as in the study that is rebuilt here; the recording itself
    otherwise."""
    path = source(config.file)
    if config.scaling_file:
        return source(config.scaling_file)
    squats = path.with_name("squats.trc")
    own = path.name.startswith("squat_") and path.resolve().is_relative_to(
        resources.motion_file("README.md").resolve().parent
    )
    return squats if own and squats.is_file() else path


def _cleaned(
    config: MotionConfig, path: Path, required: Sequence[str] = PAPER_ROLES
) -> tuple[MarkerTrajectories, CleaningReport, tuple[str, ...]]:
    """The markers by role, what was done to them, and what the reader has to say about the file."""
    raw, notes = _read(
        path,
        unit=None if config.unit == "file" else config.unit,
        up=None if config.up == "file" else config.up,
    )

    def cleaned() -> tuple[MarkerTrajectories, CleaningReport]:
        automatic = config.marker_map == "auto"
        chosen = (
            marker_sets.guess(raw.marker_names, required=required)
            if automatic
            else marker_sets.load(config.marker_map)
        )
        return mocap_cleaning.clean(
            raw,
            chosen,
            filter_hz=config.filter_hz,
            longest_gap_s=config.longest_gap_s,
            required=required,
        )

    return *_named(path, cleaned), notes


def _read(
    path: Path, *, unit: str | None, up: str | None
) -> tuple[MarkerTrajectories, tuple[str, ...]]:
    """The markers, and a word on unit and vertical as they were read and on what the reader put
    right.
    """
    if mocap_files.kind(path) == "csv":
        return load_markers(path), ()
    raw = read_markers(path)
    return raw.to_motion(unit=unit, up=up), (
        f"lengths in {raw.resolved_unit(unit)}, {raw.resolved_up(up, unit=unit)} up",
        *raw.notes,
    )


def _named(path: Path, compute: Callable[[], _Result]) -> _Result:
    """Puts the file's name before what a stage that knows no files objects to."""
    try:
        return compute()
    except LegsimError as error:
        raise LegsimError(f"{path}: {error}") from error


def _from_coordinates(config: MotionConfig, path: Path, filtered: bool) -> MovingLeg:
    loaded = mocap_files.load_recording(path)
    if not isinstance(loaded, JointTrajectories):
        raise file_error(
            path, "holds no joint coordinates", "give a .mot or .sto file of coordinates"
        )
    leg = LegModel.load()
    if config.scaling_file:
        reference, _, _ = _cleaned(config, source(config.scaling_file))
        leg = LegModel.load(scaling.fit(leg, reference, marker_sites.load()).scales)
    completed, filled = _with_feet(loaded)
    values, turned = _with_our_knee_sign(
        _named(path, lambda: leg.values_of(completed)), loaded.coordinate_names
    )
    _check_angles(path, values, loaded.times)
    if filtered and config.filter_hz > 0:
        values = _named(path, lambda: smoothing.low_pass(values, loaded.times, config.filter_hz))
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
