"""From a motion file to a person that moves: cleaned markers, a scaled leg, joint coordinates, and a report on each."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from legsim import artifacts, marker_noise, marker_sets, marker_sites, markers, motion_files, replay, resources, scaling
from legsim.arrays import FloatArray
from legsim.config import MotionConfig
from legsim.errors import LegsimError, at
from legsim.leg import COORDINATES, Leg
from legsim.marker_maps import PAPER_ROLES
from legsim.markers import CleaningReport
from legsim.replay import IkReport
from legsim.scaling import Scaling
from legsim.signals import JointTrajectories, Motion

_Result = TypeVar("_Result")
_LARGEST_EXTENSION_DEG = 20.0
_POOR_RMS, _POOR_WORST = 0.03, 0.1
"""m: skin and placement of markers explain less than this"""
_WORTH_TELLING = 0.005
"""share of the samples"""
"""more than any knee overextends"""


@dataclass(frozen=True, slots=True, eq=False)
class MarkerFit:
    """What stands behind coordinates that came from markers."""

    measured: Motion
    """cleaned, by role"""
    modelled: Motion
    """where the solved model has them"""
    cleaning: CleaningReport
    scaling: Scaling
    ik: IkReport
    scaled_from: str
    """name of the recording that the model's size comes from"""
    settled_hz: float
    """cut-off of the second low-pass, of the joint coordinates; 0 where there was none"""


@dataclass(frozen=True, slots=True)
class CoordinateRange:
    """How far one coordinate goes."""

    name: str
    unit: str
    """deg or mm"""
    mean: float
    rms: float
    """around the mean"""
    lowest: float
    highest: float
    highest_rate: float
    """per s, between two samples"""
    highest_rate_frame: int


@dataclass(frozen=True, slots=True, eq=False)
class Recovery:
    """A person's leg model and how it moves."""

    name: str
    leg: Leg
    trajectories: JointTrajectories
    fit: MarkerFit | None
    """None where the file held coordinates"""
    notes: tuple[str, ...] = ()
    """what was put right on the way in"""

    def ranges(self) -> tuple[CoordinateRange, ...]:
        """Mean, spread and extremes of every coordinate."""
        rows, times = [], self.trajectories.times
        for name in self.trajectories.coordinate_names:
            unit, factor = ("mm", 1e3) if name in ("pelvis_tx", "pelvis_ty", "pelvis_tz") else ("deg", np.degrees(1.0))
            values = factor * self.trajectories.coordinate(name)
            rates = np.abs(np.diff(values) / np.diff(times)) if len(values) > 1 else np.zeros(1)
            extremes = float(values.min()), float(values.max()), float(rates.max()), int(rates.argmax())
            rows.append(CoordinateRange(name, unit, float(values.mean()), float(values.std()), *extremes))
        return tuple(rows)

    def summary(self) -> dict[str, Any]:
        """Numbers about the fit, for kinematics.json."""
        if self.fit is None:
            ranges = [asdict(row) for row in self.ranges()]
            return {"source": "coordinates", "file": self.name, "notes": list(self.notes), "coordinates": ranges}
        ik, cleaning = self.fit.ik, self.fit.cleaning
        return {
            "source": "markers",
            "file": self.name,
            "marker_set": cleaning.marker_set,
            "notes": list(self.notes),
            "scaled_from": self.fit.scaled_from,
            "filter_hz": cleaning.filter_hz,
            "coordinate_filter_hz": self.fit.settled_hz,
            "marker_rms_mm": 1e3 * ik.rms,
            "frames_unconverged": len(ik.frames_unconverged),
            "markers": [
                {
                    "role": name,
                    "rms_mm": 1e3 * float(ik.marker_rms[k]),
                    "worst_mm": 1e3 * float(ik.marker_worst[k]),
                    "worst_frame": int(ik.marker_worst_frame[k]),
                    "worst_s": float(self.trajectories.times[ik.marker_worst_frame[k]]),
                    "labels": list(cleaning.of(name).labels),
                    "seen": int(ik.marker_seen[k]),
                    "missing": cleaning.of(name).missing,
                    "longest_gap_s": cleaning.of(name).longest_gap_s,
                    "jumps_removed": cleaning.of(name).jumps_removed,
                    "filled": cleaning.of(name).filled,
                    "rebuilt": cleaning.of(name).rebuilt,
                    "left_missing": cleaning.of(name).left_missing,
                }
                for k, name in enumerate(ik.marker_names)
            ],
            "coordinates": [
                {
                    **asdict(row),
                    "decided_by_markers": float(ik.coordinate_share[k]),
                    "frames_at_limit": int(ik.coordinate_at_limit[k]),
                }
                for k, row in enumerate(self.ranges())
            ],
            "lengths_mm": {m.name: 1e3 * m.measured for m in self.fit.scaling.measurements},
        }

    def lines(self) -> list[str]:
        """A short account for the terminal."""
        if self.fit is None:
            count = len(self.trajectories.times)
            return [f"{self.name}: {count} samples of {len(self.trajectories.coordinate_names)} coordinates", *self.notes]
        ik, cleaning = self.fit.ik, self.fit.cleaning
        filled, jumps = sum(r.filled for r in cleaning.roles), sum(r.jumps_removed for r in cleaning.roles)
        loose = [n for n, share in zip(ik.coordinate_names, ik.coordinate_share, strict=True) if share < 0.5]
        lines = [
            f"{self.name}: {len(self.trajectories.times)} frames at {cleaning.rate_hz:g} Hz, marker set {cleaning.marker_set}",
            *self.notes,
            f"cleaned: {jumps} samples removed as jumps, {filled} bridged, low-pass {cleaning.filter_hz:g} Hz"
            + (f"; joint angles {self.fit.settled_hz:g} Hz, which moves no marker farther than its noise" if self.fit.settled_hz else ""),
            f"model follows the markers within {1e3 * ik.rms:.1f} mm RMS (worst {1e3 * np.nanmax(ik.marker_worst):.1f} mm)",
        ]
        worst = int(np.nanargmax(ik.marker_worst))
        if ik.rms > _POOR_RMS or ik.marker_worst[worst] > _POOR_WORST:
            when = self.trajectories.times[ik.marker_worst_frame[worst]]
            lines.append(
                f"warning: that is no good fit; worst is {ik.marker_names[worst]} at {when:.2f} s: see whether labels are "
                "exchanged there, or a marker stands still"
            )
        unseen = {r.role: r.left_missing / r.samples for r in cleaning.roles if r.left_missing > _WORTH_TELLING * r.samples}
        if unseen:
            shares = ", ".join(f"{role} {100 * share:.0f} %" for role, share in unseen.items())
            lines.append(f"not seen for longer than can be bridged, so that joint angles are guessed there: {shares} of the time")
        if loose:
            lines.append(f"decided by the stated priors rather than the markers: {', '.join(loose)}")
        if len(ik.frames_unconverged):
            lines.append(f"{len(ik.frames_unconverged)} frames did not converge, the first is frame {ik.frames_unconverged[0]}")
        return lines


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
        raise at(file, "no such motion file, here or among the shipped ones", "give a .trc, .c3d, .mot or .sto file") from None


def fingerprint(config: MotionConfig) -> list[str]:
    """Hashes of the files that a recovery reads."""
    files = [source(config.file), _scaling_source(config)]
    if config.marker_map.endswith(".toml") and Path(config.marker_map).is_file():
        files.append(Path(config.marker_map))
    return [artifacts.sha256(path) for path in files]


def recover(config: MotionConfig, *, filter_coordinates: bool = False) -> Recovery:
    """Reads, cleans, scales and solves. Coordinates (.mot, .sto) are taken as they are, unless ``filter_coordinates``.

    Raises:
        LegsimError: anything that a careful person would object to, with file, place and cure.
    """
    path = source(config.file)
    if motion_files.kind(path) in ("storage", "csv") and isinstance(motion_files.load(path), JointTrajectories):
        return _from_coordinates(config, path, filter_coordinates)
    # a trial that is scaled from another may go without the landmarks that only scaling needs
    measured, cleaning, notes = _cleaned(config, path, required=() if config.scaling_file else PAPER_ROLES)
    scaled_from = _scaling_source(config)
    reference = measured if scaled_from == path else _cleaned(config, scaled_from)[0]
    sites = marker_sites.load()
    fitted = _named(path, lambda: scaling.fit(Leg.load(), reference, sites))
    leg = Leg.load(fitted.scales)
    placed = fitted.sites
    loose = marker_sites.calibrated_roles() & set(measured.marker_names)
    if loose:
        placed = replay.calibrate(leg, reference, placed, loose)
    solution = _named(path, lambda: replay.solve(leg, measured, placed))
    names = solution.modelled.marker_names
    shown = Motion(measured.times, names, np.stack([measured.marker(n) for n in names], 1))
    settled, settled_hz = marker_noise.settle(
        leg, solution.trajectories, placed.only(names), noise=1e-3 * config.marker_noise_mm, filter_hz=config.filter_hz
    )
    fit = MarkerFit(shown, solution.modelled, cleaning, fitted, solution.report, scaled_from.name, settled_hz)
    return Recovery(path.name, leg, settled, fit, notes)


def _scaling_source(config: MotionConfig) -> Path:
    """The recording that the model is scaled from: the one that is named; for legsim's own held squats the person's active squats, as in
    the study that is rebuilt here; the recording itself otherwise."""
    path = source(config.file)
    if config.scaling_file:
        return source(config.scaling_file)
    squats = path.with_name("squats.trc")
    own = path.name.startswith("squat_") and path.resolve().is_relative_to(resources.motion_file("README.md").resolve().parent)
    return squats if own and squats.is_file() else path


def _cleaned(config: MotionConfig, path: Path, required: Sequence[str] = PAPER_ROLES) -> tuple[Motion, CleaningReport, tuple[str, ...]]:
    """The markers by role, what was done to them, and what the reader has to say about the file."""
    raw, notes = _read(path, unit=None if config.unit == "file" else config.unit, up=None if config.up == "file" else config.up)

    def cleaned() -> tuple[Motion, CleaningReport]:
        automatic = config.marker_map == "auto"
        chosen = marker_sets.guess(raw.marker_names, required=required) if automatic else marker_sets.load(config.marker_map)
        return markers.prepare(raw, chosen, filter_hz=config.filter_hz, longest_gap_s=config.longest_gap_s, required=required)

    return *_named(path, cleaned), notes


def _read(path: Path, *, unit: str | None, up: str | None) -> tuple[Motion, tuple[str, ...]]:
    """The markers, and a word on unit and vertical as they were read and on what the reader put right."""
    if motion_files.kind(path) == "csv":
        return motion_files.load_markers(path), ()
    raw = motion_files.read_markers(path)
    return raw.to_motion(unit=unit, up=up), (f"lengths in {raw.resolved_unit(unit)}, {raw.resolved_up(up, unit=unit)} up", *raw.notes)


def _named(path: Path, compute: Callable[[], _Result]) -> _Result:
    """Puts the file's name before what a stage that knows no files objects to."""
    try:
        return compute()
    except LegsimError as error:
        raise LegsimError(f"{path}: {error}") from error


def _from_coordinates(config: MotionConfig, path: Path, filtered: bool) -> Recovery:
    loaded = motion_files.load(path)
    if not isinstance(loaded, JointTrajectories):
        raise at(path, "holds no joint coordinates", "give a .mot or .sto file of coordinates")
    leg = Leg.load()
    if config.scaling_file:
        reference, _, _ = _cleaned(config, source(config.scaling_file))
        leg = Leg.load(scaling.fit(leg, reference, marker_sites.load()).scales)
    completed, filled = _with_feet(loaded)
    values, turned = _with_our_knee_sign(_named(path, lambda: leg.values_of(completed)), loaded.coordinate_names)
    _check_angles(path, values, loaded.times)
    if filtered and config.filter_hz > 0:
        values = _named(path, lambda: marker_noise.low_pass(values, loaded.times, config.filter_hz))
    return Recovery(
        path.name, leg, JointTrajectories(loaded.times, leg.coordinate_names, values), None, (*filled, *turned, *_gap_note(loaded.times))
    )


def _with_feet(loaded: JointTrajectories) -> tuple[JointTrajectories, tuple[str, ...]]:
    """Subtalar and toe joints at zero where a model had none, and a note; whatever else is missing stays so."""
    lacking = [name for name in COORDINATES if name.startswith(("subtalar", "mtp")) and name not in loaded.coordinate_names]
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
        raise at(path, problem, "if its angles are in degrees, write inDegrees=yes into the header", place="coordinates")


def _gap_note(times: FloatArray) -> tuple[str, ...]:
    """A word on samples left out, across which the curves are only guessed."""
    steps = np.diff(times)
    if len(steps) == 0 or steps.max() <= 2.5 * np.median(steps):
        return ()
    k = int(steps.argmax())
    return (f"{steps[k]:.3g} s are missing after {times[k]:g} s (elsewhere a sample every {np.median(steps):.3g} s): bridged by splines",)


def _with_our_knee_sign(values: FloatArray, file_names: tuple[str, ...]) -> tuple[FloatArray, tuple[str, ...]]:
    """Knee angles negative in flexion, as in gait2392, and a note where the file had them the other way round.

    Rajagopal2016 and its kin count flexion positive: they have a patella coordinate (knee_angle_r_beta), or bend where no knee
    of gait2392 can (its limit is 10 degrees of extension).
    """
    knees = [COORDINATES.index(f"knee_angle_{side}") for side in "rl"]
    bends = np.degrees(values[:, knees])
    rajagopal = "knee_angle_r_beta" in file_names or (bends.max() > _LARGEST_EXTENSION_DEG and bends.max() > -bends.min())
    if not rajagopal:
        return values, ()
    turned = values.copy()
    turned[:, knees] *= -1
    return turned, ("knee angles were positive in flexion (as in Rajagopal2016); their sign was turned to gait2392's",)
