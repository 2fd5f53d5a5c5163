"""Builds everything in motions/ from nothing, bit for bit the same on one machine:  python -m
tools.virtual_subjects [SUBJECT ...]

Seven virtual people hold squats of 30 and 60 degrees and squat actively, twenty seconds each. All
of it is synthetic; how it is made and which published models it rests on is said in
motions/README.md and at the head of each tools/posture_*.py.
"""

import sys
from concurrent.futures import ProcessPoolExecutor

import numpy as np

from tools.virtual_subjects.body import Body
from tools.virtual_subjects.controller import ControllerParams
from tools.virtual_subjects.files import write_trc, write_truth
from tools.virtual_subjects.markers import CameraParams, attach, on_skin, recorded
from tools.virtual_subjects.plan import Plan, hold, squats
from tools.virtual_subjects.report import MOTIONS, write_readme
from tools.virtual_subjects.simulation import footing, simulate
from tools.virtual_subjects.subjects import SUBJECTS, Subject

TRIALS = ("squat_30", "squat_60", "squats")
SEED = 20260


def plan(body: Body, trial: str, rng: np.random.Generator) -> Plan:
    """What the person is asked to do."""
    return (
        squats(body, rng)
        if trial == "squats"
        else hold(body, float(trial.removeprefix("squat_")), rng)
    )


def make(subject: Subject, number: int, trials: tuple[str, ...] = TRIALS) -> None:
    """Simulates and records all trials of one subject; each has its own random stream, so that none
    depends on another.
    """
    folder = MOTIONS / subject.name
    folder.mkdir(parents=True, exist_ok=True)
    body, camera = Body(subject), CameraParams()
    attachment = attach(body, camera, np.random.default_rng([SEED, number]))
    for k, trial in enumerate(trials, start=1):
        muscles, cameras = (
            np.random.default_rng([SEED, number, k, stream, subject.draw]) for stream in range(2)
        )
        performance = simulate(body, plan(body, trial, muscles), ControllerParams(), muscles)
        stood = footing(body, performance)
        stood.check()
        motion = recorded(on_skin(body, performance, attachment, camera), camera, cameras)
        write_trc(folder / f"{trial}.trc", motion)
        write_truth(folder / f"{trial}_truth.npz", body, performance, attachment, stood)
        print(f"{subject.name} {trial}")


def main() -> None:
    """Makes the subjects named on the command line, all without a name."""
    wanted = sys.argv[1:] or [subject.name for subject in SUBJECTS]
    chosen = [
        (number, subject)
        for number, subject in enumerate(SUBJECTS, start=1)
        if subject.name in wanted
    ]
    with ProcessPoolExecutor(max_workers=2) as pool:
        list(pool.map(make, [subject for _, subject in chosen], [number for number, _ in chosen]))
    write_readme(MOTIONS)
