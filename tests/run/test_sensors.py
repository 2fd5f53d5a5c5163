"""The sensors' settings become noise of the stated size."""

import numpy as np
import pytest

from legsim import config
from legsim.config import ImuConfig, NoiseConfig, SkinMountConfig, VibrationConfig, noise_keys
from legsim.core import resources
from legsim.core.errors import LegsimError
from legsim.imu import noise, simulation, strapdown
from legsim.imu.calibration import leveled
from legsim.imu.catalogue import load_sensor
from legsim.imu.errors import TERMS, SensorErrors
from legsim.imu.signals import ImuSignals
from legsim.imu.skin_mount import SkinMount
from legsim.imu.vibration import Vibration
from legsim.kinematics.leg_model import LegModel
from legsim.kinematics.moving_leg import MovingLeg
from legsim.run import sensors
from tests.examples.squat import mirrored, squatting
from tests.examples.sway_of_joints import swaying
from tests.references.sway import Sway


def signals(count: int = 60) -> ImuSignals:
    rate, force = Sway.standing(0).signals(np.arange(count) / 120)
    return ImuSignals(np.arange(count) / 120, ("shank_l",), rate[:, None], force[:, None])


@pytest.mark.parametrize(
    ("settings", "force_rms", "turn_rms_deg"),
    [
        (NoiseConfig(kind="density"), 180e-6 * 9.80665 * np.sqrt(60), 0.007 * np.sqrt(60)),
        (NoiseConfig(kind="rms"), 1.8e-3 * 9.80665 * np.sqrt(0.6), 0.07 * np.sqrt(0.6)),
        (NoiseConfig(kind="paper", f_a=1, f_g=2), 1.8e-4 * 9.80665, 0.07e-2),
        (NoiseConfig(kind="paper", f_a="none", f_g=0), 0.0, 0.07),
        (
            NoiseConfig(kind="paper", f_a=0, f_g=0, convention="per-sample"),
            1.8e-3 * 9.80665 * 31**2,
            0.07 * 120,
        ),
    ],
)
def test_noise_is_as_large_as_it_says(settings: NoiseConfig, force_rms: float, turn_rms_deg: float):
    clean = signals(40000)
    noisy = sensors.noisy(
        clean, ImuConfig(noise=settings), view_rate_hz=31.0, rng=np.random.default_rng(0)
    )
    assert (noisy.specific_force - clean.specific_force).std() == pytest.approx(force_rms, rel=0.02)
    assert np.degrees((noisy.angular_velocity - clean.angular_velocity).std()) == pytest.approx(
        turn_rms_deg, rel=0.02
    )


def test_clean_sensors_are_left_and_one_seed_gives_one_noise():
    given = signals()
    assert (
        sensors.noisy(given, ImuConfig(), view_rate_hz=31.0, rng=np.random.default_rng(0)) is given
    )
    settings = ImuConfig(noise=NoiseConfig(kind="rms", acceleration_bias_mg=3))
    first, again = (
        sensors.noisy(signals(), settings, view_rate_hz=31.0, rng=np.random.default_rng(5))
        for _ in range(2)
    )
    np.testing.assert_array_equal(first.specific_force, again.specific_force)


def test_the_sentence_names_size_and_convention():
    assert (
        sensors.noise_sentence(ImuConfig(), view_rate_hz=31.0) == "IMU signals are free of noise."
    )
    sentence = sensors.noise_sentence(
        ImuConfig(noise=NoiseConfig(kind="paper", f_a=2, f_g=3, convention="per-sample")),
        view_rate_hz=31.0,
    )
    assert "per-sample convention" in sentence
    assert "f_a = 2.0, f_g = 3.0" in sentence
    rms = noise.ImuNoise.paper(
        acceleration_exponent=2, angular_velocity_exponent=3, convention="per-sample"
    ).sample_rms(120)[0]
    assert f"{rms:.3g} m/s^2" in sentence


@pytest.fixture(scope="module")
def person() -> MovingLeg:
    return squatting()


def imu(*overrides: str, side: str = "left") -> ImuConfig:
    texts = (*(f"imu.{text}" for text in overrides), f"scan.side={side}")
    return config.load_settings(overrides=texts).imu


def recorded(person: MovingLeg, settings: ImuConfig, seed: int = 0) -> ImuSignals:
    rng = np.random.default_rng(seed)
    first = float(person.trajectories.times[0])
    return sensors.record(person, settings, view_rate_hz=31.0, rest_at=first, rng=rng)


def test_a_sensor_is_selected_by_name_or_path_and_its_terms_are_changed(tmp_path):
    assert sensors.errors_of(imu("noise.kind=bmi160").noise) == load_sensor("bmi160").errors
    own = tmp_path / "own.toml"
    own.write_bytes(resources.model_file("sensors/bmi270.toml").read_bytes())
    changed = sensors.errors_of(
        imu(
            f"noise.kind={own}",
            "noise.accelerometer.turn_on_bias_mg=1",
            "noise.gyroscope.filter_order=4",
            "noise.off=['quantisation', 'g-sensitivity']",
        ).noise
    )
    assert changed is not None
    base = load_sensor("bmi270").errors
    assert changed.accelerometer.turn_on_bias == pytest.approx(9.80665e-3)
    assert changed.accelerometer.noise_density == base.accelerometer.noise_density
    assert (changed.gyroscope.filter_order, changed.gyroscope.bits) == (4, 0)
    assert changed.gyroscope.g_sensitivity == 0
    assert sensors.errors_of(imu("noise.kind=custom").noise) == SensorErrors()


@pytest.mark.parametrize(
    ("overrides", "problem"),
    [
        (("noise.kind=bmi161",), r"imu.noise.kind: unknown sensor.*bmi160.*or one of none, custom"),
        (("noise.kind=bmi160", "noise.off=['noise']"), "imu.noise: unknown error term 'noise'"),
        (("noise.calibration=rest",), "imu.noise.calibration has no effect with .*'none'"),
        (("noise.kind=rms", "noise.off=['scale']"), "imu.noise.off has no effect"),
        (("noise.kind=bmi160", "noise.acceleration_bias_mg=3"), "set turn_on_bias_mg"),
        (("noise.acceleration_bias_mg=3",), "has no effect .*'none'; leave it out, or set the kin"),
        (("noise.angular_velocity_bias_deg_per_s=3",), "kind to density or rms or paper"),
        (("noise.acceleration_mg=50",), "leave it out, or set the kind to rms"),
        (("noise.f_a=2",), "or set the kind to paper"),
        (("noise.kind=bmi160", "noise.acceleration_mg=50"), "or set the kind to rms"),
        (("noise.kind=rms", "noise.acceleration_ug_per_sqrt_hz=9"), "set the kind to density"),
        (("noise.kind=custom", "noise.gyroscope.bits=16"), "needs its full scale"),
        (("noise.kind=custom", "noise.temperature_course=[[1,0],[1,0]]"), "must increase"),
    ],
)
def test_settings_that_say_nothing_are_refused_before_the_run(overrides: tuple, problem: str):
    with pytest.raises(LegsimError, match=problem) as error:
        sensors.check(imu(*overrides))
    assert "\n" not in str(error.value)


def test_all_terms_off_record_todays_exact_signals_to_the_last_digit(person):
    exact = simulation.simulate_imu(person, sensors.sensors(ImuConfig()))
    for settings in (
        imu(),
        imu("noise.kind=custom"),
        imu("noise.kind=bmi160", f"noise.off={[*TERMS]}"),
    ):
        read = recorded(person, settings)
        for name in ("times", "angular_velocity", "specific_force"):
            np.testing.assert_array_equal(getattr(read, name), getattr(exact, name))


@pytest.mark.parametrize("kind", ["density", "rms", "paper"])
def test_white_kinds_record_the_draws_of_their_generator(person, kind: str):
    settings = imu(f"noise.kind={kind}", "noise.acceleration_bias_mg=2")
    built = sensors.noise_of(settings.noise, imu_rate_hz=120.0, view_rate_hz=31.0)
    assert built is not None
    exact = simulation.simulate_imu(person, sensors.sensors(settings))
    expected = noise.add_noise(exact, built, np.random.default_rng(4))
    read = recorded(person, settings, seed=4)
    np.testing.assert_array_equal(read.specific_force, expected.specific_force)
    np.testing.assert_array_equal(read.angular_velocity, expected.angular_velocity)


def test_a_sensor_with_a_low_pass_has_the_files_rate_and_one_seed_one_reading(person):
    settings = imu("noise.kind=bmi160", "noise.calibration=rest", "noise.rest_s=2")
    first, again, other = (recorded(person, settings, seed) for seed in (0, 0, 1))
    exact = sensors.sense(person, settings)
    np.testing.assert_allclose(first.times, exact.times, atol=1e-9)
    np.testing.assert_array_equal(first.specific_force, again.specific_force)
    assert (first.specific_force != other.specific_force).any()
    assert first.rest_force is not None
    assert first.sensors == exact.sensors or first.sensor_names == exact.sensor_names


def test_a_leveled_start_undoes_the_accelerometers_horizontal_bias(person):
    settings = imu(
        *("noise.kind=custom", "noise.accelerometer.turn_on_bias_mg=20"),
        *("noise.calibration=rest", "noise.rest_s=0.5"),
    )
    read = recorded(person, settings)
    assert read.rest_force is not None
    times = person.trajectories.times
    views = np.arange(times[0], times[-1] - 0.01, 1 / 31)
    start = simulation.true_start(person.leg, person.splines, read.sensors[0], float(views[0]))
    truth = simulation.sensor_poses(person.leg, person.splines, read.sensors, views)
    away = {}
    for what, chosen in (("exact", start), ("level", leveled(start, read.rest_force[0]))):
        poses = strapdown.integrate(*read.samples(read.sensor_names[0]), chosen, views)
        away[what] = np.abs((poses - truth.world_from_segment[:, 0])[-1, [0, 2], 3]).max()
    # what is left of 20 mg over the scan is its change as the leg turns
    assert away["level"] < 0.1 * away["exact"]


def test_names_with_slashes_several_sensors_and_the_right_leg(person):
    settings = imu("noise.kind=mti300", "lost_share=0.02", side="right")
    assert [s.name for s in settings.sensors] == ["shank_r", "thigh_r"]
    odd = settings.model_copy(
        update={
            "sensors": tuple(
                s.model_copy(update={"name": f"left/{k} [b], ü"})
                for k, s in enumerate((*settings.sensors, settings.sensors[0]))
            )
        }
    )
    read = recorded(mirrored(person), odd)
    assert read.sensor_names == ("left/0 [b], ü", "left/1 [b], ü", "left/2 [b], ü")
    # two sensors at one place err differently
    assert np.nanmax(np.abs(read.specific_force[:, 0] - read.specific_force[:, 2])) > 1e-3
    gone = np.isnan(read.specific_force).all(-1)
    assert 0 < gone.mean() < 0.1


def test_a_clock_that_drifts_takes_other_samples_and_stamps_them_evenly(person):
    drifting = recorded(person, imu("clock_drift_ppm=500", "clock_offset_s=0.1"))
    exact = recorded(person, imu())
    np.testing.assert_allclose(np.diff(drifting.times), 1 / 120, atol=1e-9)
    assert drifting.times[0] == pytest.approx(exact.times[0] + 0.1)
    np.testing.assert_array_equal(drifting.specific_force[0], exact.specific_force[0])
    assert (drifting.specific_force[20] != exact.specific_force[20]).any()


def test_a_slow_sensor_is_recorded_at_its_rate(person):
    slow = recorded(person, imu("rate_hz=10", "noise.kind=bmi160"))
    assert len(slow.times) == np.floor(np.ptp(person.trajectories.times) * 10 + 1e-6) + 1
    assert slow.times[1] - slow.times[0] == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (("noise.kind=bmi160", "noise.off=['scale']"), "errors of the BMI160 without scale"),
        (("noise.kind=custom", "noise.calibration=rest"), "A rest of 10 s before the scan"),
        (("noise.kind=bmi270", "noise.calibration=six-positions"), "Six positions of 10 s"),
        (("rate_hz=20",), "take 20 samples per second, fewer than the 31 views"),
        (("clock_drift_ppm=40", "lost_share=0.01"), "drifts by 40 ppm. 1 % of the samples"),
    ],
)
def test_the_sentence_says_which_errors_and_calibration(overrides: tuple, words: str):
    assert words in sensors.noise_sentence(imu(*overrides), view_rate_hz=31.0)


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (
            ("noise.kind=bmi160",),
            " Of its numbers 7 unverified, 10 from secondary sources, 4 missing, whose ",
        ),
        (("noise.kind=bmi160", "noise.off=['temperature', 'g-sensitivity']"), "4 unverified, 8"),
        (("noise.kind=bmi160", "noise.gyroscope.misalignment_percent=1"), "6 unverified, 10"),
        (
            ("noise.kind=adis16505",),
            "2 from secondary sources, 14 missing, whose errors are taken for ",
        ),
        (("noise.kind=lsm6dsv",), " Of its numbers 10 missing, whose errors are taken for zero: "),
    ],
)
def test_the_sentence_counts_what_no_page_of_the_data_sheet_confirms(overrides: tuple, words: str):
    said = sensors.noise_sentence(imu(*overrides), view_rate_hz=31.0)
    assert words in said
    assert said.endswith(f"`legsim sensors {imu(*overrides).noise.kind}` lists them.")


@pytest.mark.parametrize("kind", ["custom", "none", "rms"])
def test_the_sentence_leaves_out_what_there_is_nothing_to_say_of(kind: str):
    said = sensors.noise_sentence(imu(f"noise.kind={kind}"), view_rate_hz=31.0)
    assert "Of its numbers" not in said


def test_a_changed_file_changes_the_fingerprint(tmp_path):
    own = tmp_path / "own.toml"
    text = resources.model_file("sensors/bmi160.toml").read_text("utf-8")
    own.write_text(text, "utf-8")
    before = sensors.fingerprint(imu(f"noise.kind={own}"))
    own.write_text(text.replace("value = 180,", "value = 181,"), "utf-8")
    assert sensors.fingerprint(imu(f"noise.kind={own}")) != before


@pytest.fixture(scope="module")
def swayer() -> MovingLeg:
    leg = LegModel.load()
    return MovingLeg("sway", leg, swaying(leg, size=0.05), None)


def test_settings_of_one_sensor_take_the_place_of_those_of_all(swayer: MovingLeg):
    """Mount and vibration, in SI: the shank's own are off, the thigh has what all have."""
    shank, thigh = ImuConfig().sensors
    calm = shank.model_copy(
        update={"soft_tissue": SkinMountConfig(), "vibration": VibrationConfig()}
    )
    for_all = ImuConfig(
        soft_tissue=SkinMountConfig(amplitude=0.8, turn_amplitude=0.5, axes=(1, 0, 1)),
        vibration=VibrationConfig(acceleration_mg=3, angular_velocity_deg_per_s=0.5),
        sensors=(calm, thigh),
    )
    rigid = sensors.sense(swayer, ImuConfig())
    felt = sensors.sense(swayer, for_all, shaking=np.random.default_rng(1))
    mount = SkinMount(10.0, 0.25, 0.8, (1, 0, 1), 0.5)
    shake = Vibration(3e-3 * 9.80665, rate=float(np.radians(0.5)))
    expected = simulation.simulate_imu(
        swayer,
        skin_mount=[None, mount],
        vibration=[None, shake],
        rng=np.random.default_rng(1),
    )
    for name in ("specific_force", "angular_velocity"):
        read = getattr(felt, name)
        np.testing.assert_array_equal(read[:, 0], getattr(rigid, name)[:, 0])
        np.testing.assert_array_equal(read, getattr(expected, name))
    assert sensors.vibrate(for_all)
    assert not sensors.vibrate(ImuConfig())


def test_the_report_names_the_sensors_that_skin_moves():
    assert sensors.skin_sentences(ImuConfig()) == ()
    shank, thigh = ImuConfig().sensors
    own = thigh.model_copy(update={"vibration": VibrationConfig(acceleration_mg=3)})
    swings, shakes = sensors.skin_sentences(
        ImuConfig(soft_tissue=SkinMountConfig(turn_amplitude=1), sensors=(shank, own))
    )
    assert swings == "Sensors swing on soft tissue: shank_l, thigh_l."
    assert "thigh_l by 3 mg and 0 deg/s RMS" in shakes
    assert "shank" not in shakes


def test_methods_know_the_data_sheet_and_after_a_rest_a_better_gyroscope():
    """10 s of white noise leave density / sqrt(20) of the bias."""

    def known(**noise_settings) -> SensorErrors:
        imu = ImuConfig(noise=NoiseConfig(**noise_settings))
        return sensors.prior_errors(imu, view_rate_hz=31)

    sheet = load_sensor("bmi160").errors
    assert known(kind="bmi160") == sheet
    assert known() == SensorErrors()
    rested = known(kind="bmi160", calibration="rest")
    assert rested.accelerometer == sheet.accelerometer
    left = sheet.gyroscope.noise_density / np.sqrt(20)
    assert rested.gyroscope.turn_on_bias == pytest.approx(left)
    placed = known(kind="bmi160", calibration="six-positions")
    assert placed.gyroscope == rested.gyroscope
    left = sheet.accelerometer.noise_density / np.sqrt(20)
    assert placed.accelerometer.turn_on_bias == pytest.approx(left)
    assert placed.accelerometer.scale_error == placed.accelerometer.misalignment == 0
    assert placed.accelerometer.instability == sheet.accelerometer.instability
    course = ((0.0, 0.0), (10.0, 5.0))
    warm = known(kind="bmi160", calibration="six-positions", temperature_course=course)
    assert warm.accelerometer.bias_per_kelvin == sheet.accelerometer.bias_per_kelvin
    assert placed.accelerometer.bias_per_kelvin == 0
    white = known(kind="density", acceleration_bias_mg=2.0)
    assert white.accelerometer.turn_on_bias == pytest.approx(2e-3 * 9.80665)
    assert white.accelerometer.noise_density == pytest.approx(180e-6 * 9.80665)


@pytest.mark.parametrize("kind", ["none", "density", "rms", "paper", "custom", "bmi160"])
def test_every_key_of_noise_is_read_or_refused(kind: str):
    """What a kind does not read is refused where it is changed; what it reads is not."""
    values = {
        "f_a": "2", "f_g": "2", "convention": "per-sample", "off": "['scale']",
        "temperature_course": "[[0,1],[1,2]]", "calibration": "rest",
        "accelerometer": "{turn_on_bias_mg=1}", "gyroscope": "{turn_on_bias_deg_per_s=1}",
    }  # fmt: skip
    for key in NoiseConfig.model_fields.keys() - {"kind"}:
        given = imu(f"noise.kind={kind}", f"noise.{key}={values.get(key, '5')}")
        if key in noise_keys(kind):
            sensors.check(given)
        else:
            with pytest.raises(LegsimError, match=f"imu.noise.{key} has no effect"):
                sensors.check(given)
