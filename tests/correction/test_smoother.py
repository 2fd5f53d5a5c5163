"""The smoother: exact data give the true path, and its covariance is that of its errors."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.correction import smoother
from legsim.correction.error_state import ErrorState, error_state
from legsim.correction.path_measurements import BeadShadows, FiducialShadows, StandingPrior
from legsim.correction.rough_start import StartErrors, rough
from legsim.correction.smoother import SmoothedPath
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.imu.errors import SensorErrors, TriadErrors
from legsim.imu.readout import read_out
from legsim.imu.signals import ImuSignals, SensorStart
from tests.references.sway import Sway

VIEWS = np.arange(40) / 15
SAMPLES = np.arange(-15, 160) / 50
SWAY = Sway.standing(5, position_mm=1.5, angle_deg=0.3)
POSES = SWAY.poses(VIEWS)
TRUE = POSES @ transforms.inverse(POSES[0])
KNEE = SWAY.center + np.array([0.0, 0.14, 0.0])
PLACES = KNEE + 1e-3 * np.array([[40.0, -20.0, 30.0], [-50.0, -60.0, 10.0]])
AXES = 0.03 * np.concatenate([np.zeros((1, 3)), np.eye(3)])
SENSOR = SensorErrors(
    TriadErrors(noise_density=2e-3, turn_on_bias=0.1, scale_error=0.01, misalignment=0.01),
    TriadErrors(noise_density=1e-4, turn_on_bias=0.01, scale_error=0.01, misalignment=0.01),
)
START = StartErrors(0.02, 0.04, 0.03, 0.005)
GEOMETRY = ConeBeamGeometry.circular(
    times=VIEWS,
    angles=np.radians(5) * np.arange(len(VIEWS)),
    source_isocenter=0.78,
    source_detector=1.198,
    shape_vu=(240, 310),
    pixel_pitch=1.232e-3,
    isocenter=KNEE,
)


def sensed(rng: np.random.Generator | None) -> ErrorState:
    """A sensor with errors and a rough start; None has neither, but is not known to be exact."""
    rate, force = SWAY.signals(SAMPLES)
    signals = ImuSignals(SAMPLES, ("shank_l",), rate[:, None], force[:, None])
    start = SensorStart(POSES[0], SWAY.velocities(VIEWS[:1])[0])
    if rng is not None:
        signals = read_out(signals, SENSOR, rng)
        velocity = start.velocity + START.velocity * rng.standard_normal(3)
        (drawn,) = rough([start], START, rng)
        start = replace(drawn, velocity=velocity)
    return error_state(signals, "shank_l", start, VIEWS, SENSOR, START)


def bead_shadows(px: float, rng: np.random.Generator) -> BeadShadows:
    exact = GEOMETRY.project(transforms.apply(TRUE, PLACES))[0]
    return BeadShadows(exact + px * rng.standard_normal(exact.shape), max(px, 0.01))


def fiducial_shadows(px: float, rng: np.random.Generator) -> FiducialShadows:
    exact = GEOMETRY.project(transforms.apply(POSES, AXES))[0]
    return FiducialShadows(exact + px * rng.standard_normal(exact.shape), AXES, max(px, 0.01))


def missed(found: SmoothedPath) -> FloatArray:
    """(v, 3) m at the knee."""
    return (transforms.apply(found.path.motion(), KNEE[None]) - transforms.apply(TRUE, KNEE[None]))[
        :, 0
    ]


def turned(found: SmoothedPath) -> FloatArray:
    """(v, 3) rad, from the left."""
    off = found.path.motion()[:, :3, :3] @ np.swapaxes(TRUE[:, :3, :3], -1, -2)
    return transforms.vector_from_rotation(off)


def normalized(error: FloatArray, covariance: FloatArray) -> float:
    """Square of an error (3,) in its standard deviations."""
    return float(error @ np.linalg.solve(covariance, error))


def test_exact_data_of_an_exact_sensor_give_the_true_path(rng: np.random.Generator):
    found = smoother.smooth(
        sensed(None),
        geometry=GEOMETRY,
        beads=bead_shadows(0.0, rng),
        fiducials=fiducial_shadows(0.0, rng),
    )
    assert found.settled
    np.testing.assert_allclose(found.path.poses, POSES, atol=1e-7)
    np.testing.assert_allclose(found.bead_places, PLACES, atol=1e-7)


@pytest.mark.parametrize("seed", [2, 16, 134])
def test_a_few_wrong_shadows_do_not_keep_the_steps_going_in_a_circle(seed: int):
    """A bead that is met late, and wrongly at first: whole steps end 1.1 to 2.8 px off."""
    rng = np.random.default_rng([seed, 6])
    state, right = sensed(rng), bead_shadows(0.15, rng)
    pixels = right.pixels.copy()
    pixels[:8, 1] = np.nan
    size = rng.uniform(8, 14)
    angle = rng.uniform(0, 6.28)
    pixels[8:14, 1] += size * np.array([np.cos(angle), np.sin(angle)])
    standing = StandingPrior.at(KNEE)
    found = smoother.smooth(
        state, standing=standing, geometry=GEOMETRY, beads=BeadShadows(pixels, 0.3)
    )
    assert found.settled
    assert found.residual_px < 0.4
    assert np.linalg.norm(missed(found), axis=-1).max() < 3e-3


@pytest.mark.end_to_end
@pytest.mark.parametrize("by", ["beads", "fiducials"])
def test_normalized_errors_have_unit_variance(by: str):
    """50 draws of sensor, start and shadows: chi-square within its 99.9 % of either side.

    Sensors draw their noise sample by sample, shadows pixel by pixel. With fiducials the place of
    the sensor itself is known, with beads its motion.
    """
    places, turns, draws = [], [], 50
    for seed in range(draws):
        rng = np.random.default_rng([seed, 11])
        state = sensed(rng)
        given = (
            {"beads": bead_shadows(0.3, rng)}
            if by == "beads"
            else {"fiducials": fiducial_shadows(0.3, rng)}
        )
        found = smoother.smooth(state, geometry=GEOMETRY, **given)
        assert found.settled
        places.append(normalized(missed(found)[-1], found.covariance_at(KNEE)[-1]))
        turns.append(normalized(turned(found)[-1], found.turn_covariance()[-1]))
    low, high = (float(chi2.ppf(share, 3 * draws)) for share in (0.001, 0.999))
    assert low < sum(places) < high
    assert low < sum(turns) < high


def test_more_measurements_leave_less_error(rng: np.random.Generator):
    state = sensed(rng)
    beads, standing = bead_shadows(0.3, rng), StandingPrior.at(KNEE)
    alone = smoother.smooth(state, standing=standing)
    aided = smoother.smooth(state, standing=standing, geometry=GEOMETRY, beads=beads)
    assert np.sqrt((missed(aided) ** 2).mean()) < 0.5 * np.sqrt((missed(alone) ** 2).mean())
    assert (aided.errors_mm(KNEE)[1:] < alone.errors_mm(KNEE)[1:]).all()
    assert (aided.errors_deg()[1:] < alone.errors_deg()[1:]).all()
    assert alone.errors_mm(KNEE)[0] == pytest.approx(0, abs=1e-9)


def test_a_standing_person_brings_centimeters_back_to_millimeters(rng: np.random.Generator):
    state = sensed(rng)
    astray = transforms.apply(
        (drifted := state.poses(np.zeros(state.size))) @ transforms.inverse(drifted[0]), KNEE[None]
    )
    assert np.abs(astray - KNEE).max() > 0.1
    found = smoother.smooth(state, standing=StandingPrior.at(KNEE))
    assert np.abs(missed(found)).max() < 0.005
    assert np.isnan(found.residual_px)


def test_errors_are_no_larger_than_stated_where_shadows_are_four_times_worse():
    """8 draws, chi-square within its 99.9 %."""
    places, draws = [], 8
    for seed in range(draws):
        rng = np.random.default_rng([seed, 12])
        beads = replace(bead_shadows(1.2, rng), error_px=0.3)
        found = smoother.smooth(sensed(rng), geometry=GEOMETRY, beads=beads)
        places.append(normalized(missed(found)[-1], found.covariance_at(KNEE)[-1]))
    assert sum(places) < chi2.ppf(0.999, 3 * draws)


def test_wrong_shadows_do_not_pull(rng: np.random.Generator):
    """One in twelve views has a bead's shadow 20 px off, one does not see it."""
    state, right = sensed(rng), bead_shadows(0.3, rng)
    pixels = np.array(right.pixels)
    pixels[::12, 0] += [20.0, -14.0]
    pixels[5::12, 1] = np.nan
    with_right, with_wrong = (
        smoother.smooth(
            state, standing=StandingPrior.at(KNEE), geometry=GEOMETRY, beads=BeadShadows(p, 0.3)
        )
        for p in (right.pixels, pixels)
    )
    apart = transforms.apply(with_wrong.path.motion(), KNEE[None]) - transforms.apply(
        with_right.path.motion(), KNEE[None]
    )
    assert np.sqrt((apart**2).mean()) < np.sqrt((with_right.errors_mm(KNEE) ** 2).mean()) * 1e-3


def test_beads_that_no_view_shows_and_shadows_of_other_scans_are_refused(
    rng: np.random.Generator,
):
    state, beads = sensed(None), bead_shadows(0.3, rng)
    with pytest.raises(LegsimError, match="none of 2 beads"):
        smoother.smooth(
            state, geometry=GEOMETRY, beads=BeadShadows(np.full_like(beads.pixels, np.nan))
        )
    with pytest.raises(LegsimError, match="views"):
        smoother.smooth(state, geometry=GEOMETRY, beads=BeadShadows(beads.pixels[:-1]))
    with pytest.raises(LegsimError, match="geometry"):
        smoother.smooth(state, beads=beads)


def test_a_bead_seen_in_two_views_is_left_out(rng: np.random.Generator):
    state, both = sensed(None), bead_shadows(0.3, rng)
    pixels = np.array(both.pixels)
    pixels[2:, 1] = np.nan
    standing = StandingPrior.at(KNEE)
    one, alone = (
        smoother.smooth(state, standing=standing, geometry=GEOMETRY, beads=BeadShadows(p, 0.3))
        for p in (pixels, pixels[:, :1])
    )
    np.testing.assert_allclose(one.path.poses, alone.path.poses, atol=1e-12)


def test_images_see_no_similarity_of_a_motion(rng: np.random.Generator):
    """A step along the source's path with another size is no motion that they see; what beads
    leave open is mostly that.
    """
    state, beads = sensed(rng), bead_shadows(0.3, rng)
    found = smoother.smooth(state, standing=StandingPrior.at(KNEE), geometry=GEOMETRY, beads=beads)
    points = StandingPrior.at(KNEE).points
    seen_px, error_px = found.seen_motion(GEOMETRY, points)
    plain = GEOMETRY.project(transforms.apply(found.path.motion(), points))[0]
    moved_px = np.sqrt(((plain - GEOMETRY.project(points)[0]) ** 2).sum(-1).mean())
    assert 0 < seen_px < moved_px
    pitch_mm = 1.232 * 0.78 / 1.198
    assert error_px * pitch_mm < 0.3 * np.sqrt((found.errors_mm(KNEE) ** 2).mean())
