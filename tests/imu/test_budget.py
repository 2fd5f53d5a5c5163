"""The linear budget against closed forms, and against draws through the real integration."""

import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.imu import strapdown
from legsim.imu.budget import (
    BUDGET_TERMS,
    START_TILT,
    BudgetConditions,
    BudgetLine,
    NominalMotion,
    PoseError,
    sensor_budget,
)
from legsim.imu.calibration import Calibration, leveled
from legsim.imu.errors import SensorErrors, TemperatureCourse, TriadErrors
from legsim.imu.readout import read_out
from legsim.imu.signals import ImuSignals, SensorStart

GRAVITY = 9.80665
UNTILTED = BudgetConditions(start_tilt=0.0)
MEMS = SensorErrors(
    TriadErrors(
        noise_density=180e-6 * GRAVITY,
        turn_on_bias=40e-3 * GRAVITY,
        instability=20e-6 * GRAVITY,
        random_walk=5e-6 * GRAVITY,
        scale_error=0.005,
        misalignment=0.01,
        bias_per_kelvin=1e-3 * GRAVITY,
        scale_per_kelvin=2e-4,
    ),
    TriadErrors(
        noise_density=np.radians(0.007),
        turn_on_bias=np.radians(0.5),
        instability=np.radians(5 / 3600),
        random_walk=np.radians(0.002),
        scale_error=0.01,
        misalignment=0.01,
        g_sensitivity=np.radians(0.1) / GRAVITY,
        bias_per_kelvin=np.radians(0.05),
        scale_per_kelvin=2e-4,
    ),
)


def line(
    errors: SensorErrors, motion: NominalMotion, given: BudgetConditions = UNTILTED
) -> PoseError:
    """The only line of a budget."""
    (found,) = sensor_budget(errors, motion, given)
    return found.error


def test_accelerometer_bias_is_half_a_t_squared():
    motion = NominalMotion.swaying(8.0, 100.0)
    found = line(SensorErrors(TriadErrors(turn_on_bias=0.01)), motion)
    assert found.translation_at_end == pytest.approx(np.sqrt(3) * 0.01 * 32, rel=1e-3)
    # mean of t^4 over the scan: a fifth
    assert found.translation == pytest.approx(np.sqrt(3 / 5) * 0.01 * 32, rel=2e-3)
    assert found.rotation == 0


def test_gyroscope_bias_tilts_gravity_with_the_third_power():
    motion = NominalMotion.swaying(6.0, 100.0)
    found = line(SensorErrors(gyroscope=TriadErrors(turn_on_bias=1e-4)), motion)
    # two horizontal axes tilt gravity: g w t^3 / 6
    assert found.translation_at_end == pytest.approx(np.sqrt(2) * GRAVITY * 1e-4 * 36, rel=1e-3)
    assert found.rotation_at_end == pytest.approx(np.sqrt(3) * 6e-4, rel=1e-3)


def test_white_noise_walks_as_its_double_integral():
    motion = NominalMotion.swaying(8.0, 120.0)
    found = line(SensorErrors(TriadErrors(noise_density=1e-3)), motion)
    # variance d^2 / 2 t^3 / 3 per axis
    assert found.translation_at_end == pytest.approx(np.sqrt(3 / 6 * 512) * 1e-3, rel=1e-2)
    # and its mean over the scan is a fourth
    assert found.translation == pytest.approx(np.sqrt(3 / 24 * 512) * 1e-3, rel=1e-2)


def test_start_tilt_is_gravity_across():
    motion = NominalMotion.swaying(8.0, 50.0)
    tilt = np.radians(0.1)
    (found,) = sensor_budget(SensorErrors(), motion, BudgetConditions(start_tilt=tilt))
    assert (found.term, found.triad) == (START_TILT, "")
    assert found.error.translation_at_end == pytest.approx(
        np.sqrt(2) * GRAVITY * tilt * 32, rel=1e-3
    )
    assert found.error.rotation == pytest.approx(np.sqrt(2) * tilt, rel=1e-6)


def test_terms_are_linear_in_their_size_and_add_up_in_squares():
    motion = NominalMotion.swaying(2.0, 50.0, angle=0.02)
    once = line(SensorErrors(TriadErrors(scale_error=0.01)), motion)
    twice = line(SensorErrors(TriadErrors(scale_error=0.02)), motion)
    assert twice.translation == pytest.approx(2 * once.translation)
    assert PoseError.together([once] * 4).translation == pytest.approx(2 * once.translation)


def test_rest_cancels_biases_and_the_level_start_the_horizontal_ones():
    motion = NominalMotion.swaying(4.0, 50.0)
    rest = BudgetConditions(calibration=Calibration("rest", 2.0))
    assert line(SensorErrors(gyroscope=TriadErrors(turn_on_bias=0.1)), motion, rest).translation < (
        1e-9
    )
    # what is left of an accelerometer's bias is its vertical part, and a tilt of bias / g
    left = line(SensorErrors(TriadErrors(turn_on_bias=0.1)), motion, rest)
    assert left.translation_at_end == pytest.approx(0.1 * 8, rel=1e-3)
    assert left.rotation == pytest.approx(np.sqrt(2) * 0.1 / GRAVITY, rel=1e-3)
    six = BudgetConditions(calibration=Calibration("six-positions", 2.0))
    everything = TriadErrors(turn_on_bias=0.1, scale_error=0.01, misalignment=0.01)
    for found in sensor_budget(SensorErrors(everything), motion, six):
        assert found.error.translation < 1e-9


def test_a_coarse_bit_without_noise_is_a_constant():
    motion = NominalMotion.swaying(4.0, 50.0)
    coarse = line(SensorErrors(TriadErrors(full_scale=20.0, bits=12)), motion)
    bias = line(SensorErrors(TriadErrors(turn_on_bias=40 / 4096 / np.sqrt(12))), motion)
    assert coarse.translation == pytest.approx(bias.translation)
    dithered = SensorErrors(TriadErrors(full_scale=20.0, bits=12, noise_density=1.0))
    rounding = next(
        found for found in sensor_budget(dithered, motion, UNTILTED) if found.term == "quantisation"
    )
    assert rounding.error.translation < 0.2 * coarse.translation


@pytest.mark.end_to_end
def test_all_terms_together_agree_with_draws_through_the_real_integration():
    plan, motion = Calibration("rest", 1.0), NominalMotion.swaying(3.0, 60.0, angle=0.02)
    lines = sensor_budget(MEMS, motion, BudgetConditions(start_tilt=0.0, calibration=plan))
    expected = PoseError.together([found.error for found in lines])
    drawn = monte_carlo(MEMS, motion, plan, 300)
    assert drawn.translation == pytest.approx(expected.translation, rel=0.1)
    assert drawn.rotation == pytest.approx(expected.rotation, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("calibration", ["none", "rest", "six-positions"])
def test_every_term_agrees_with_draws_through_the_real_integration(calibration: str):
    """Within 10 %: 300 draws of three axes leave 2 to 3 %, one axis 4 %."""
    plan = Calibration(calibration, 1.0)
    motion = NominalMotion.swaying(3.0, 60.0, angle=np.radians(1))
    given = BudgetConditions(temperature_change=1.0, start_tilt=0.0, calibration=plan)
    for budgeted in sensor_budget(MEMS, motion, given):
        alone = MEMS.only(budgeted.term)
        errors = SensorErrors(**{budgeted.triad: getattr(alone, budgeted.triad)})
        drawn = monte_carlo(errors, motion, plan, 300)
        for name, size in (("translation", 1e-6), ("rotation", 1e-7)):
            expected, found = getattr(budgeted.error, name), getattr(drawn, name)
            assert found == pytest.approx(expected, rel=0.1, abs=size), (budgeted, drawn)


def monte_carlo(
    errors: SensorErrors, motion: NominalMotion, plan: Calibration, draws: int
) -> PoseError:
    """Root of mean squares over draws of sensors, each read and integrated."""
    exact = SensorStart(transforms.rigid(motion.world_from_sensor[0], np.zeros(3)), np.zeros(3))
    names = tuple(f"sensor {k}" for k in range(draws))
    rate, force = (
        np.repeat(a[:, None], draws, 1) for a in (motion.angular_velocity, motion.specific_force)
    )
    rest = motion.world_from_sensor[0].T @ [0.0, GRAVITY, 0.0]
    # at the factory's temperature while it rests, one kelvin off during the scan
    warm = (
        TemperatureCourse((0.0,), (1.0,))
        if plan.kind == "none"
        else TemperatureCourse((0.0, 1e-9), (0.0, 1.0))
    )
    out = read_out(
        ImuSignals(motion.times, names, rate, force),
        errors,
        np.random.default_rng(0),
        temperature=warm,
        calibration=plan,
        rest_force=np.tile(rest, (draws, 1)),
    )
    squares, views = np.zeros(2), motion.times[::6]
    for k, name in enumerate(names):
        start = exact if out.rest_force is None else leveled(exact, out.rest_force[k])
        poses = strapdown.integrate(*out.samples(name), start, views)
        turned = poses[:, :3, :3] @ np.swapaxes(motion.world_from_sensor[::6], -1, -2)
        away = ((poses[:, :3, 3] ** 2).sum(-1), transforms.rotation_angle(turned) ** 2)
        squares += [np.trapezoid(a, views) / views[-1] for a in away]
    translation, rotation = np.sqrt(squares / draws)
    return PoseError(float(translation), float(rotation), 0.0, 0.0)


def test_a_swaying_sensor_is_its_own_integral():
    motion = NominalMotion.swaying(8.0, 120.0, angle=np.radians(2))
    start = SensorStart(transforms.rigid(motion.world_from_sensor[0], np.zeros(3)), np.zeros(3))
    poses = strapdown.integrate(
        motion.times, motion.angular_velocity, motion.specific_force, start, motion.times
    )
    np.testing.assert_allclose(poses[:, :3, :3], motion.world_from_sensor, atol=1e-8)
    np.testing.assert_allclose(poses[:, :3, 3], 0, atol=1e-6)


def test_lines_name_what_there_is_and_nothing_else():
    motion = NominalMotion.swaying(1.0, 50.0, angle=0.01)
    lines = sensor_budget(MEMS, motion)
    assert {found.triad for found in lines} == {"gyroscope", "accelerometer", ""}
    assert {found.term for found in lines} == {*BUDGET_TERMS, START_TILT} - {"quantisation"}
    assert all(isinstance(found, BudgetLine) for found in lines)
    cold = sensor_budget(MEMS, motion, BudgetConditions(temperature_change=0.0))
    assert "temperature" not in {found.term for found in cold}


def test_refuses_scans_that_are_none():
    for seconds, rate in ((0.0, 100.0), (8.0, -1.0), (float("nan"), 100.0)):
        with pytest.raises(LegsimError, match="give positive numbers"):
            NominalMotion.swaying(seconds, rate)
    with pytest.raises(LegsimError, match="at least 3 samples"):
        NominalMotion.swaying(0.01, 100.0)
