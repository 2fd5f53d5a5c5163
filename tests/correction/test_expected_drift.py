"""The expected drift is that of drawn sensors, and is reported where it hides what a person does."""

from dataclasses import replace

import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.constants import STANDARD_GRAVITY
from legsim.correction.expected_drift import drift_warning, expected_drift
from legsim.correction.fused import SensorPriors
from legsim.correction.initialization import Starts, leveled
from legsim.correction.method import Scan
from legsim.correction.rigid import Rigid
from legsim.correction.rough_start import EXACT, StartErrors, rough
from legsim.deformation.models import RigidMotion
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.imu.calibration import Calibration
from legsim.imu.errors import SensorErrors, TriadErrors
from legsim.imu.readout import read_out
from legsim.imu.signals import ImuSignals, SensorStart
from tests.references.sway import Sway

VIEWS = np.arange(40) / 10
SAMPLES = np.arange(-30, 450) / 100
SWAY = Sway.standing(4, position_mm=1.5, angle_deg=0.3)
SMALL = SensorErrors(
    TriadErrors(noise_density=2e-4, turn_on_bias=0.005), TriadErrors(noise_density=1e-5)
)
START = StartErrors(0.001, 0.002, 0.003, 0.001)
GEOMETRY = ConeBeamGeometry.circular(
    times=VIEWS,
    angles=np.radians(5) * np.arange(len(VIEWS)),
    source_isocenter=0.78,
    source_detector=1.198,
    shape_vu=(24, 31),
    pixel_pitch=1.232e-2,
    isocenter=SWAY.center,
)


def scanned(
    errors: SensorErrors, start: StartErrors, seed: int, calibration: Calibration | None = None
) -> Scan:
    rng = np.random.default_rng(seed)
    rate, force = SWAY.signals(SAMPLES)
    exact = ImuSignals(SAMPLES, ("shank_l",), rate[:, None], force[:, None])
    true = SensorStart(SWAY.poses(VIEWS[:1])[0], SWAY.velocities(VIEWS[:1])[0])
    (drawn,) = rough([true], start, rng)
    velocity = true.velocity + start.velocity * rng.standard_normal(3)
    empty = Projections(GEOMETRY, np.zeros((len(VIEWS), 24, 31), np.float32))
    at_rest = true.world_from_sensor[:3, :3].T @ [[0.0], [STANDARD_GRAVITY], [0.0]]
    read = read_out(exact, errors, rng, calibration=calibration, rest_force=at_rest.T)
    starts = Starts((replace(drawn, velocity=velocity),), ())
    return Scan(empty, read, leveled(starts, read).starts)


def drift(errors: SensorErrors, start: StartErrors, calibration: Calibration | None) -> float:
    """RMS (m) at the knee of 60 sensors through the real integration."""
    knee, squares = GEOMETRY.rotation_center()[None], []
    true = transforms.apply(
        RigidMotion.from_poses(VIEWS, SWAY.poses(VIEWS)).moved_from_reference, knee
    )
    for seed in range(60):
        motion = Rigid("shank_l")(scanned(errors, start, seed, calibration)).motion
        assert isinstance(motion, RigidMotion)
        squares.append(((motion.carry(knee) - true) ** 2).sum(-1).mean())
    return float(np.sqrt(np.mean(squares)))


def test_it_is_what_drawn_sensors_do():
    """Of 60 sensors, to 20 %: two standard deviations of it."""
    expected = expected_drift(scanned(SMALL, START, 0), "shank_l", SensorPriors(SMALL, START))
    assert expected == pytest.approx(drift(SMALL, START, None), rel=0.2)


def test_a_start_without_speed_is_off_by_the_speed_of_who_stands():
    """Of exact sensors that start as they stand, on 30 people who sway; 30 mm/s, as an estimate
    allows for, would be 200 mm.
    """
    knee, squares, spreads = GEOMETRY.rotation_center()[None], [], []
    allowed = StartErrors(0.0, 0.0, 0.03, 0.0)
    scans = []
    for seed in range(30):
        sway = Sway.standing(seed, position_mm=1.5, angle_deg=0.0)
        rate, force = sway.signals(SAMPLES)
        exact = ImuSignals(SAMPLES, ("shank_l",), rate[:, None], force[:, None])
        start = SensorStart(sway.poses(VIEWS[:1])[0], np.zeros(3))
        empty = Projections(GEOMETRY, np.zeros((len(VIEWS), 24, 31), np.float32))
        scans.append(Scan(empty, exact, (start,)))
        motion = Rigid("shank_l")(scans[-1]).motion
        assert isinstance(motion, RigidMotion)
        true = RigidMotion.from_poses(VIEWS, sway.poses(VIEWS)).carry(knee)
        squares.append(np.square(motion.carry(knee) - true).sum(-1).mean())
        spreads.append(np.square(true - true.mean(0)).mean())
    found, spread = np.sqrt(np.mean(squares)), float(np.sqrt(np.mean(spreads)))
    expected = expected_drift(scans[0], "shank_l", SensorPriors(SensorErrors(), allowed, spread))
    # people differ by a factor of two in how fast they sway
    assert 0.5 * found < expected < 2 * found
    assert expected < 0.04


def test_a_start_leveled_at_rest_hides_what_tilts_it():
    """Bias and tilt cancel to the side: a tilt of 1.5 deg, leveled, is 3 m less of drift in 4 s."""
    errors, start = SMALL, replace(START, tilt=float(np.radians(1.5)))
    found = drift(errors, start, Calibration("rest"))
    scan, priors = scanned(errors, start, 0, Calibration("rest")), SensorPriors(errors, start)
    assert 0.5 * found < expected_drift(scan, "shank_l", priors) < 2 * found
    assert expected_drift(scanned(errors, start, 0), "shank_l", priors) > 5 * found


def test_axes_that_read_each_other_tilt_a_leveled_start():
    """A twentieth of cross-talk alone: what leveling makes of it undoes it while nobody turns."""
    errors = SensorErrors(TriadErrors(misalignment=0.05, scale_error=0.05))
    start = StartErrors(0.0, 0.0, 0.0, 0.0)
    found = drift(errors, start, Calibration("rest"))
    scan, priors = scanned(errors, start, 0, Calibration("rest")), SensorPriors(errors, start)
    assert 0.5 * found < expected_drift(scan, "shank_l", priors) < 2 * found


def test_an_exact_sensor_does_not_drift():
    scan, exact = scanned(SensorErrors(), EXACT, 0), SensorPriors(SensorErrors(), EXACT)
    assert expected_drift(scan, "shank_l", exact) == 0
    assert drift_warning("rigid", scan, "shank_l", exact) == ""


def test_a_drift_that_hides_how_a_person_moves_is_reported():
    scan = scanned(SMALL, START, 0)
    said = drift_warning("rigid", scan, "shank_l", SensorPriors(SMALL, START))
    assert "rigid follows shank_l by dead reckoning" in said
    assert "does not determine it" in said
    assert drift_warning("rigid", scan, "shank_l", SensorPriors(SMALL, START, spread=10.0)) == ""
