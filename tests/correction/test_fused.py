"""Corrections by a consumer sensor whose drift is found: they help, or say that they cannot."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline
from scipy.stats import chi2

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.correction import path_problem
from legsim.correction.bead_scan import BeadScan
from legsim.correction.control_points import AttachedPoint
from legsim.correction.error_state import error_state
from legsim.correction.fiducials import Fiducials
from legsim.correction.fused import (
    FusedBeads,
    FusedFiducials,
    SensorPriors,
    Standing,
)
from legsim.correction.method import Correction, Scan
from legsim.correction.path_measurements import BeadShadows, FiducialShadows
from legsim.correction.rough_start import EXACT, StartErrors, rough
from legsim.correction.smoother import smooth
from legsim.deformation.models import RigidMotion
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.imu.catalogue import load_sensor
from legsim.imu.errors import SensorErrors
from legsim.imu.readout import read_out
from legsim.imu.signals import ImuSignals, SensorStart
from tests.correction.test_tied_sensors import Mounted
from tests.references.sway import Sway

VIEWS = np.arange(62) / 15.5
SAMPLES = np.arange(-60, 540) / 120
SWAY = Sway.standing(4, position_mm=1.5, angle_deg=0.3)
STILL = Sway.standing(4, position_mm=0.0, angle_deg=0.0)
KNEE = SWAY.center + np.array([0.0, 0.14, 0.0])
BONE = KNEE + 1e-3 * np.array([[0.0, 0, 0], [30, -60, 0], [-30, -60, 10], [0, -30, -30]])
PLACES = KNEE + 1e-3 * np.array([[45.0, -35.0, 20.0], [-50.0, -60.0, 10.0]])
GEOMETRY = ConeBeamGeometry.circular(
    times=VIEWS,
    angles=np.radians(3.2) * np.arange(len(VIEWS)),
    source_isocenter=0.78,
    source_detector=1.198,
    shape_vu=(24, 31),
    pixel_pitch=1.232e-3,
    isocenter=KNEE,
)
BMI160 = load_sensor("bmi160").errors
ANKLE = KNEE - np.array([0.0, 0.4, 0.0])
ON_FOOT = Mounted(
    replace(Sway.standing(4, position_mm=0.05, angle_deg=0.2), center=ANKLE), height=0.26
)
"""a shank that sways over a foot that stands"""


class Moving(Protocol):
    """A sensor on something that moves."""

    def poses(self, times: np.ndarray, /) -> np.ndarray: ...
    def velocities(self, times: np.ndarray, /) -> np.ndarray: ...
    def signals(self, times: np.ndarray, /) -> tuple[np.ndarray, np.ndarray]: ...


def motion_of(sway: Moving) -> RigidMotion:
    return RigidMotion.from_poses(VIEWS, sway.poses(VIEWS))


def scanned(sway: Moving, seed: int, errors: SensorErrors = BMI160) -> Scan:
    """One sensor with errors and a rough start; the images are empty and small."""
    rng = np.random.default_rng(seed)
    rate, force = sway.signals(SAMPLES)
    exact = ImuSignals(SAMPLES, ("shank_l",), rate[:, None], force[:, None])
    start = SensorStart(sway.poses(VIEWS[:1])[0], sway.velocities(VIEWS[:1])[0])
    empty = Projections(GEOMETRY, np.zeros((len(VIEWS), 24, 31), np.float32))
    # a filter that needs finer samples delays by what the clock takes up
    read = read_out(exact, errors.without("low-pass"), rng)
    return Scan(empty, read, rough([start], StartErrors(), rng))


def shadows(sway: Moving, seed: int) -> BeadShadows:
    exact = GEOMETRY.project(motion_of(sway).carry(PLACES))[0]
    return BeadShadows(exact + 0.2 * np.random.default_rng(seed).standard_normal(exact.shape))


def in_sensor(sway: Sway, seed: int) -> FiducialShadows:
    """Four points 30 mm apart, on a detector without bounds."""
    places = Fiducials(0.03).points_sensor
    exact = GEOMETRY.project(transforms.apply(sway.poses(VIEWS), places))[0]
    noise = np.random.default_rng(seed).standard_normal(exact.shape)
    return FiducialShadows(exact + 0.2 * noise, places)


def motion_found(found: Correction) -> RigidMotion:
    assert isinstance(found.motion, RigidMotion)
    return found.motion


def left_px(motion: RigidMotion, sway: Moving) -> float:
    """RMS distance of the bone's projections from where it is, which a volume is blurred by.

    A constant similarity of the scene blurs nothing and is taken out, to first order.
    """
    off = GEOMETRY.project(motion.carry(BONE))[0] - GEOMETRY.project(motion_of(sway).carry(BONE))[0]
    arms, slopes = BONE - BONE.mean(0), []
    shifts = [np.broadcast_to(axis, arms.shape) for axis in np.eye(3)]
    for change in (*shifts, *(np.cross(axis, arms) for axis in np.eye(3)), arms):
        ends = [GEOMETRY.project(motion.carry(BONE + 1e-4 * k * change))[0] for k in (1, -1)]
        slopes.append((ends[0] - ends[1]).reshape(-1))
    design, seen = np.stack(slopes, -1), off.reshape(-1)
    left = seen - design @ np.linalg.lstsq(design, seen, rcond=None)[0]
    return float(np.sqrt(2 * np.mean(left**2)))


def wobble_mm(motion: RigidMotion) -> float:
    """RMS displacement of the bone about its mean over the views."""
    carried = motion.carry(BONE)
    return 1e3 * float(np.sqrt(((carried - carried.mean(0)) ** 2).sum(-1).mean()))


@pytest.mark.parametrize("seed", range(2))
def test_a_consumer_sensor_and_two_beads_undo_a_sway(seed: int):
    found = FusedBeads(shadows(SWAY, seed), "shank_l", SensorPriors(BMI160))(scanned(SWAY, seed))
    before = left_px(RigidMotion.identity(VIEWS), SWAY)
    assert left_px(motion_found(found), SWAY) < 0.15 * before
    assert found.method == "fused-beads"
    assert "100 % of their shadows" in found.notes[0]


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("off_mm", [0.0, 10.0])
def test_a_foot_that_stands_helps_where_the_ankle_is_known_in_the_sensor(off_mm: float, seed: int):
    """Also where it is known to a centimeter only; an ankle in another sensor says nothing."""
    scan, method = scanned(ON_FOOT, seed), FusedBeads(shadows(ON_FOOT, seed), "shank_l")
    ankle = AttachedPoint("shank_l", ON_FOOT.place(0.0) + 1e-3 * off_mm * np.array([1, -1, 1]))
    elsewhere = replace(ankle, sensor="thigh_l")
    found = [
        method(replace(scan, joints=joints))
        for joints in ((), ((elsewhere,) * 3,), ((ankle,) * 3,))
    ]
    free, other, held = map(motion_found, found)
    said = [[n for n in one.notes if "foot is taken to stand" in n] for one in found]
    assert [len(notes) for notes in said] == [0, 0, 1]
    moved = re.search(r"wanders by 0\.2 mm per root of a second, (\S+) mm RMS", said[2][0])
    assert moved is not None
    assert float(moved[1]) < 0.3
    assert left_px(held, ON_FOOT) < 0.85 * left_px(free, ON_FOOT)
    np.testing.assert_array_equal(other.moved_from_reference, free.moved_from_reference)


def with_ankle(scan: Scan, shank: Mounted = ON_FOOT) -> Scan:
    return replace(scan, ankles=(AttachedPoint("shank_l", shank.place(0.0)),))


@pytest.mark.parametrize("seed", range(3))
def test_a_consumer_sensor_over_a_foot_that_stands_undoes_a_sway_that_nothing_shows(seed: int):
    """By its gyroscope alone, which the accelerometer keeps upright; without a foot, by nothing."""
    scan, method = scanned(ON_FOOT, seed), Standing("shank_l", SensorPriors(BMI160))
    free, held = method(scan), method(with_ankle(scan))
    assert "the scan is left as it is" in free.notes[-1]
    assert left_px(motion_found(held), ON_FOOT) < 0.5 * left_px(motion_found(free), ON_FOOT)
    assert any("foot is taken to stand" in note for note in held.notes)


def test_an_ankle_where_no_shank_has_it_holds_nothing():
    """Above the sensor, or in meters where millimeters were meant."""
    scan, method = scanned(ON_FOOT, 0), Standing("shank_l", SensorPriors(BMI160))
    for place in (-ON_FOOT.place(0.0), 1e-3 * ON_FOOT.place(0.0), 10 * ON_FOOT.place(0.0)):
        found = method(replace(scan, ankles=(AttachedPoint("shank_l", place),)))
        assert found.notes[0].startswith("In doubt: the ankle in sensor shank_l is ")
        assert "the scan is left as it is" in found.notes[-1]
    right = method(replace(scan, ankles=(AttachedPoint("shank_l", ON_FOOT.place(0.0)),)))
    assert "foot is taken to stand" in right.notes[0]


@dataclass(frozen=True)
class Shifted:
    """A shank whose foot leaves its place in the middle of the scan: by value and derivatives of
    the time, along an axis.
    """

    shank: Mounted
    by: Callable[[np.ndarray], Sequence[np.ndarray]]
    axis: np.ndarray

    def _along(self, times: np.ndarray, derivative: int) -> np.ndarray:
        return self.by(np.asarray(times))[derivative][:, None] * self.axis

    def poses(self, times: np.ndarray) -> np.ndarray:
        return transforms.translation(self._along(times, 0)) @ self.shank.poses(times)

    def velocities(self, times: np.ndarray) -> np.ndarray:
        return self.shank.velocities(times) + self._along(times, 1)

    def signals(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rate, force = self.shank.signals(times)
        own = self.shank.poses(times)[:, :3, :3]
        return rate, force + np.einsum("nji,nj->ni", own, self._along(times, 2))


def lifts(times: np.ndarray) -> Sequence[np.ndarray]:
    """A heel, for half a second."""
    u = (times - 2) / 0.3
    bell = np.exp(-(u**2))
    return bell, -2 * u / 0.3 * bell, (4 * u**2 - 2) / 0.3**2 * bell


def steps(times: np.ndarray) -> Sequence[np.ndarray]:
    u = (times - 2) / 0.15
    there, fast = np.tanh(u), 1 / np.cosh(u) ** 2
    return (1 + there) / 2, fast / 0.3, -there * fast / 0.15**2


@pytest.mark.parametrize(
    ("by", "shift"), [(lifts, [0, 0.015, 0]), (lifts, [0, 0.03, 0]), (steps, [0, 0, 0.03])]
)
def test_a_foot_that_does_not_stand_is_not_held(by, shift: list[float]):
    moving = Shifted(ON_FOOT, by, np.array(shift))
    scan, method = scanned(moving, 0), FusedBeads(shadows(moving, 0), "shank_l")
    free, held = method(scan), method(with_ankle(scan))
    assert any("foot does not stand still" in note for note in held.notes)
    of_free, of_held = (left_px(motion_found(one), moving) for one in (free, held))
    assert of_held < 1.05 * of_free


@pytest.mark.parametrize(("by", "shift"), [(lifts, [0, 0.015, 0]), (steps, [0, 0, 0.02])])
def test_a_foot_that_does_not_stand_is_not_held_where_nothing_is_seen_either(
    by, shift: list[float]
):
    """The accelerometer tells of quick steps: some of them is undone, and the note says so."""
    moving = Shifted(ON_FOOT, by, np.array(shift))
    found = Standing("shank_l", SensorPriors(BMI160))(with_ankle(scanned(moving, 0)))
    assert any("foot does not stand still" in note for note in found.notes)
    before = left_px(RigidMotion.identity(VIEWS), moving)
    assert left_px(motion_found(found), moving) < 0.8 * before


def wandering(seed: int, size: float) -> Callable[[np.ndarray], Sequence[np.ndarray]]:
    """A walk of ``size`` m per root of a second, and its derivatives."""
    knots = np.arange(-1.0, 6.0, 0.2)
    walk = size * np.sqrt(0.2) * np.cumsum(np.random.default_rng(seed).standard_normal(len(knots)))
    curve = make_interp_spline(knots, walk, k=5)
    return lambda times: [curve.derivative(n)(times) if n else curve(times) for n in range(3)]


def chi_square(moving: Moving, shank: Mounted, seed: int) -> float:
    """Of where the knee is carried in the last view, by a sensor of which nothing is seen."""
    scan = with_ankle(scanned(moving, seed), shank)
    found = Standing("shank_l", SensorPriors(BMI160)).path(scan)
    off = (found.motion.carry(KNEE[None]) - motion_of(moving).carry(KNEE[None]))[-1, 0]
    return float(off @ np.linalg.solve(found.covariance_at(KNEE)[-1], off))


@pytest.mark.parametrize("walk_mm", [0.2, 0.4])
def test_over_an_ankle_that_walks_errors_are_no_larger_than_stated(walk_mm: float):
    """12 draws of the walk, the sensor and its start: chi-square of its motion within 99.9 %."""
    draws, missed = 12, 0.0
    for seed in range(draws):
        axis = np.random.default_rng([seed, 3]).standard_normal(3)
        axis *= np.sqrt(3) / np.linalg.norm(axis)
        moving = Shifted(ON_FOOT, wandering(seed, 1e-3 * walk_mm), axis)
        missed += chi_square(moving, ON_FOOT, seed)
    assert missed < chi2.ppf(0.999, 3 * draws)


@pytest.mark.parametrize("degrees", [0.4, 0.8, 4.0])
def test_who_sways_by_millimeters_or_bends_the_knee_is_not_pressed_into_place(degrees: float):
    """8 draws, knees that move by 3 to 30 mm RMS: chi-square within 99.9 %."""
    draws, missed = 8, 0.0
    for seed in range(draws):
        sway = Sway.standing(10 + seed, position_mm=0.05, angle_deg=degrees)
        shank = Mounted(replace(sway, center=ANKLE), height=0.26)
        missed += chi_square(shank, shank, seed)
    assert missed < chi2.ppf(0.999, 3 * draws)


def test_signals_that_do_not_fit_a_person_who_stands_are_not_followed():
    """The sensor is the still point, and what is called the ankle swings by centimeters."""
    still = Mounted(replace(Sway.standing(4, position_mm=0.05, angle_deg=4.0), center=ANKLE), 0.0)
    place = still.place(0.0) - np.array([0.0, 0.35, 0.0])
    scan = replace(scanned(still, 0), ankles=(AttachedPoint("shank_l", place),))
    moved_down = replace(
        scan,
        starts=tuple(
            replace(s, world_from_sensor=transforms.translation([0, 0.35, 0]) @ s.world_from_sensor)
            for s in scan.starts
        ),
    )
    found = Standing("shank_l", SensorPriors(BMI160))(moved_down)
    assert wobble_mm(motion_found(found)) < 1e-9
    assert found.notes[-1].startswith("In doubt: standing: an error of the sensor or of its start")


@pytest.mark.parametrize("seed", range(2))
def test_points_in_a_consumer_sensor_undo_a_sway(seed: int):
    found = FusedFiducials(in_sensor(SWAY, seed), "shank_l", SensorPriors(BMI160))(
        scanned(SWAY, seed)
    )
    before = left_px(RigidMotion.identity(VIEWS), SWAY)
    assert left_px(motion_found(found), SWAY) < 0.15 * before
    assert "4 fiducials in the sensor: 100 %" in found.notes[0]


def test_points_in_a_sensor_that_the_detector_does_not_show_are_refused():
    whole = in_sensor(SWAY, 0)
    pixels = np.full_like(whole.pixels, np.nan)
    pixels[:2] = whole.pixels[:2]
    hidden = FiducialShadows(pixels, whole.points_sensor)
    with pytest.raises(LegsimError, match=r"seen in 2 views, 3 are needed; place the sensor"):
        FusedFiducials(hidden, "shank_l", SensorPriors(BMI160))(scanned(SWAY, 0))


@pytest.mark.parametrize("seed", range(3))
def test_a_person_who_does_not_move_is_not_moved(seed: int):
    """With a BMI160's noise, bias and scale: less than 0.1 mm, and a word why."""
    scan, priors = scanned(STILL, seed), SensorPriors(BMI160)
    for method in (
        Standing("", priors),
        FusedBeads(shadows(STILL, seed), "", priors),
        FusedFiducials(in_sensor(STILL, seed), "", priors),
    ):
        found = method(scan)
        assert wobble_mm(motion_found(found)) < 0.1
        assert "the scan is left as it is" in found.notes[-1]


def worse(sway: Sway, seed: int, px: float) -> BeadShadows:
    """Shadows that miss by more than they say."""
    exact = shadows(sway, seed).pixels
    return BeadShadows(exact + px * np.random.default_rng([seed, 1]).standard_normal(exact.shape))


@pytest.mark.parametrize("px", [0.6, 1.0, 3.0])
@pytest.mark.parametrize("seed", range(2))
def test_shadows_that_are_worse_than_stated_move_nobody_who_rests(seed: int, px: float):
    found = FusedBeads(worse(STILL, seed, px), "", SensorPriors(BMI160))(scanned(STILL, seed))
    assert wobble_mm(motion_found(found)) < 1e-9
    assert "the scan is left as it is" in found.notes[-1]


@pytest.mark.parametrize("px", [1.0, 3.0, 10.0, 100.0])
def test_shadows_that_are_worse_than_stated_do_no_harm(px: float):
    found = FusedBeads(worse(SWAY, 1, px), "", SensorPriors(BMI160))(scanned(SWAY, 1))
    assert left_px(motion_found(found), SWAY) <= left_px(RigidMotion.identity(VIEWS), SWAY)


def test_shadows_that_are_nowhere_near_the_path_are_doubted():
    turned = BeadShadows(3 * shadows(SWAY, 1).pixels[::-1])
    found = FusedBeads(turned, "", SensorPriors(BMI160))(scanned(SWAY, 1))
    assert wobble_mm(motion_found(found)) < 1e-9
    assert found.notes[1].startswith("In doubt: fused-beads: the shadows are")
    good = FusedBeads(shadows(SWAY, 1), "", SensorPriors(BMI160))(scanned(SWAY, 1))
    assert not any(note.startswith("In doubt") for note in good.notes)


def test_shadows_that_fit_no_path_leave_the_scan_as_it_is(monkeypatch: pytest.MonkeyPatch):
    """A run goes on with its other methods."""

    def far(*_: object) -> None:
        raise np.linalg.LinAlgError("not positive definite")

    monkeypatch.setattr(path_problem, "cho_factor", far)
    found = FusedBeads(shadows(SWAY, 1), "", SensorPriors(BMI160))(scanned(SWAY, 1))
    assert wobble_mm(motion_found(found)) < 1e-9
    assert found.notes[0].startswith("In doubt: fused-beads: no path of the sensor fits")


def test_what_a_consumer_sensor_alone_cannot_tell_is_said():
    found = Standing("shank_l", SensorPriors(BMI160))(scanned(SWAY, 1))
    np.testing.assert_array_equal(
        motion_found(found).moved_from_reference, RigidMotion.identity(VIEWS).moved_from_reference
    )
    (note,) = found.notes
    assert "the data do not determine it" in note


def test_a_sensor_without_errors_leaves_no_more_than_a_trend_from_a_rough_start():
    """Tilt and velocity of the start are a parabola of time, which standing bounds; the rest is
    right to the heading's error of three degrees.
    """
    large, none = Sway.standing(4, position_mm=4.0, angle_deg=0.8), SensorErrors()
    motion = motion_found(Standing("shank_l", SensorPriors(none))(scanned(large, 2, none)))
    true = motion_of(large)
    parabola = np.vander(VIEWS, 3)
    off, path = ((m - BONE).reshape(len(VIEWS), -1) for m in (motion.carry(BONE), true.carry(BONE)))
    off = off - path
    left = off - parabola @ np.linalg.lstsq(parabola, off, rcond=None)[0]
    assert np.sqrt((left**2).mean()) < 0.1 * np.sqrt((path**2).mean())
    assert np.abs(off).max() < 0.02


def test_an_exact_sensor_is_followed_as_it_is():
    scan = scanned(SWAY, 0, SensorErrors())
    true = SensorStart(SWAY.poses(VIEWS[:1])[0], SWAY.velocities(VIEWS[:1])[0])
    exact = replace(scan, starts=(true,))
    found = Standing("shank_l", SensorPriors(SensorErrors(), EXACT))(exact)
    assert left_px(motion_found(found), SWAY) < 1e-4


@pytest.mark.parametrize("late", [0.0, 0.02])
def test_a_late_clock_is_found(late: float):
    """To three standard deviations, which a lively sway makes small."""
    lively, clock = Sway.standing(4, position_mm=5.0, angle_deg=1.0), 0.01
    scan = scanned(lively, 3)
    signals = replace(scan.signals, times=scan.signals.times + late)
    state = error_state(
        signals, "shank_l", scan.starts[0], VIEWS, BMI160, StartErrors(), clock=clock
    )
    found = smooth(state, geometry=GEOMETRY, beads=shadows(lively, 3))
    sigma = clock * float(np.sqrt(found.covariance[-1, -1]))
    assert sigma < 0.005
    assert clock * found.errors[-1] == pytest.approx(late, abs=3 * sigma)


def test_a_step_beyond_any_offset_of_the_clocks_stays_within_the_recording():
    scan, clock = scanned(SWAY, 0), 0.01
    near = np.abs(SAMPLES - VIEWS.mean()) < 0.5 * np.ptp(VIEWS) + 0.06
    cut = ImuSignals(
        SAMPLES[near],
        ("shank_l",),
        scan.signals.angular_velocity[near],
        scan.signals.specific_force[near],
    )
    state = error_state(cut, "shank_l", scan.starts[0], VIEWS, BMI160, StartErrors(), clock=clock)
    errors = np.zeros(state.size)
    errors[-1] = 40.0
    assert np.isfinite(state.path(errors).twists).all()


def test_a_recording_no_longer_than_the_scan_is_enough():
    scan = scanned(SWAY, 0)
    during = (VIEWS[0] <= SAMPLES) & (VIEWS[-1] + 1 / 120 >= SAMPLES)
    cut = ImuSignals(
        SAMPLES[during],
        ("shank_l",),
        scan.signals.angular_velocity[during],
        scan.signals.specific_force[during],
    )
    found = FusedBeads(shadows(SWAY, 0), "shank_l")(replace(scan, signals=cut))
    assert left_px(motion_found(found), SWAY) < 0.5 * left_px(RigidMotion.identity(VIEWS), SWAY)


def test_beads_are_made_when_the_method_runs():
    asked: list[int] = []

    def made() -> BeadShadows | BeadScan:
        asked.append(1)
        return shadows(SWAY, 0)

    method = FusedBeads(made, "shank_l")
    assert not asked
    method(scanned(SWAY, 0))
    assert asked == [1]


def test_priors_that_are_no_sizes_are_refused():
    for spread in (0.0, -2e-3, float("nan")):
        with pytest.raises(LegsimError, match=r"SensorPriors\.spread is .* finite and positive"):
            SensorPriors(BMI160, spread=spread)
    for clock in (-0.01, float("inf")):
        with pytest.raises(LegsimError, match=r"SensorPriors\.clock is .* finite and not negative"):
            SensorPriors(BMI160, clock=clock)
