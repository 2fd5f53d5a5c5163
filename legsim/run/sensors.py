"""The configured sensors and their errors, in SI units."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from legsim import config
from legsim.config import WHITE, ImuConfig, NoiseConfig, noise_keys
from legsim.config.measured_scan import ExpectedErrorsConfig
from legsim.core import transforms
from legsim.core.constants import GRAVITY_WORLD, STANDARD_GRAVITY
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.imu import catalogue, clock, readout, simulation
from legsim.imu.calibration import Calibration
from legsim.imu.errors import TERMS, SensorErrors, TemperatureCourse, TriadErrors
from legsim.imu.noise import ImuNoise, add_noise
from legsim.imu.sensors import Sensor
from legsim.imu.signals import ImuSignals
from legsim.imu.simulation import simulate_imu
from legsim.imu.skin_mount import SkinMount
from legsim.imu.vibration import Vibration
from legsim.kinematics.moving_leg import MovingLeg


def sensors(settings: ImuConfig) -> tuple[Sensor, ...]:
    """Builds the configured sensors in SI units."""
    return tuple(
        Sensor(
            s.name,
            s.segment,
            1e-3 * s.distance_mm,
            1e-3 * np.array(s.offset_mm),
            transforms.rotation_from_vector(np.radians(s.rotation_deg)),
        )
        for s in settings.sensors
    )


def skin_mount(settings: config.SoftTissueConfig) -> SkinMount:
    """Builds the configured oscillator between a bone and what is attached to it."""
    return SkinMount(settings.frequency_hz, settings.damping, settings.amplitude)


def check(settings: ImuConfig) -> None:
    """Refuses, before anything is computed, errors that no sensor has and settings without effect.

    Raises:
        LegsimError: an unknown kind or term, or a key that this kind does not read.
    """
    noise = settings.noise
    errors_of(noise)
    _course(noise)
    default, read = NoiseConfig(), noise_keys(noise.kind)
    for key in sorted(NoiseConfig.model_fields.keys() - read - {"kind"}):
        if getattr(noise, key) != getattr(default, key):
            raise LegsimError(
                f"imu.noise.{key} has no effect with imu.noise.kind = {noise.kind!r}; "
                f"{_instead(key, noise.kind)}"
            )


def _instead(key: str, kind: str) -> str:
    """What to do about a key that the kind does not read."""
    readers = [white for white, keys in WHITE.items() if key in keys]
    if not readers:
        return "set the kind to custom, or to a sensor (legsim sensors lists them)"
    if kind in ("none", *WHITE) or len(readers) < len(WHITE):
        return f"leave it out, or set the kind to {' or '.join(readers)}"
    return (
        "set turn_on_bias_mg of imu.noise.accelerometer, or turn_on_bias_deg_per_s of "
        "imu.noise.gyroscope"
    )


def errors_of(settings: NoiseConfig) -> SensorErrors | None:
    """Builds the configured sensor's errors; None for kinds that are white noise, and for none.

    Raises:
        LegsimError: an unknown kind, sensor or term.
    """
    if settings.kind in ("none", *WHITE):
        return None
    try:
        base = (
            SensorErrors()
            if settings.kind == "custom"
            else catalogue.load_sensor(settings.kind).errors
        )
        return changed(base, settings)
    except LegsimError as error:
        raise LegsimError(
            f"imu.noise: {error}"
            if "unknown sensor" not in str(error)
            else f"imu.noise.kind: {error}; or one of none, custom, {', '.join(WHITE)}"
        ) from None


def changed(base: SensorErrors, settings: NoiseConfig | ExpectedErrorsConfig) -> SensorErrors:
    """A sensor's errors with single numbers changed, and terms switched off.

    Raises:
        LegsimError: an unknown term, or a size that no sensor has.
    """
    force, turn = (
        section.model_dump(exclude_none=True)
        for section in (settings.accelerometer, settings.gyroscope)
    )
    errors = SensorErrors(
        catalogue.in_si("accelerometer", force, base.accelerometer),
        catalogue.in_si("gyroscope", turn, base.gyroscope),
    )
    return errors.without(*settings.off)


def calibrated(
    errors: SensorErrors, settings: NoiseConfig | ExpectedErrorsConfig, *, warms: bool
) -> SensorErrors:
    """What a calibration before the scan leaves of the errors.

    After a rest the gyroscope's bias is known to what white noise leaves of the mean, and after six
    positions so is the accelerometer's, with its scale and axes. Warming up afterwards is not
    undone.
    """
    if settings.calibration == "none":
        return errors
    cold = [] if warms else ["temperature"]
    found = {"gyroscope": ["turn-on-bias", "g-sensitivity", *cold]}
    if settings.calibration == "six-positions":
        found["accelerometer"] = ["turn-on-bias", "scale", "misalignment", *cold]
    for triad, terms in found.items():
        rest = getattr(errors, triad).without(terms)
        left = rest.noise_density / float(np.sqrt(2 * settings.rest_s))
        errors = replace(errors, **{triad: replace(rest, turn_on_bias=left)})
    return errors


def prior_errors(settings: ImuConfig, *, view_rate_hz: float) -> SensorErrors:
    """What methods may know of the sensors' errors: the data sheet's, after the calibration."""
    errors = errors_of(settings.noise)
    if errors is not None:
        return calibrated(errors, settings.noise, warms=bool(settings.noise.temperature_course))
    noise = noise_of(settings.noise, imu_rate_hz=settings.rate_hz, view_rate_hz=view_rate_hz)
    if noise is None:
        return SensorErrors()
    return SensorErrors(
        TriadErrors(noise.acceleration_density, noise.acceleration_bias),
        TriadErrors(noise.angular_velocity_density, noise.angular_velocity_bias),
    )


def _course(settings: NoiseConfig) -> TemperatureCourse:
    if not settings.temperature_course:
        return TemperatureCourse()
    seconds, kelvin = zip(*settings.temperature_course, strict=True)
    return TemperatureCourse(seconds, kelvin)


def fingerprint(settings: ImuConfig) -> str:
    """Part of the key of the signals that changes with a sensor's own file."""
    return repr(errors_of(settings.noise))


def _mount(settings: config.SkinMountConfig) -> SkinMount:
    """Builds the configured hold of a sensor on the skin."""
    return replace(
        skin_mount(settings),
        axes=settings.axes,
        turn_amplitude=settings.turn_amplitude,
        turn_frequency_hz=settings.turn_frequency_hz,
        turn_axes=settings.turn_axes,
    )


def _vibration(settings: config.VibrationConfig) -> Vibration:
    return Vibration(
        1e-3 * STANDARD_GRAVITY * settings.acceleration_mg,
        settings.acceleration_band_hz,
        settings.acceleration_axes,
        float(np.radians(settings.angular_velocity_deg_per_s)),
        settings.angular_velocity_band_hz,
        settings.angular_velocity_axes,
    )


def _vibrations(settings: ImuConfig) -> list[Vibration]:
    """Builds the vibration of each sensor."""
    return [_vibration(s.vibration or settings.vibration) for s in settings.sensors]


def vibrate(settings: ImuConfig) -> bool:
    """Whether the signals before noise depend on the run's seed."""
    return any(vibration.moves for vibration in _vibrations(settings))


def skin_sentences(settings: ImuConfig) -> tuple[str, ...]:
    """Describes what skin and muscle do to the sensors; nothing where the bone holds them."""
    swinging = [
        s.name for s in settings.sensors if _mount(s.soft_tissue or settings.soft_tissue).moves
    ]
    shaken = [(s.name, s.vibration or settings.vibration) for s in settings.sensors]
    vibrating = [
        f"{name} by {v.acceleration_mg:g} mg and {v.angular_velocity_deg_per_s:g} deg/s RMS"
        for name, v in shaken
        if _vibration(v).moves
    ]
    sentences = []
    if swinging:
        sentences.append(f"Sensors swing on soft tissue: {', '.join(swinging)}.")
    if vibrating:
        sentences.append(f"Muscle and skin shake the sensors: {', '.join(vibrating)}.")
    return tuple(sentences)


def sense(
    person: MovingLeg,
    settings: ImuConfig,
    *,
    every: int = 1,
    shaking: np.random.Generator | None = None,
) -> ImuSignals:
    """Simulates the configured sensors without errors of their own; skin and clock are in.

    ``every`` times as many samples as configured; ``shaking`` draws the vibration.
    """
    return simulate_imu(
        person,
        sensors(settings),
        rate_hz=every * settings.rate_hz,
        skin_mount=[_mount(s.soft_tissue or settings.soft_tissue) for s in settings.sensors],
        vibration=_vibrations(settings),
        clock_offset=settings.clock_offset_s,
        clock_drift=1e-6 * settings.clock_drift_ppm,
        rng=shaking,
    )


def record(
    person: MovingLeg,
    settings: ImuConfig,
    *,
    view_rate_hz: float,
    rest_at: float,
    rng: np.random.Generator,
    shaking: np.random.Generator | None = None,
) -> ImuSignals:
    """Simulates what the files of the configured sensors hold.

    Args:
        person: who moves.
        settings: of the sensors.
        view_rate_hz: of the scan, which the paper's noise is counted in.
        rest_at: s in the recording's time; a calibration rests in the pose of that time.
        rng: decides the errors and the lost samples.
        shaking: draws the vibration of the skin.
    """
    (read,) = records(
        person, settings, view_rate_hz=view_rate_hz, rest_at=rest_at, rngs=[rng], shaking=shaking
    )
    return read


def records(
    person: MovingLeg,
    settings: ImuConfig,
    *,
    view_rate_hz: float,
    rest_at: float,
    rngs: Iterable[np.random.Generator],
    shaking: np.random.Generator | None = None,
) -> Iterator[ImuSignals]:
    """Simulates several draws of the same recording, one per random generator; see :func:`record`.

    The exact signals are computed once.
    """
    errors = errors_of(settings.noise)
    every = 1 if errors is None else readout.oversampling(errors, settings.rate_hz)
    felt = sense(person, settings, every=every, shaking=shaking)
    rest_force = _rest_force(person, settings, rest_at)
    for rng in rngs:
        if errors is None:
            read = noisy(felt, settings, view_rate_hz=view_rate_hz, rng=rng)
        else:
            read = readout.read_out(
                felt,
                errors,
                rng,
                every=every,
                temperature=_course(settings.noise),
                calibration=Calibration(settings.noise.calibration, settings.noise.rest_s),
                rest_force=rest_force,
            )
        if settings.lost_share:
            streams = tuple(rng.spawn(len(read.sensor_names)))
            read = clock.lose_samples(read, settings.lost_share, settings.lost, streams)
        yield read


def _rest_force(person: MovingLeg, settings: ImuConfig, rest_at: float) -> FloatArray | None:
    """True specific force (k, 3) of each sensor at rest in the pose of one time."""
    if settings.noise.calibration == "none":
        return None
    placed = sensors(settings)
    poses = simulation.sensor_poses(person.leg, person.splines, placed, [rest_at])
    return -np.einsum("kji,j->ki", poses.world_from_segment[0, :, :3, :3], GRAVITY_WORLD)


def noise_of(settings: NoiseConfig, *, imu_rate_hz: float, view_rate_hz: float) -> ImuNoise | None:
    """Builds the configured white noise; None for every other kind."""
    if settings.kind not in WHITE:
        return None
    if settings.kind == "density":
        plain = ImuNoise.from_density(
            acceleration_ug_per_sqrt_hz=settings.acceleration_ug_per_sqrt_hz,
            angular_velocity_deg_per_s_per_sqrt_hz=settings.angular_velocity_deg_per_s_per_sqrt_hz,
        )
    elif settings.kind == "rms":
        plain = ImuNoise.from_rms(
            acceleration_mg=settings.acceleration_mg,
            angular_velocity_deg_per_s=settings.angular_velocity_deg_per_s,
            bandwidth_hz=settings.bandwidth_hz,
        )
    else:
        plain = ImuNoise.paper(
            acceleration_exponent=None if settings.f_a == "none" else settings.f_a,
            angular_velocity_exponent=None if settings.f_g == "none" else settings.f_g,
            imu_rate_hz=imu_rate_hz,
            projection_rate_hz=view_rate_hz,
            convention=settings.convention,
        )
    return plain.with_bias(
        acceleration_mg=settings.acceleration_bias_mg,
        angular_velocity_deg_per_s=settings.angular_velocity_bias_deg_per_s,
    )


def noisy(
    signals: ImuSignals, settings: ImuConfig, *, view_rate_hz: float, rng: np.random.Generator
) -> ImuSignals:
    """Adds the configured white noise and bias to the signals."""
    noise = noise_of(settings.noise, imu_rate_hz=settings.rate_hz, view_rate_hz=view_rate_hz)
    return signals if noise is None else add_noise(signals, noise, rng)


def noise_sentence(settings: ImuConfig, *, view_rate_hz: float) -> str:
    """Describes the sensors' errors, white noise in SI units on single samples."""
    recorder = _recorder_sentences(settings, view_rate_hz)
    return " ".join([_errors_sentence(settings, view_rate_hz), *recorder])


def _errors_sentence(settings: ImuConfig, view_rate_hz: float) -> str:
    errors = errors_of(settings.noise)
    if errors is not None:
        return _sensor_sentence(settings, errors)
    noise = noise_of(settings.noise, imu_rate_hz=settings.rate_hz, view_rate_hz=view_rate_hz)
    if noise is None:
        return "IMU signals are free of noise."
    force, turn = noise.sample_rms(settings.rate_hz)
    ladder = (
        f", f_a = {settings.noise.f_a}, f_g = {settings.noise.f_g}"
        if settings.noise.kind == "paper"
        else ""
    )
    return (
        f"IMU signals carry white noise ({settings.noise.kind}{ladder}; {noise.convention} "
        f"convention) of {force:.3g} m/s^2 and "
        f"{np.degrees(turn):.3g} deg/s RMS per sample, and biases of "
        f"{settings.noise.acceleration_bias_mg:g} mg and "
        f"{settings.noise.angular_velocity_bias_deg_per_s:g} deg/s between sensors."
    )


def _sensor_sentence(settings: ImuConfig, errors: SensorErrors) -> str:
    noise = settings.noise
    own = noise.kind == "custom"
    named = (
        "custom errors" if own else f"the errors of the {catalogue.load_sensor(noise.kind).name}"
    )
    off = f" without {', '.join(noise.off)}" if noise.off else ""
    force = errors.accelerometer.sample_rms(settings.rate_hz)
    turn = np.degrees(errors.gyroscope.sample_rms(settings.rate_hz))
    calibrated = {
        "none": "They are not calibrated before the scan.",
        "rest": (
            f"A rest of {noise.rest_s:g} s before the scan removes the gyroscope's bias and levels "
            "the start."
        ),
        "six-positions": (
            f"Six positions of {noise.rest_s:g} s calibrate the accelerometer's bias, scale and "
            "misalignment; a rest as long removes the gyroscope's bias and levels the start."
        ),
    }[noise.calibration]
    return (
        f"IMU signals carry {named}{off}: white noise of {force:.3g} m/s^2 and {turn:.3g} deg/s "
        f"RMS per sample, biases of {errors.accelerometer.turn_on_bias:.3g} m/s^2 and "
        f"{np.degrees(errors.gyroscope.turn_on_bias):.3g} deg/s at the start. {calibrated}"
        f"{_standing_sentence(noise)}"
    )


def _standing_sentence(noise: NoiseConfig) -> str:
    """Counts the sensor's numbers in use that no page of its data sheet confirms."""
    if noise.kind == "custom":
        return ""
    off = {field for term in noise.off for field in TERMS[term]}
    own: dict[catalogue.Triad, dict[str, object]] = {
        "accelerometer": noise.accelerometer.model_dump(exclude_none=True),
        "gyroscope": noise.gyroscope.model_dump(exclude_none=True),
    }
    used = [
        value
        for value in catalogue.load_sensor(noise.kind).values
        if value.key not in own[value.triad] and catalogue.field_of(value) not in off
    ]
    return unconfirmed_sentence(noise.kind, used)


def unconfirmed_sentence(sensor: str, values: Sequence[catalogue.DataSheetValue]) -> str:
    """Counts what of a sensor's numbers no page of its data sheet confirms, after a space."""
    standings = [value.standing for value in values]
    counted = {
        "unverified": "unverified",
        "secondary": "from secondary sources",
        "missing": "missing, whose errors are taken for zero",
    }
    found = [f"{n} {words}" for one, words in counted.items() if (n := standings.count(one))]
    if not found:
        return ""
    return f" Of its numbers {', '.join(found)}: `legsim sensors {sensor}` lists them."


def _recorder_sentences(settings: ImuConfig, view_rate_hz: float) -> list[str]:
    sentences = []
    if settings.rate_hz < view_rate_hz:
        sentences.append(
            f"They take {settings.rate_hz:g} samples per second, fewer than the {view_rate_hz:g} "
            "views: motion between samples is not seen."
        )
    if settings.clock_drift_ppm:
        sentences.append(f"Their clock drifts by {settings.clock_drift_ppm:g} ppm.")
    if settings.lost_share:
        instead = "left out" if settings.lost == "marked" else "replaced by the sample before"
        sentences.append(f"{100 * settings.lost_share:g} % of the samples are lost and {instead}.")
    return sentences
