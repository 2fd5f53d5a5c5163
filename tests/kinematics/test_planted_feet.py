"""Feet that stand still decide how far a straight leg is turned; feet that do not, decide nothing."""

from collections.abc import Callable

import numpy as np
import pytest

from legsim.core.values import FloatArray
from legsim.kinematics import inverse_kinematics, marker_sites, registration, scaling
from legsim.kinematics._ik_newton import minimize
from legsim.kinematics._ik_problem import Problem
from legsim.kinematics.ik_options import IkOptions
from legsim.kinematics.inverse_kinematics import Solution
from legsim.kinematics.leg_model import COORDINATES, LegModel
from legsim.kinematics.marker_sites import MarkerSites
from legsim.kinematics.registration import Registration
from legsim.mocap.labels import PAPER_ROLES
from legsim.mocap.trajectories import MarkerTrajectories

LEG = LegModel.load()
SITES = marker_sites.load().only(PAPER_ROLES)
RATE = 25.0
ROTATIONS = [COORDINATES.index(f"hip_rotation_{side}") for side in "rl"]


def bends(seconds: float = 12.0) -> FloatArray:
    """(n,) rad of knee flexion, three squats between upright stances."""
    phase = np.clip(1.6 * np.sin(np.linspace(0, 6 * np.pi, round(seconds * RATE))), 0, 1)
    return np.radians(5 + 80 * phase)


def squats(headings_deg: FloatArray, flexion: FloatArray) -> FloatArray:
    """Coordinates (n, 20) of squats on flat feet with headings (n, 2), outwards positive, of right
    and left: the pose whose ankles and feet are there, with the pelvis tilted as people do.
    """
    n = len(flexion)
    foot = MarkerSites(
        tuple(f"{way}_{side}" for side in "rl" for way in ("at", "ahead", "above")),
        tuple(f"calcn_{side}" for side in "rl" for _ in range(3)),
        np.tile([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)], (2, 1)),
        np.ones(6),
    )
    pelvis = MarkerSites(
        ("center", "front", "top", "side"),
        ("pelvis",) * 4,
        np.concatenate([np.zeros((1, 3)), np.eye(3)]),
        np.ones(4),
    )
    sites = MarkerSites(
        foot.names + pelvis.names,
        foot.segments + pelvis.segments,
        np.concatenate([foot.positions, pelvis.positions]),
        np.ones(10),
    )
    targets = np.empty((n, 10, 3))
    for k, sign in enumerate((1.0, -1.0)):
        turn = np.radians(headings_deg[:, k])
        ahead = np.stack([np.cos(turn), 0 * turn, sign * np.sin(turn)], -1)
        place = np.tile([0.0, 0.03, sign * 0.12], (n, 1))
        targets[:, 3 * k] = place
        targets[:, 3 * k + 1], targets[:, 3 * k + 2] = (
            place + ahead,
            place + np.array([0.0, 1.0, 0.0]),
        )
    tilt = 0.3 * flexion
    center = np.stack([0.05 - 0.15 * flexion, 0.98 - 0.41 * (1 - np.cos(flexion)), 0 * tilt], -1)
    axes = np.stack(
        [
            np.stack([np.cos(tilt), -np.sin(tilt), 0 * tilt], -1),
            np.stack([np.sin(tilt), np.cos(tilt), 0 * tilt], -1),
            np.tile([0.0, 0.0, 1.0], (n, 1)),
        ],
        1,
    )
    targets[:, 6], targets[:, 7:] = center, center[:, None] + axes
    starts = np.array([LEG.posture(float(b), -float(b), 0.3 * float(b)) for b in flexion])
    starts[:, :6] = LEG.pelvis_values(_poses(axes, center))
    # feet are where they are to a tenth of a millimeter, pelvis gives way
    weights = np.tile([1.0] * 6 + [1e-4] * 4, (n, 1))
    free = IkOptions(priors=(), flat_foot_weight=0.0)
    return minimize(Problem(LEG, sites, free), starts, targets, weights)[0].values


def _poses(axes: FloatArray, center: FloatArray) -> FloatArray:
    poses = np.tile(np.eye(4), (len(center), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = np.swapaxes(axes, 1, 2), center
    return poses


def shown(values: FloatArray) -> MarkerTrajectories:
    """The seven markers, as people have them on a leg of gait2392."""
    return MarkerTrajectories(
        np.arange(len(values)) / RATE, SITES.names, LEG.marker_positions(values, SITES)
    )


def recovered(motion: MarkerTrajectories, *, pegged: bool) -> tuple[Registration, Solution]:
    """Registered from itself and solved, with the pegs that were found or without."""
    scaled = scaling.fit(LEG, motion, SITES)
    find = registration._planted_feet.find
    with pytest.MonkeyPatch.context() as patch:
        if not pegged:
            patch.setattr(registration._planted_feet, "find", lambda *_: None)
        assert (registration._planted_feet.find is find) == pegged
        found = registration.register(LegModel.load(scaled.scales), motion, scaled.sites)
    return found, inverse_kinematics.solve(
        found.leg, motion, found.sites, found.config, pegs=found.pegs
    )


def errors_deg(solution: Solution, true: FloatArray, columns: list[int]) -> FloatArray:
    """(n, 2)"""
    return np.degrees(solution.trajectories.values - true)[:, columns]


def constant(right: float, left: float, n: int) -> FloatArray:
    return np.tile([right, left], (n, 1))


def noisy(motion: MarkerTrajectories, rng: np.random.Generator) -> MarkerTrajectories:
    """With a millimeter between postures that is no noise: skin, alike for a second."""
    n = len(motion.times)
    slow = rng.normal(size=(n // 25 + 2, *motion.positions_world.shape[1:]))
    at = np.arange(n) / 25
    low = at.astype(int)
    part = (at - low)[:, None, None]
    skin = (1 - part) * slow[low] + part * slow[low + 1]
    return MarkerTrajectories(
        motion.times, motion.marker_names, motion.positions_world + 1e-3 * skin
    )


def test_a_planted_turned_out_foot_tells_the_hips_rotation_while_the_knee_is_straight(
    rng: np.random.Generator,
):
    flexion = bends()
    true = squats(constant(22.0, 15.0, len(flexion)), flexion)
    motion = noisy(shown(true), rng)
    straight = flexion < np.radians(8)
    # the thighs turn as the knees bend
    assert (np.degrees(np.ptp(true[:, ROTATIONS], axis=0)) > 5).all()
    worst = {}
    for pegged in (False, True):
        found, solution = recovered(motion, pegged=pegged)
        assert (found.pegs is not None) == pegged
        off = errors_deg(solution, true, ROTATIONS)[straight]
        worst[pegged] = float(np.sqrt((off**2).mean(0)).max())
    assert worst[True] < 0.6 * worst[False]
    assert worst[True] < 5


def test_the_habitual_rotation_gives_way_where_the_foot_tells_it():
    """Exact markers, whose hips turn by 10 degrees over feet that stand: one habitual rotation
    for straight and bent knees would pull the straight ones off by half of that.
    """
    flexion = bends()
    true = squats(constant(22.0, 15.0, len(flexion)), flexion)
    _, solution = recovered(shown(true), pegged=True)
    off = errors_deg(solution, true, ROTATIONS)[flexion < np.radians(8)]
    assert np.sqrt((off**2).mean(0)).max() < 2.6


def pivoting(n: int) -> FloatArray:
    """Toes that turn out by 30 degrees after half of the time, and in again."""
    return constant(5.0, 5.0, n) + 30 * np.sin(np.linspace(0, 40 * np.pi, n))[:, None] ** 2


def lying(values: FloatArray) -> FloatArray:
    turned = values.copy()
    turned[:, COORDINATES.index("pelvis_tilt")] += np.pi / 2
    return turned


def walking(values: FloatArray) -> FloatArray:
    moved = values.copy()
    moved[:, COORDINATES.index("pelvis_tx")] += 1.2 * np.arange(len(values)) / RATE
    return moved


@pytest.mark.parametrize("moved", [lying, walking])
def test_people_who_do_not_stand_have_no_pegs(moved: Callable[[FloatArray], FloatArray]):
    flexion = bends()
    values = moved(squats(constant(10.0, 10.0, len(flexion)), flexion))
    assert find(shown(values), values) is None


def find(motion: MarkerTrajectories, values: FloatArray, sites: MarkerSites = SITES):
    chosen = np.arange(0, len(values), 5)
    return registration._planted_feet.find(LEG, sites, motion, chosen, values[chosen])


def test_a_foot_that_pivots_is_not_held():
    flexion = bends()
    headings = constant(10.0, 10.0, len(flexion))
    headings[:, 0] = pivoting(len(flexion))[:, 0]
    values = squats(headings, flexion)
    pegs = find(shown(values), values)
    assert pegs is not None
    assert set(pegs.sites.segments) == {"calcn_l"}


def test_straight_knees_have_no_pegs():
    values = squats(constant(10.0, 10.0, 200), np.radians(np.full(200, 5.0)))
    assert find(shown(values), values) is None


def test_a_foot_with_a_marker_of_its_own_has_no_pegs():
    flexion = bends()
    values = squats(constant(10.0, 10.0, len(flexion)), flexion)
    sites = marker_sites.load().only([*PAPER_ROLES, "heel_r"])
    where = LEG.marker_positions(values, sites)
    motion = MarkerTrajectories(np.arange(len(values)) / RATE, sites.names, where)
    pegs = find(motion, values, sites)
    assert pegs is not None
    assert set(pegs.sites.segments) == {"calcn_l"}


def test_pegs_come_and_go_without_a_step():
    """Somebody squats, and walks off."""
    flexion = bends()
    values = squats(constant(22.0, 15.0, len(flexion)), flexion)
    later = 2.0 * np.maximum(np.arange(len(flexion)) / RATE - 10.0, 0.0)
    values[:, COORDINATES.index("pelvis_tx")] += later
    found, solution = recovered(shown(values), pegged=True)
    assert found.pegs is not None
    ends = (found.pegs.shares == 0).any(1)
    assert ends[-1]
    assert not ends[:200].any()
    steps = np.degrees(np.abs(np.diff(solution.trajectories.values[:, ROTATIONS], axis=0)))
    largest = np.degrees(np.abs(np.diff(values[:, ROTATIONS], axis=0)))
    assert steps.max() < largest.max() + 2.0


def test_markers_decide_where_pegs_are_not_given():
    """What one solves without a stay is what one solved before there were pegs."""
    values = squats(constant(10.0, 10.0, 100), bends(4.0))
    motion = shown(walking(values))
    found, solution = recovered(motion, pegged=True)
    assert found.pegs is None
    _, plain = recovered(motion, pegged=False)
    np.testing.assert_array_equal(solution.trajectories.values, plain.trajectories.values)
