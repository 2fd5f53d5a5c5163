"""What seven markers give back of the project's own recordings: `python -m
tools.experiments.recovery_errors`, for docs/biomechanics.md.

Each recording is recovered as `legsim` does it and compared with the truth beside it; then once
more on the person's true segment sizes with every marker where it was put on. What is left then is
the skin that slides and swings and the cameras' errors: nobody who knows the markers alone can do
much better. With --scaling, held squats scaled from active squats are compared with those scaled
from themselves.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import typer

from legsim.core import resources, transforms
from legsim.core.values import FloatArray
from legsim.kinematics import from_recording, inverse_kinematics, marker_sites
from legsim.kinematics import scaling as kinematics_scaling
from legsim.kinematics.leg import Leg
from legsim.kinematics.leg_model import LegModel
from legsim.kinematics.marker_sites import MarkerSites
from legsim.kinematics.moving_leg import MarkerFit, MovingLeg
from legsim.mocap import marker_sets
from legsim.mocap.trajectories import JointTrajectories, MarkerTrajectories
from tools.virtual_subjects.body import Body
from tools.virtual_subjects.markers import LABELS, MARKERS, CameraParams, attach
from tools.virtual_subjects.plan import STANDING_DEG
from tools.virtual_subjects.statistics import Truth, load_truth
from tools.virtual_subjects.subjects import SUBJECTS

JOINTS = "hip", "knee", "ankle"
HELD, ACTIVE = ("squat_30", "squat_60"), ("squats",)


@dataclass(frozen=True, slots=True)
class Errors:
    """Of one recording against the truth beside it."""

    knees_deg: tuple[float, ...]
    """RMS over the frames of the knee angle, right and left"""
    centers_mm: tuple[float, ...]
    """RMS over frames and sides of the distance of hip, knee and ankle centers"""

    def cells(self) -> str:
        """Two cells of a row."""
        return (
            f"{', '.join(f'{e:.2f}' for e in self.knees_deg)} | "
            f"{', '.join(f'{e:.1f}' for e in self.centers_mm)}"
        )


def recovered(name: str, scaling_file: str = "") -> tuple[MovingLeg, MarkerFit]:
    """A recording under motions/, scaled from ``scaling_file`` or as `legsim` chooses."""
    found = from_recording.solve_kinematics(f"{name}.trc", scale_from=scaling_file)
    assert found.fit is not None
    return found, found.fit


def truth_of(name: str) -> Truth:
    """What really moved."""
    return load_truth(str(resources.motion_file(f"{name}_truth.npz")))


def errors(truth: Truth, leg: Leg, trajectories: JointTrajectories) -> Errors:
    """Of a solved movement."""
    knees = [
        np.degrees(trajectories.coordinate(c) - truth.trajectories.coordinate(c))
        for c in ("knee_angle_r", "knee_angle_l")
    ]
    found = leg.joint_centers(leg.segment_poses(trajectories))
    squares = np.sum((found.positions_world - truth.joint_centers) ** 2, axis=-1)
    pairs = [[found.names.index(f"{joint}_{side}") for side in "lr"] for joint in JOINTS]
    return Errors(
        tuple(float(np.sqrt(np.mean(off**2))) for off in knees),
        tuple(1e3 * float(np.sqrt(squares[:, pair].mean())) for pair in pairs),
    )


def known_person(name: str, truth: Truth, fit: MarkerFit) -> JointTrajectories:
    """The same cleaned markers on the person's own sizes, each where it was put on."""
    with np.load(resources.motion_file(f"{name}_truth.npz")) as stored:
        labels = [str(label) for label in stored["marker_names"]]
        segments, places = [str(s) for s in stored["marker_segments"]], stored["marker_places_m"]
    rows = [labels.index(fit.cleaning.of(role).labels[0]) for role in fit.measured.marker_names]
    weights = [
        fit.scaling.sites.weights[fit.scaling.sites.index(role)]
        for role in fit.measured.marker_names
    ]
    sites = MarkerSites(
        fit.measured.marker_names, tuple(segments[k] for k in rows), places[rows], np.array(weights)
    )
    return inverse_kinematics.solve(truth.leg, fit.measured, sites).trajectories


def placed_again(name: str, draws: int) -> FloatArray:
    """Knee errors (draws, 2) in degrees RMS of a recording whose person comes back ``draws`` times
    and is marked anew by the same hand.

    The errors of placing, of the hip regression and of the skin's slide are drawn as
    tools/virtual_subjects draws them; the movement is the true one at every 24th sample, the
    cameras are perfect, and the model is scaled from the same markers.
    """
    truth = truth_of(name)
    body, camera = (
        Body(next(subject for subject in SUBJECTS if subject.name == name.partition("/")[0])),
        CameraParams(),
    )
    some = JointTrajectories(
        truth.trajectories.times[::24],
        truth.trajectories.coordinate_names,
        truth.trajectories.values[::24],
    )
    poses, standing, known = (
        truth.leg.segment_poses(some),
        body.posture(np.radians(STANDING_DEG)),
        marker_sites.load(),
    )
    roles = marker_sets.guess(LABELS).found_in(LABELS)
    found = []
    for draw in range(draws):
        put_on = attach(body, camera, np.random.default_rng([draw, SUBJECTS.index(body.subject)]))
        paths = {}
        for marker, place, slide in zip(MARKERS, put_on.places, put_on.slides, strict=True):
            moved = np.abs(some.coordinate(marker.flexion) - standing[body.index[marker.flexion]])
            paths[marker.label] = transforms.apply(
                poses.of(marker.body), (place + moved[:, None] * slide)[:, None]
            )[:, 0]
        motion = MarkerTrajectories(
            some.times, tuple(roles), np.stack([paths[labels[0]] for labels in roles.values()], 1)
        )
        fitted = kinematics_scaling.fit(LegModel.load(), motion, known)
        leg = LegModel.load(fitted.scales)
        found.append(
            errors(
                Truth(some, truth.joint_centers[::24], truth.leg),
                leg,
                inverse_kinematics.solve(leg, motion, fitted.sites).trajectories,
            ).knees_deg
        )
    return np.array(found)


def compare_placements(subjects: int, draws: int) -> None:
    """One row per recording: how far the knee angle is off, in degrees, over people marked anew."""
    typer.echo(
        "| recording | RMS of the knee angle's error (deg) | 95 of 100 knees within | worst "
        "|\n|---|---|---|---|"
    )
    for name in (
        f"subject{subject:02d}/{trial}" for subject in range(1, subjects + 1) for trial in HELD
    ):
        knees = placed_again(name, draws)
        typer.echo(
            f"| {name} | {np.sqrt(np.mean(knees**2)):.2f} | {np.quantile(knees, 0.95):.2f} | "
            f"{knees.max():.2f} |"
        )


def compare(subjects: int) -> None:
    """One row per recording, as recovered and with the person known."""
    typer.echo(
        "| recording | knee angle right, left (deg) | hip, knee, ankle (mm) | person known: knee "
        "angle (deg) | hip, knee, ankle (mm) |"
    )
    typer.echo("|---|---|---|---|---|")
    for trial in (*HELD, *ACTIVE):
        rows = []
        for subject in range(1, subjects + 1):
            name = f"subject{subject:02d}/{trial}"
            truth = truth_of(name)
            found, fit = recovered(name)
            rows.append(
                (
                    errors(truth, found.leg, found.trajectories),
                    errors(truth, truth.leg, known_person(name, truth, fit)),
                )
            )
            typer.echo(f"| {name} | {rows[-1][0].cells()} | {rows[-1][1].cells()} |")
        typer.echo(
            f"| RMS of all {trial} | "
            f"{' | '.join(overall([row[k] for row in rows]).cells() for k in range(2))} |"
        )


def overall(rows: list[Errors]) -> Errors:
    """Root mean square over recordings."""
    knees, centers = (
        np.sqrt(np.mean(np.square(values), 0))
        for values in ([r.knees_deg for r in rows], [r.centers_mm for r in rows])
    )
    return Errors(tuple(map(float, knees)), tuple(map(float, centers)))


def compare_scalings(subjects: int) -> None:
    """One row per held squat, scaled from the active squats and from itself."""
    typer.echo(
        "| held squat | scaled from squats.trc: knee angle (deg) | hip, knee, ankle (mm) | from "
        "itself: (deg) | (mm) |"
    )
    typer.echo("|---|---|---|---|---|")
    rows = []
    for name in (
        f"subject{subject:02d}/{trial}" for subject in range(1, subjects + 1) for trial in HELD
    ):
        truth = truth_of(name)
        both = [recovered(name, file)[0] for file in ("", f"{name}.trc")]
        rows.append([errors(truth, found.leg, found.trajectories) for found in both])
        typer.echo(f"| {name} | {' | '.join(row.cells() for row in rows[-1])} |")
    typer.echo(
        "| RMS of all | "
        f"{' | '.join(overall([row[k] for row in rows]).cells() for k in range(2))} |"
    )


def main(
    subjects: Annotated[int, typer.Option(help="How many of the subjects.")] = 7,
    scaling: Annotated[
        bool, typer.Option(help="Compare the two ways to scale held squats.")
    ] = False,
    draws: Annotated[int, typer.Option(help="Mark each person anew this many times instead.")] = 0,
) -> None:
    """RMS errors of knee angles and joint centers."""
    if draws:
        compare_placements(subjects, draws)
    else:
        (compare_scalings if scaling else compare)(subjects)


if __name__ == "__main__":
    typer.run(main)
