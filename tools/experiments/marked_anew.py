"""Whether registration brings joint centers nearer than scaling alone does, over people who are
marked anew: `python -m tools.experiments.marked_anew --draws 6`, for docs/biomechanics.md.

The seven people under motions/ are one draw of markers and of hips against the regression. Here
the same movements are seen through new draws of the same sizes; cameras are perfect and skin does
not swing. Held squats are scaled or registered from the same draw's active squats.
"""

from typing import Annotated

import numpy as np
import typer

from legsim.core import transforms
from legsim.kinematics import inverse_kinematics, marker_sites, registration
from legsim.kinematics import scaling as kinematics_scaling
from legsim.kinematics.leg_model import LegModel
from legsim.mocap import marker_sets
from legsim.mocap.trajectories import JointTrajectories, MarkerTrajectories
from tools.experiments.recovery_errors import Errors, errors, overall, truth_of
from tools.virtual_subjects.body import Body
from tools.virtual_subjects.markers import LABELS, MARKERS, Attachment, CameraParams, attach
from tools.virtual_subjects.plan import STANDING_DEG
from tools.virtual_subjects.statistics import Truth
from tools.virtual_subjects.subjects import SUBJECTS

TRIALS = "squats", "squat_30", "squat_60"
_EVERY = 24
"""samples of a recording from one that is used to the next"""


def thinned(name: str) -> Truth:
    """What moved, at 5 Hz."""
    truth = truth_of(name)
    whole = truth.trajectories
    some = JointTrajectories(whole.times[::_EVERY], whole.coordinate_names, whole.values[::_EVERY])
    return Truth(some, truth.joint_centers[::_EVERY], truth.leg)


def marked(truth: Truth, body: Body, put_on: Attachment) -> MarkerTrajectories:
    """The seven markers, put on and sliding as drawn, by role."""
    some, standing = truth.trajectories, body.posture(np.radians(STANDING_DEG))
    poses, paths = truth.leg.segment_poses(some), {}
    for marker, place, slide in zip(MARKERS, put_on.places, put_on.slides, strict=True):
        moved = np.abs(some.coordinate(marker.flexion) - standing[body.index[marker.flexion]])
        local = (place + moved[:, None] * slide)[:, None]
        paths[marker.label] = transforms.apply(poses.of(marker.body), local)[:, 0]
    roles = marker_sets.guess(LABELS).found_in(LABELS)
    where = np.stack([paths[labels[0]] for labels in roles.values()], 1)
    return MarkerTrajectories(some.times, tuple(roles), where)


def both_ways(number: int, draw: int) -> dict[str, tuple[Errors, Errors]]:
    """Errors of each trial of a person, scaled only and registered."""
    subject = SUBJECTS[number]
    body = Body(subject)
    put_on = attach(body, CameraParams(), np.random.default_rng([draw, number]))
    truths = {trial: thinned(f"{subject.name}/{trial}") for trial in TRIALS}
    seen = {trial: marked(truth, body, put_on) for trial, truth in truths.items()}
    fitted = kinematics_scaling.fit(LegModel.load(), seen["squats"], marker_sites.load())
    leg = LegModel.load(fitted.scales)
    found = registration.register(leg, seen["squats"], fitted.sites)
    rows = {}
    for trial, truth in truths.items():
        pegs = found.pegs if trial == "squats" else None
        scaled = inverse_kinematics.solve(leg, seen[trial], fitted.sites)
        registered = inverse_kinematics.solve(
            found.leg, seen[trial], found.sites, found.config, pegs=pegs
        )
        rows[trial] = (
            errors(truth, leg, scaled.trajectories),
            errors(truth, found.leg, registered.trajectories),
        )
    return rows


def main(
    draws: Annotated[int, typer.Option(help="How often each person is marked anew.")] = 6,
) -> None:
    """Root mean squares over people and draws."""
    typer.echo(
        "| recording | scaled only: knee right, left (deg) | hip, knee, ankle (mm) | registered: "
        "(deg) | (mm) |\n|---|---|---|---|---|"
    )
    people = [both_ways(k, 1001 + draw) for draw in range(draws) for k in range(len(SUBJECTS))]
    for trial in TRIALS:
        cells = [overall([person[trial][way] for person in people]).cells() for way in (0, 1)]
        typer.echo(f"| {trial} | {' | '.join(cells)} |")


if __name__ == "__main__":
    typer.run(main)
