"""The expected drift is that of drawn sensors, and is reported where it hides what a person does."""

from dataclasses import replace

import numpy as np
import pytest

from legsim.core import transforms
from legsim.correction.expected_drift import drift_warning, expected_drift
from legsim.correction.fused import SensorPriors
from legsim.correction.method import Scan
from legsim.correction.rigid import Rigid
from legsim.correction.rough_start import EXACT, StartErrors, rough
from legsim.deformation.models import RigidMotion
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
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


def scanned(errors: SensorErrors, start: StartErrors, seed: int) -> Scan:
    rng = np.random.default_rng(seed)
    rate, force = SWAY.signals(SAMPLES)
    exact = ImuSignals(SAMPLES, ("shank_l",), rate[:, None], force[:, None])
    true = SensorStart(SWAY.poses(VIEWS[:1])[0], SWAY.velocities(VIEWS[:1])[0])
    (drawn,) = rough([true], start, rng)
    velocity = true.velocity + start.velocity * rng.standard_normal(3)
    empty = Projections(GEOMETRY, np.zeros((len(VIEWS), 24, 31), np.float32))
    return Scan(empty, read_out(exact, errors, rng), (replace(drawn, velocity=velocity),))


def test_it_is_what_drawn_sensors_do():
    """RMS of 60 sensors through the real integration, to 20 %: two standard deviations of it."""
    knee, squares = GEOMETRY.rotation_center()[None], []
    true = transforms.apply(
        RigidMotion.from_poses(VIEWS, SWAY.poses(VIEWS)).moved_from_reference, knee
    )
    for seed in range(60):
        motion = Rigid("shank_l")(scanned(SMALL, START, seed)).motion
        assert isinstance(motion, RigidMotion)
        squares.append(((motion.carry(knee) - true) ** 2).sum(-1).mean())
    expected = expected_drift(scanned(SMALL, START, 0), "shank_l", SensorPriors(SMALL, START))
    assert expected == pytest.approx(np.sqrt(np.mean(squares)), rel=0.2)


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
