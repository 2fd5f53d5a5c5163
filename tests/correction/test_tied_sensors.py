"""Two sensors that share a knee: its center goes one way, and the covariance is that of the errors."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.stats import chi2

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.correction import path_problem, smoother, tied_sensors
from legsim.correction.error_state import error_state
from legsim.correction.fused import SensorPriors
from legsim.correction.method import Scan
from legsim.correction.path_measurements import BeadShadows
from legsim.correction.rough_start import StartErrors, rough
from legsim.correction.smoother import SmoothedPath
from legsim.correction.tied_sensors import LegTie, MeasuredSegment, TiedPaths
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.imu.errors import SensorErrors
from legsim.imu.readout import read_out
from legsim.imu.signals import ImuSignals, SensorStart
from tests.correction.test_smoother import SAMPLES, SENSOR, START, VIEWS
from tests.references.sway import Sway

SHANK = Sway.standing(5, position_mm=1.5, angle_deg=0.3)
THIGH = replace(Sway.standing(6, angle_deg=0.4), position=SHANK.position, center=SHANK.center)
KNEE = SHANK.center
"""both frames of a leg begin at the knee, and turn about it each in its own way"""
PLACES = {
    "thigh_l": KNEE + 1e-3 * np.array([[50.0, 45.0, 10.0], [-40.0, 60.0, 30.0]]),
    "shank_l": KNEE + 1e-3 * np.array([[40.0, -20.0, 30.0], [-50.0, -60.0, 10.0]]),
}
GEOMETRY = ConeBeamGeometry.circular(
    times=VIEWS,
    angles=np.radians(5) * np.arange(len(VIEWS)),
    source_isocenter=0.78,
    source_detector=1.198,
    shape_vu=(240, 310),
    pixel_pitch=1.232e-3,
    isocenter=KNEE,
)


@dataclass(frozen=True)
class Mounted:
    """A sensor away from the knee, on a segment that turns about it."""

    sway: Sway
    height: float
    """m above the knee at the first view"""

    @property
    def arm(self) -> FloatArray:
        """(3,) m from the knee to the sensor, in its own axes."""
        return self.sway.poses(VIEWS[:1])[0, :3, :3].T @ [0.05, self.height, 0.02]

    def poses(self, times: FloatArray) -> FloatArray:
        return self.sway.poses(times) @ transforms.translation(self.arm)

    def velocities(self, times: FloatArray) -> FloatArray:
        rate, _ = self.sway.signals(times)
        turned = np.einsum(
            "nij,nj->ni", self.sway.poses(times)[:, :3, :3], np.cross(rate, self.arm)
        )
        return self.sway.velocities(times) + turned

    def start(self) -> SensorStart:
        return SensorStart(self.poses(VIEWS[:1])[0], self.velocities(VIEWS[:1])[0])

    def signals(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Those at the knee, and what turning adds at the arm's end."""
        rate, force = self.sway.signals(times)
        later, before = (self.sway.signals(times + k * 1e-4)[0] for k in (1, -1))
        spin = (later - before) / 2e-4
        return rate, force + np.cross(spin, self.arm) + np.cross(rate, np.cross(rate, self.arm))

    def place(self, above: float) -> FloatArray:
        """(3,) m in the sensor of a point above what it turns about, at the first view."""
        at = self.sway.center + self.sway.position(VIEWS[:1], 0)[0] + [0.0, above, 0.0]
        return transforms.apply(transforms.inverse(self.poses(VIEWS[:1])[0]), at[None])[0]

    def motion(self) -> FloatArray:
        poses = self.poses(VIEWS)
        return poses @ transforms.inverse(poses[0])


LEG = {"thigh_l": Mounted(THIGH, 0.25), "shank_l": Mounted(SHANK, -0.14)}
TIE = LegTie(
    LEG["thigh_l"].place(0.0),
    LEG["shank_l"].place(0.0),
    LEG["shank_l"].place(-0.4),
    LEG["thigh_l"].place(0.4),
    ankle_walk=None,
)
"""of a leg that swings about its knee: no foot stands"""
FREE = replace(TIE, laxity=1e4, placement=1e4, together=None)


ABOVE = KNEE + np.array([0.0, 0.04, 0.08])[:, None] * [0.0, 1.0, 0.0]
PRIORS = SensorPriors(SENSOR, START, clock=0.0)


def swinging(degrees: float) -> Mounted:
    """A thigh that swings about the knee, RMS per axis."""
    sway = Sway.standing(6, angle_deg=degrees)
    own = replace(sway, position=SHANK.position, center=SHANK.center)
    return replace(LEG["thigh_l"], sway=own)


def default_tie() -> LegTie:
    """That of a scan, with the joints where they are now."""
    thigh = LEG["thigh_l"]
    return LegTie(thigh.place(0.0), TIE.knee_in_shank, TIE.ankle_in_shank, thigh.place(0.4))


def scanned(rng: np.random.Generator, start: StartErrors = START) -> Scan:
    """Both sensors with errors and rough starts; the images are empty."""
    read = [one.signals(SAMPLES) for one in LEG.values()]
    exact = ImuSignals(
        SAMPLES, tuple(LEG), *(np.stack(kind, 1) for kind in zip(*read, strict=True))
    )
    starts = []
    for drawn in rough([one.start() for one in LEG.values()], start, rng):
        starts.append(replace(drawn, velocity=start.velocity * rng.standard_normal(3)))
    empty = Projections(GEOMETRY, np.zeros((len(VIEWS), *GEOMETRY.shape_vu), np.float32))
    return Scan(empty, read_out(exact, SENSOR, rng), tuple(starts))


def shadows(name: str, rng: np.random.Generator, px: float = 0.3) -> BeadShadows:
    exact = GEOMETRY.project(transforms.apply(LEG[name].motion(), PLACES[name]))[0]
    return BeadShadows(exact + px * rng.standard_normal(exact.shape), px)


def segments(
    rng: np.random.Generator, start: StartErrors = START
) -> tuple[MeasuredSegment, MeasuredSegment]:
    scan = scanned(rng, start)
    thigh, shank = (
        MeasuredSegment(
            error_state(scan.signals, name, scan.start(name), VIEWS, SENSOR, start),
            beads=shadows(name, rng),
        )
        for name in LEG
    )
    return thigh, shank


def alone(one: MeasuredSegment) -> SmoothedPath:
    return smoother.smooth(one.state, standing=one.standing, geometry=GEOMETRY, beads=one.beads)


def followed(seed: int, tie: LegTie) -> TiedPaths:
    """Two beads on each segment and the priors of a scan."""
    rng = np.random.default_rng(seed)
    scan, beads = scanned(rng), (shadows("thigh_l", rng), shadows("shank_l", rng))
    return tied_sensors.tied_paths(scan, ("thigh_l", "shank_l"), tie, PRIORS, beads)


def parting_missed(found: TiedPaths) -> float:
    """m, RMS, by which the motion of thigh against shank is wrong above the knee."""
    thigh, shank = (motion.carry(ABOVE) for motion in found.motions)
    true = [transforms.apply(one.motion(), ABOVE) for one in LEG.values()]
    return float(np.sqrt(np.square((thigh - shank) - (true[0] - true[1])).sum(-1).mean()))


def missed(found: SmoothedPath, name: str) -> FloatArray:
    """(v, 3) m at the knee."""
    knee = KNEE[None]
    return (found.motion.carry(knee) - transforms.apply(LEG[name].motion(), knee))[:, 0]


def turned(found: SmoothedPath, name: str) -> FloatArray:
    """(v, 3) rad, from the left."""
    true = LEG[name].motion()[:, :3, :3]
    off = found.motion.moved_from_reference[:, :3, :3] @ np.swapaxes(true, -1, -2)
    return transforms.vector_from_rotation(off)


def test_the_sensors_of_this_leg_follow_their_own_signals():
    """An exact sensor away from the knee is where its arm is; the knee is at one place in both."""
    for name, one in LEG.items():
        rate, force = one.signals(SAMPLES)
        signals = ImuSignals(SAMPLES, (name,), rate[:, None], force[:, None])
        state = error_state(signals, name, one.start(), VIEWS, SensorErrors(), START)
        np.testing.assert_allclose(state.poses(np.zeros(state.size)), one.poses(VIEWS), atol=1e-6)
    thigh, shank = (
        transforms.apply(one.poses(VIEWS), knee[None])
        for one, knee in zip(LEG.values(), (TIE.knee_in_thigh, TIE.knee_in_shank), strict=True)
    )
    np.testing.assert_allclose(thigh, shank, atol=1e-12)


def test_a_tie_that_gives_way_leaves_each_sensor_as_it_is_alone(rng: np.random.Generator):
    both = segments(rng)
    tied = tied_sensors.smooth_tied(*both, FREE, GEOMETRY)
    assert tied.settled
    for one, own in zip((tied.thigh, tied.shank), map(alone, both), strict=True):
        np.testing.assert_allclose(one.path.poses, own.path.poses, atol=1e-6)
        np.testing.assert_allclose(one.covariance, own.covariance, atol=1e-6)
        np.testing.assert_allclose(one.bead_places, own.bead_places, atol=1e-6)
        assert one.residual_px == pytest.approx(own.residual_px, rel=1e-4)


def test_tied_sensors_carry_the_knee_to_one_place(rng: np.random.Generator):
    """As near as the tie says, and the constant part falls, which the first view leaves."""
    both = segments(rng)
    free, tied = (tied_sensors.smooth_tied(*both, tie, GEOMETRY) for tie in (FREE, TIE))
    apart, before = tied.apart(KNEE), free.apart(KNEE)
    assert np.sqrt((apart**2).sum(-1).mean()) < 0.5 * np.sqrt((before**2).sum(-1).mean())
    assert np.linalg.norm(apart.mean(0)) < 0.5 * np.linalg.norm(before.mean(0))
    firm = tied_sensors.smooth_tied(*both, replace(TIE, laxity=1e-5, together=None), GEOMETRY)
    assert np.abs(firm.apart(KNEE)).max() < 5e-5
    for one in (tied, free):
        spread = np.sqrt(np.trace(one.apart_covariance(KNEE), axis1=1, axis2=2))
        assert spread[0] == pytest.approx(0, abs=1e-9)
    assert spread[1:].min() > 0


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("degrees", [0.4, 2.0])
def test_what_beads_do_not_tell_of_thigh_against_shank_is_held_small(
    degrees: float, seed: int, monkeypatch: pytest.MonkeyPatch
):
    """With the priors and the tie of a scan: the joint above the knee is as well placed as that
    below it, also where the thigh swings about the knee.
    """
    monkeypatch.setitem(LEG, "thigh_l", swinging(degrees))
    tie = replace(default_tie(), ankle_walk=None)

    def parting(own: LegTie) -> tuple[float, float]:
        found = followed(seed, own)
        return parting_missed(found), found.parting(ABOVE)[1]

    loose, held = parting(replace(tie, together=None)), parting(tie)
    assert held[0] < loose[0]
    assert held[1] < loose[1]
    assert held[0] < 2 * held[1]


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("degrees", [6.0, 15.0])
def test_a_large_bend_is_followed_to_the_stated_error(
    degrees: float, seed: int, monkeypatch: pytest.MonkeyPatch
):
    """Who bends so far leaves the place of a person who stands, too."""
    monkeypatch.setitem(LEG, "thigh_l", swinging(degrees))
    found = followed(seed, default_tie())
    assert found.settled
    assert parting_missed(found) < 1.5 * found.parting(ABOVE)[1] < 2.5e-3


@pytest.mark.parametrize("seed", [0, 1])
def test_a_leg_whose_foot_does_not_stand_is_followed_as_without_a_foot(seed: int):
    """This one swings about its knee, so that its ankle goes to and fro by millimeters."""
    free, held = (followed(seed, replace(default_tie(), ankle_walk=w)) for w in (None, 2e-4))
    assert held.settled

    def missed_mm(found: TiedPaths) -> float:
        return 1e3 * float(np.sqrt(np.square(missed(found.shank, "shank_l")).sum(-1).mean()))

    assert missed_mm(held) < 1.2 * missed_mm(free)


def test_priors_that_widen_to_the_end_are_not_settled(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(LEG, "thigh_l", swinging(6.0))
    monkeypatch.setattr(tied_sensors, "_ROUNDS", 1)
    assert not followed(0, default_tie()).settled


def test_what_wrong_shadows_seem_to_show_widens_no_prior(rng: np.random.Generator):
    """Shadows stated too good give what those give that are stated as they are."""
    both = [
        replace(one, beads=shadows(name, rng, 3.0))
        for name, one in zip(LEG, segments(rng), strict=True)
    ]
    wrong = [replace(one, beads=BeadShadows(one.beads.pixels, 0.3)) for one in both if one.beads]
    # on no foot, which does not stand here: whether its walk is widened once more hangs by a hair
    tie = replace(default_tie(), ankle_walk=None)
    found, stated = (
        tied_sensors.smooth_tied(pair[0], pair[1], tie, GEOMETRY) for pair in (wrong, both)
    )
    assert found.parting(ABOVE)[1] == pytest.approx(stated.parting(ABOVE)[1], rel=0.1)
    assert found.parting(ABOVE)[0] == pytest.approx(stated.parting(ABOVE)[0], rel=0.2)


def test_steps_that_run_away_are_tried_again_by_halves(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
):
    """As wrong shadows make them; here the first steps are far too long."""
    both, tie = segments(rng), replace(TIE, together=None)
    right = tied_sensors.smooth_tied(*both, tie, GEOMETRY)
    whole, alone = path_problem._STEPS, tied_sensors.descended
    monkeypatch.setattr(
        tied_sensors, "descended", lambda *given: _with_steps(monkeypatch, whole, alone, given)
    )
    found = tied_sensors.smooth_tied(*both, tie, GEOMETRY)
    assert found.settled
    np.testing.assert_allclose(found.thigh.path.poses, right.thigh.path.poses, atol=1e-5)


def _with_steps(monkeypatch: pytest.MonkeyPatch, whole: object, alone: Callable, given: tuple):
    """Each sensor alone goes by its usual steps, and both together by ones that run away."""
    monkeypatch.setattr(path_problem, "_STEPS", whole)
    found = alone(*given)
    monkeypatch.setattr(path_problem, "_STEPS", (-30.0,) * 400)
    return found


def test_a_knee_that_is_misplaced_in_one_sensor_is_found(rng: np.random.Generator):
    """Where the sensors' own places are known."""
    off = np.array([4e-3, -3e-3, 5e-3])
    tie = replace(FREE, knee_in_thigh=TIE.knee_in_thigh - off, laxity=1e-3, placement=10e-3)
    placed = replace(START, tilt=1e-4, heading=1e-4, place=1e-4)
    found = tied_sensors.smooth_tied(*segments(rng, placed), tie, GEOMETRY)
    np.testing.assert_allclose(found.knee_off, off, atol=1e-3)


def test_a_tie_takes_no_knowledge_away(rng: np.random.Generator):
    both = segments(rng)
    free, tied = (tied_sensors.smooth_tied(*both, tie, GEOMETRY) for tie in (FREE, TIE))
    for one, other in ((tied.thigh, free.thigh), (tied.shank, free.shank)):
        assert (one.errors_mm(KNEE)[1:] < other.errors_mm(KNEE)[1:]).all()
    less = np.linalg.eigvalsh(free.covariance - tied.covariance)
    assert less.min() > -1e-6 * less.max()


@pytest.mark.end_to_end
def test_normalized_errors_of_tied_sensors_have_unit_variance():
    """40 draws of both sensors, starts, shadows and a misplaced knee: chi-square within its 99.9 %
    of either side. The knee of this leg is a ball in a socket, which the tie says too; its hip and
    ankle sway, of which it says nothing.
    """
    sums, draws = {"thigh": 0.0, "shank": 0.0, "turn": 0.0, "knee": 0.0}, 40
    for seed in range(draws):
        rng = np.random.default_rng([seed, 12])
        both = segments(rng)
        off = 3e-3 * rng.standard_normal(3)
        tie = replace(FREE, knee_in_thigh=TIE.knee_in_thigh - off, laxity=5e-5, placement=3e-3)
        found = tied_sensors.smooth_tied(*both, tie, GEOMETRY)
        assert found.settled
        for name, one in (("thigh", found.thigh), ("shank", found.shank)):
            sums[name] += normalized(missed(one, f"{name}_l")[-1], one.covariance_at(KNEE)[-1])
        turn = turned(found.thigh, "thigh_l")[-1]
        sums["turn"] += normalized(turn, found.thigh.turn_covariance()[-1])
        sums["knee"] += normalized(found.knee_off - off, found.covariance[-3:, -3:])
    low, high = (float(chi2.ppf(share, 3 * draws)) for share in (0.001, 0.999))
    assert all(low < total < high for total in sums.values()), (low, sums, high)


def normalized(error: FloatArray, covariance: FloatArray) -> float:
    return float(error @ np.linalg.solve(covariance, error))


def test_both_sensors_of_a_scan_are_tied(rng: np.random.Generator):
    scan = scanned(rng)
    beads = (shadows("thigh_l", rng), shadows("shank_l", rng))
    found = tied_sensors.tied_paths(
        scan, ("thigh_l", "shank_l"), TIE, SensorPriors(SENSOR, START), beads
    )
    for motion, name in zip(found.motions, LEG, strict=True):
        off = motion.carry(KNEE[None]) - transforms.apply(LEG[name].motion(), KNEE[None])
        assert np.sqrt((off**2).sum(-1).mean()) < 1.5e-3
    hip, knee, ankle = found.joints(TIE)
    assert np.linalg.norm(hip - knee) == pytest.approx(0.4, abs=0.02)
    assert np.linalg.norm(ankle - knee) == pytest.approx(0.4, abs=1e-9)


def test_ties_that_are_none_and_other_scans_are_refused(rng: np.random.Generator):
    with pytest.raises(LegsimError, match="laxity of a leg's tie must be positive"):
        replace(TIE, laxity=0.0)
    thigh, shank = segments(rng)
    rate, force = LEG["thigh_l"].signals(SAMPLES)
    signals = ImuSignals(SAMPLES, ("thigh_l",), rate[:, None], force[:, None])
    fewer = error_state(signals, "thigh_l", LEG["thigh_l"].start(), VIEWS[:-1], SENSOR, START)
    with pytest.raises(LegsimError, match="same views"):
        tied_sensors.smooth_tied(replace(thigh, state=fewer), shank, TIE, GEOMETRY)
