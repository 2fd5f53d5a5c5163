"""Inverse kinematics side by side with OpenSim: same scaled model, same markers, one run."""

import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from legsim.kinematics import inverse_kinematics, marker_sites, scaling
from legsim.kinematics.ik_options import CoordinatePrior, IkOptions
from legsim.kinematics.leg_model import COORDINATES, LegModel
from legsim.kinematics.marker_sites import MarkerSites
from legsim.mocap import cleaning, files, marker_sets
from legsim.mocap.labels import PAPER_ROLES
from legsim.mocap.trajectories import MarkerTrajectories


@dataclass(frozen=True, slots=True)
class Trial:
    """A recording to solve, and the one that scales the model."""

    name: str
    file: str
    scaling_file: str
    marker_set: str
    only: tuple[str, ...] = ()
    """roles to keep; empty: all"""


TRIALS = (
    Trial(
        "squats, full set", "squats_subject4/squats1.trc", "squats_subject4/static1.trc", "opencap"
    ),
    Trial(
        "squats, seven markers",
        "squats_subject4/squats1.trc",
        "squats_subject4/squats1.trc",
        "opencap",
        PAPER_ROLES,
    ),
    Trial(
        "walking, full set",
        "walk_opensim/subject01_walk1.trc",
        "walk_opensim/subject01_static.trc",
        "gait2392",
    ),
)
OPENSIM_FRAMES = 80
"""OpenSim solves so many in a row from a third of the trial on, legsim all; the comparison is over
the former
"""
SAME_TASKS = IkOptions(
    priors=tuple(
        CoordinatePrior(f"{name}_{side}", 1000.0)
        for name in ("subtalar_angle", "mtp_angle")
        for side in "rl"
    ),
    flat_foot_weight=0.0,
)
"""the tasks of gait2392's own set-up, no other prior"""


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """One trial made ready: the same for both solvers."""

    leg: LegModel
    sites: MarkerSites
    motion: MarkerTrajectories


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """legsim and OpenSim on one problem."""

    name: str
    frames: int
    markers: int
    rms_difference_deg: np.ndarray
    """(20,) legsim - OpenSim over the frames; mm for the three translations"""
    worst_difference_deg: np.ndarray
    """(20,)"""
    marker_rms_mm: tuple[float, float]
    cost: tuple[float, float]
    """m^2, weighted sum of squares, mean over the frames"""
    frames_per_second: tuple[float, float]
    """of processor time, so that other work on the machine does not count; legsim's includes
    starting from scratch
    """
    opensim_loose_per_second: float
    """at the accuracy of OpenSim's example set-up, 1e-5"""

    @property
    def ratio(self) -> float:
        """legsim's speed over OpenSim's faster one."""
        return self.frames_per_second[0] / max(
            self.frames_per_second[1], self.opensim_loose_per_second
        )


def prepare(folder: Path, trial: Trial) -> Problem:
    """Scales the leg and cleans the markers."""
    marker_map = marker_sets.load(trial.marker_set)
    generic, sites = LegModel.load(), marker_sites.load()
    static, _ = cleaning.clean(files.load_markers(folder / trial.scaling_file), marker_map)
    scaled = scaling.fit(generic, static, sites)
    leg = LegModel.load(scaled.scales)
    calibrated = inverse_kinematics.calibrate(
        leg, static, scaled.sites, marker_sites.calibrated_roles()
    )
    motion, _ = cleaning.clean(files.load_markers(folder / trial.file), marker_map, required=())
    names = [
        n
        for n in motion.marker_names
        if n in calibrated.names and (not trial.only or n in trial.only)
    ]
    # both solvers see the same: no sample may be missing
    names = [n for n in names if np.isfinite(motion.marker(n)).all()]
    rows = [motion.marker_names.index(n) for n in names]
    return Problem(
        leg,
        calibrated.only(names),
        MarkerTrajectories(motion.times, tuple(names), motion.positions_world[:, rows]),
    )


def compare(name: str, problem: Problem, model_file: Path) -> Comparison:
    """Solves with both; OpenSim twice, converged (1e-10) and as its example does (1e-5)."""
    from tools.benchmarks.peers import opensim_kinematics as opensim_peer

    begin = time.process_time()
    ours = inverse_kinematics.solve(problem.leg, problem.motion, problem.sites, SAME_TASKS)
    seconds = time.process_time() - begin
    scales, motion = problem.leg.scales, problem.motion
    begin_frame = len(motion.times) // 3
    some = slice(begin_frame, begin_frame + OPENSIM_FRAMES)
    motion = MarkerTrajectories(
        motion.times[some], motion.marker_names, motion.positions_world[some]
    )
    n = len(motion.times)
    theirs = opensim_peer.inverse_kinematics(
        opensim_peer.load(model_file, scales), problem.sites, motion, accuracy=1e-10
    )
    loose = opensim_peer.inverse_kinematics(
        opensim_peer.load(model_file, scales), problem.sites, motion, accuracy=1e-5
    )
    unit = np.where(
        [name in ("pelvis_tx", "pelvis_ty", "pelvis_tz") for name in COORDINATES],
        1000.0,
        180 / np.pi,
    )
    difference = (ours.trajectories.values[some] - theirs.values) * unit
    squares = [
        ((p - motion.positions_world) ** 2).sum(-1)
        for p in (ours.modelled.positions_world[some], theirs.markers)
    ]
    return Comparison(
        name=name,
        frames=len(problem.motion.times),
        markers=len(problem.sites.names),
        rms_difference_deg=np.sqrt((difference**2).mean(0)),
        worst_difference_deg=np.abs(difference).max(0),
        marker_rms_mm=(
            1e3 * float(np.sqrt(squares[0].mean())),
            1e3 * float(np.sqrt(squares[1].mean())),
        ),
        cost=(
            float((squares[0] @ problem.sites.weights).mean()),
            float((squares[1] @ problem.sites.weights).mean()),
        ),
        frames_per_second=(len(problem.motion.times) / seconds, n / theirs.seconds),
        opensim_loose_per_second=n / loose.seconds,
    )


def table(comparisons: list[Comparison]) -> str:
    """Markdown: speeds and residuals, then coordinates x (legsim - OpenSim)."""
    lines = [
        "| trial | frames | markers | marker RMS legsim / OpenSim (mm) | legsim frames/s | "
        "OpenSim 1e-10 | OpenSim 1e-5 | ratio |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for c in comparisons:
        fps = (
            f"{c.frames_per_second[0]:.0f} | {c.frames_per_second[1]:.0f} | "
            f"{c.opensim_loose_per_second:.0f}"
        )
        rms = f"{c.marker_rms_mm[0]:.3f} / {c.marker_rms_mm[1]:.3f}"
        lines.append(f"| {c.name} | {c.frames} | {c.markers} | {rms} | {fps} | {c.ratio:.0f} |")
    lines += [
        "",
        "| coordinate | " + " | ".join(c.name for c in comparisons) + " |",
        "|---|" + "---|" * len(comparisons),
    ]
    for k, coordinate in enumerate(COORDINATES):
        unit = "mm" if coordinate in ("pelvis_tx", "pelvis_ty", "pelvis_tz") else "deg"
        cells = (
            f"{c.rms_difference_deg[k]:.4f} (worst {c.worst_difference_deg[k]:.4f})"
            for c in comparisons
        )
        lines.append(f"| {coordinate} ({unit}) | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def run(data: Path) -> str:
    """Compares on all trials below ``data`` (folders mocap and opensim) and returns the tables."""
    model_file = data / "opensim/gait2392_thelen2003muscle.osim"
    found = []
    for trial in TRIALS:
        found.append(compare(trial.name, prepare(data / "mocap", trial), model_file))
        print(f"{trial.name}: done", file=sys.stderr)
    return table(found)


def replace_section(page: Path, text: str) -> None:
    """Puts the tables between the two marks of a page."""
    mark = "<!-- ik -->"
    before, _, after = page.read_text("utf-8").split(mark)
    page.write_text(f"{before}{mark}\n{text}\n{mark}{after}", "utf-8")
