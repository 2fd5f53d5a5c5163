"""A person that moves: the scaled leg, its joint coordinates, and how well the markers are
followed.
"""

from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np

from legsim.core.values import FloatArray
from legsim.kinematics import pace, plausibility, standing
from legsim.kinematics.ik_options import IkOptions
from legsim.kinematics.inverse_kinematics import IkReport
from legsim.kinematics.joint_splines import JointSplines
from legsim.kinematics.leg import Leg
from legsim.kinematics.marker_sites import MarkerSites
from legsim.kinematics.registration import Registration
from legsim.kinematics.scaling import Scaling
from legsim.kinematics.skeleton import JointCenters
from legsim.mocap.cleaning import CleaningReport
from legsim.mocap.trajectories import JointTrajectories, MarkerTrajectories

_HELD = 1e-9
"""m between numbers that are one and the same"""

_WORTH_TELLING = 0.005
"""share of the samples"""


@dataclass(frozen=True, slots=True, eq=False)
class MarkerFit:
    """What stands behind coordinates that came from markers."""

    measured: MarkerTrajectories
    """cleaned, by role"""
    modelled: MarkerTrajectories
    """where the solved model has them"""
    sites: MarkerSites
    """where they sit on the model's segments"""
    cleaning: CleaningReport
    scaling: Scaling
    options: IkOptions
    """that inverse kinematics ran with"""
    registration: Registration | None
    """None where the leg stayed as scaled"""
    spread: FloatArray
    """(c,) rad and m: standard deviation of each coordinate, by what the markers and the priors
    tell
    """
    ik: IkReport
    scaled_from: str
    """name of the recording that the model's size comes from"""
    settled_hz: float
    """cut-off of the second low-pass, of the joint coordinates; 0 where there was none"""

    def labels(self) -> dict[str, str]:
        """The recording's label by the role that it plays alone."""
        return {r.role: r.labels[0] for r in self.cleaning.roles if len(r.labels) == 1}


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
class ZeroPose:
    """A static trial's mean pose, from which joint angles are counted."""

    file: str
    frames: int
    coordinate_names: tuple[str, ...]
    values: FloatArray
    """(c,) rad and m; 0 for the pelvis' heading and place"""


@dataclass(frozen=True, eq=False)
class MovingLeg:
    """A person's leg model and how it moves."""

    name: str
    leg: Leg
    trajectories: JointTrajectories
    fit: MarkerFit | None
    """None where the file held coordinates"""
    notes: tuple[str, ...] = ()
    """what was put right on the way in"""
    zero: ZeroPose | None = None
    """of :meth:`from_zero`; the movement itself is not changed by it"""
    knees_turned: bool | None = None
    """whether the file counted flexion positive, so that the knees' sign was turned; None where
    nobody judged it
    """

    def from_zero(self) -> JointTrajectories | None:
        """The coordinates counted from the static trial's mean pose; None without one."""
        if self.zero is None:
            return None
        values = self.leg.values_of(self.trajectories) - self.zero.values
        return JointTrajectories(self.trajectories.times, self.leg.coordinate_names, values)

    @cached_property
    def splines(self) -> JointSplines:
        """The joint coordinates at any time; errors as of :class:`JointSplines`."""
        return JointSplines(self.trajectories)

    def __repr__(self) -> str:
        times = self.trajectories.times
        fit = "" if self.fit is None else f", markers within {1e3 * self.fit.ik.rms:.1f} mm RMS"
        return (
            f"MovingLeg({self.name}: {len(times)} samples over {times[-1] - times[0]:.4g} s{fit})"
        )

    @cached_property
    def _posture(self) -> tuple[FloatArray, JointCenters]:
        """The pelvis' poses (n, 4, 4) in world, and the joint centers."""
        poses = self.leg.segment_poses(self.trajectories)
        return poses.of("pelvis").copy(), self.leg.joint_centers(poses)

    @cached_property
    def implausible(self) -> tuple[str, ...]:
        """Sentences on what no person's leg does, with names and times; such a leg is not to be
        scanned.
        """
        times = self.trajectories.times
        fit = () if self.fit is None else plausibility.poor_fit(self.fit.ik, times)
        return (
            *plausibility.objections(self.leg, self.trajectories),
            *plausibility.beyond_limits(
                self.leg, self.trajectories, by_markers=self.fit is not None
            ),
            *pace.falling(self._posture[1]),
            *fit,
        )

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """What a reader should know before using the movement: all that is implausible, and what is
        doubtful.
        """
        pelvis, centers = self._posture
        # coordinates without the pelvis' height have one and the same number for it
        lifted = self.fit is not None or np.ptp(pelvis[:, 1, 3]) > _HELD
        doubts = [
            *standing.leaning(pelvis[:, :3, :3], centers),
            *(standing.off_the_floor(centers) if lifted else ()),
            *standing.small(self.leg),
            *pace.odd_steps(centers),
        ]
        if self.fit is not None:
            doubts += plausibility.untold(self.leg.coordinate_names, self.fit.spread)
        if self.fit is not None and len(self.fit.ik.frames_jumping):
            jumps = self.fit.ik.frames_jumping
            first = int(jumps[0])
            doubts.append(
                f"the solution jumps to another one after {len(jumps)} frames, "
                f"the first is frame {first} ({self.trajectories.times[first]:.3f} s)"
            )
        return (*self.implausible, *doubts)

    def ranges(self) -> tuple[CoordinateRange, ...]:
        """Mean, spread and extremes of every coordinate."""
        rows, times = [], self.trajectories.times
        for name in self.trajectories.coordinate_names:
            unit, factor = ("mm", 1e3) if name in self.leg.shifts else ("deg", np.degrees(1.0))
            values = factor * self.trajectories.coordinate(name)
            rates = np.abs(np.diff(values) / np.diff(times)) if len(values) > 1 else np.zeros(1)
            extremes = (
                float(values.min()),
                float(values.max()),
                float(rates.max()),
                int(rates.argmax()),
            )
            rows.append(
                CoordinateRange(name, unit, float(values.mean()), float(values.std()), *extremes)
            )
        return tuple(rows)

    def _least_known(self) -> str:
        """The three least certain joint angles of hips and knees."""
        known = zip(self.ranges(), self.standard_deviations(), strict=True)
        angles = [(sd, row.name) for row, sd in known if row.name.startswith(("hip", "knee"))]
        return ", ".join(f"{name} {sd:.1f} deg" for sd, name in sorted(angles, reverse=True)[:3])

    def standard_deviations(self) -> tuple[float, ...]:
        """Of each coordinate, in its unit of :meth:`ranges`; none where the file held
        coordinates.
        """
        if self.fit is None:
            return ()
        factors = [1e3 if row.unit == "mm" else np.degrees(1.0) for row in self.ranges()]
        return tuple(float(f * s) for f, s in zip(factors, self.fit.spread, strict=True))

    def summary(self) -> dict[str, Any]:
        """Numbers about the fit, for kinematics.json."""
        summary = self._summary()
        if self.zero is not None:
            factors = [1e3 if row.unit == "mm" else np.degrees(1.0) for row in self.ranges()]
            summary["zero"] = {"file": self.zero.file, "frames": self.zero.frames}
            for row, value, factor in zip(
                summary["coordinates"], self.zero.values, factors, strict=True
            ):
                row["zero"] = float(factor * value)
        return summary

    def _summary(self) -> dict[str, Any]:
        if self.fit is None:
            ranges = [asdict(row) for row in self.ranges()]
            return {
                "source": "coordinates",
                "file": self.name,
                "notes": list(self.notes),
                "warnings": list(self.warnings),
                "coordinates": ranges,
            }
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
            "warnings": list(self.warnings),
            "registration": _registration_summary(self.fit),
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
                    "frames_decided_by_prior": int(ik.coordinate_by_prior[k]),
                    "standard_deviation": self.standard_deviations()[k],
                }
                for k, row in enumerate(self.ranges())
            ],
            "lengths_mm": {m.name: 1e3 * m.measured for m in self.fit.scaling.measurements},
        }

    def lines(self) -> list[str]:
        """A short account for the terminal."""
        if self.fit is None:
            count = len(self.trajectories.times)
            return [
                f"{self.name}: {count} samples of {len(self.trajectories.coordinate_names)} "
                "coordinates",
                *self.notes,
                *(f"warning: {line}" for line in self.warnings),
            ]
        ik, cleaning = self.fit.ik, self.fit.cleaning
        filled, jumps = (
            sum(r.filled for r in cleaning.roles),
            sum(r.jumps_removed for r in cleaning.roles),
        )
        loose = [
            n
            for k, n in enumerate(ik.coordinate_names)
            if ik.coordinate_share[k] < 0.5 and ik.coordinate_by_prior[k] == 0
        ]
        lines = [
            f"{self.name}: {len(self.trajectories.times)} frames at {cleaning.rate_hz:g} Hz, "
            f"marker set {cleaning.marker_set}",
            *self.notes,
            f"cleaned: {jumps} samples removed as jumps, {filled} bridged, low-pass "
            f"{cleaning.filter_hz:g} Hz"
            + (
                f"; joint angles {self.fit.settled_hz:g} Hz, which moves no marker farther than "
                "its noise"
                if self.fit.settled_hz
                else ""
            ),
            f"model follows the markers within {1e3 * ik.rms:.1f} mm RMS (worst "
            f"{1e3 * np.nanmax(ik.marker_worst):.1f} mm)",
        ]
        unseen = {
            r.role: r.left_missing / r.samples
            for r in cleaning.roles
            if r.left_missing > _WORTH_TELLING * r.samples
        }
        if unseen:
            shares = ", ".join(f"{role} {100 * share:.0f} %" for role, share in unseen.items())
            lines.append(
                "not seen for longer than can be bridged, so that joint angles are guessed "
                f"there: {shares} of the time"
            )
        lines += _feet_by_prior(ik)
        if loose:
            lines.append(
                "decided by the stated priors, tasks or locks rather than the markers: "
                f"{', '.join(loose)}"
            )
        if self.fit.registration is not None:
            found = self.fit.registration
            lines.append(
                f"lengths and places of markers found from {found.frames} "
                f"posture{'s' * (found.frames > 1)}, by an error of {1e3 * found.error:.2g} mm per "
                "marker and axis"
            )
        lines.append(f"least known, by one standard deviation: {self._least_known()}")
        lines += [f"warning: {line}" for line in self.warnings]
        if len(ik.frames_unconverged):
            lines.append(
                f"{len(ik.frames_unconverged)} frames did not converge, the first is frame "
                f"{ik.frames_unconverged[0]}"
            )
        return lines


def _feet_by_prior(ik: IkReport) -> list[str]:
    """A line on the joints of the feet that priors decide, with the share of the frames."""
    by_share: dict[int, list[str]] = {}
    for name, count in zip(ik.coordinate_names, ik.coordinate_by_prior, strict=True):
        if count:
            by_share.setdefault(int(count), []).append(name)
    shares = [
        f"{', '.join(names)} in {100 * count / ik.frames:.3g} % of the frames"
        for count, names in sorted(by_share.items(), reverse=True)
    ]
    if not shares:
        return []
    why = "fewer than three markers of that foot are seen, or for mtp none on the toes"
    return [f"decided by the prior, because {why}: {'; '.join(shares)}"]


def _registration_summary(fit: MarkerFit) -> dict[str, Any] | None:
    """What registration changed, in mm and degrees."""
    found = fit.registration
    if found is None:
        return None
    values = {prior.coordinate: prior.value for prior in found.config.priors or ()}
    return {
        "frames": found.frames,
        "marker_rms_before_mm": 1e3 * found.rms_before,
        "marker_rms_mm": 1e3 * found.rms_after,
        "marker_error_mm": 1e3 * found.error,
        "lengths_mm": {
            f"{name}_{side}": 1e3 * length(side)
            for name, length in (
                ("thigh", found.leg.thigh_length),
                ("shank", found.leg.shank_length),
            )
            for side in "rl"
        },
        "habitual_hip_rotation_deg": {
            side: float(np.degrees(values[f"hip_rotation_{side}"]))
            for side in "rl"
            if f"hip_rotation_{side}" in values
        },
        "marker_places_mm": {
            name: [1e3 * float(x) for x in place]
            for name, place in zip(found.sites.names, found.sites.positions, strict=True)
        },
    }
