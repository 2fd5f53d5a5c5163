"""What recordings lost, by their times and by readings that stand still."""

import re
from dataclasses import replace

import numpy as np
import pytest

from legsim.imu import losses, same_times
from legsim.imu.losses import gap_note
from legsim.imu.recording import ImuRecording
from tests.examples.sensors import still, swaying


def held_note(one: ImuRecording) -> tuple[str, ...]:
    return losses.held_note(one.name, one.times, one.readings)


def of_samples(one: ImuRecording, kept: np.ndarray, *, force_alone: bool = False) -> ImuRecording:
    """The readings of the samples ``kept`` at the times of all."""
    rate = one.angular_velocity if force_alone else one.angular_velocity[kept]
    return replace(one, specific_force=one.specific_force[kept], angular_velocity=rate)


def test_a_gap_of_any_length_is_counted():
    (note,) = gap_note("shank", np.array([0.0, 0.01, 0.02, 0.03, 1e25]))
    assert note.startswith("Sensor shank: 1000000000000000")
    assert not gap_note("shank", 0.01 * np.arange(5))


def test_a_late_sample_is_none_lost():
    times = np.arange(200) / 100
    times[50] += 0.0065
    assert gap_note("shank", times) == ()
    assert "1 of 200 samples are missing" in gap_note("shank", np.delete(times, 120))[0]
    assert "2 of 200 samples are missing" in gap_note("shank", np.delete(times, [120, 122]))[0]


def test_readings_that_stand_still_are_noted_and_coarse_ones_are_not():
    one = still(count=1000)
    held = np.array(one.specific_force), np.array(one.angular_velocity)
    for values in held:
        values[300:400] = values[299]
    (note,) = held_note(replace(one, specific_force=held[0], angular_velocity=held[1]))
    assert note.startswith("Sensor shank: 100 of 1000 samples repeat all readings")
    assert held_note(one) == ()
    # at rest a digit wider than the noise repeats often
    coarse = replace(
        one,
        specific_force=np.round(one.specific_force / 0.1) * 0.1,
        angular_velocity=np.round(one.angular_velocity / 0.01) * 0.01,
    )
    assert held_note(coarse) == ()


def test_rest_in_coarse_digits_before_a_movement_is_not_held():
    """Readings repeat at rest and never in the movement: chance is that of the rest."""
    rng = np.random.default_rng(0)
    count, at_rest = 6000, np.arange(6000) < 600
    moving = np.where(at_rest, 0.0, 1.0)[:, None] * rng.normal(0, 1, (count, 6))
    read = moving + np.r_[0.002 * 9.81 * np.ones(3), np.radians(0.25) * np.ones(3)] * rng.normal(
        size=(count, 6)
    )
    digits = np.r_[0.01 * 9.81 * np.ones(3), np.radians(1.0) * np.ones(3)]
    read = digits * np.round(read / digits)
    one = ImuRecording("shank", np.arange(count) / 60, read[:, 3:], read[:, :3] + [0, 9.81, 0])
    assert held_note(one) == ()


@pytest.mark.parametrize(
    ("own_hz", "read_hz"), [(50, 100), (20, 100), (50, 60), (148, 2000), (100, 148), (90, 100)]
)
def test_a_sensor_that_is_read_faster_than_it_measures_is_noted(own_hz, read_hz):
    one = still(count=2000, rate_hz=read_hz)
    kept = np.floor(one.times * own_hz + 0.3).astype(int)
    (note,) = held_note(of_samples(one, kept))
    assert re.search(r"its readings change (\S+) times per second, evenly", note)
    assert float(note.split()[5]) == pytest.approx(own_hz, rel=5e-3)
    assert f"are there at {read_hz:.3g} Hz" in note
    (note,) = held_note(of_samples(one, kept, force_alone=True))
    assert "its accelerations change" in note


@pytest.mark.parametrize("share", [0.05, 0.2, 0.5, 0.9])
def test_repeats_at_random_are_at_no_beat(share):
    rng = np.random.default_rng(2)
    one = still(count=2000)
    new = np.where(rng.random(2000) < share, 0, np.arange(2000))
    assert "evenly" not in str(held_note(of_samples(one, np.maximum.accumulate(new))))


def test_left_out_and_held_samples_are_described_alike():
    one, gone = still(count=1000), np.r_[300:310, 500:540]
    (left_out,) = gap_note("shank", np.delete(one.times, gone))
    (held,) = held_note(
        of_samples(one, np.maximum.accumulate(np.where(np.isin(np.arange(1000), gone), 0,
                                                       np.arange(1000))))
    )  # fmt: skip
    assert left_out.startswith("Sensor shank: 50 of 1000 samples are missing")
    assert held.startswith("Sensor shank: 50 of 1000 samples repeat")
    assert left_out.endswith("410 ms at 4.990 s; nothing is known of the motion within it.")
    assert held.endswith("410 ms at 4.990 s; nothing is known of the motion within it.")


def test_readings_at_the_end_of_the_range_are_in_doubt(rng):
    one = still(count=2000)
    swing = 10 * np.sin(2 * np.pi * 0.7 * one.times)[:, None] * [1.0, 0.3, 0.1]
    digit = np.radians(0.06)
    read = np.round((one.angular_velocity + swing) / digit) * digit
    cut = np.clip(read, -np.radians(500), np.radians(500))
    (note,) = losses.clipped_note("shank", replace(one, angular_velocity=cut).readings)
    assert note.startswith("In doubt: sensor shank stays at 500 deg/s of angular velocity in ")
    assert losses.clipped_note("shank", replace(one, angular_velocity=read).readings) == ()
    # coarse digits at rest, and a smooth peak that stays within a digit, are no end of a range
    coarse = replace(one, specific_force=np.round(one.specific_force / 0.05) * 0.05)
    assert losses.clipped_note("shank", coarse.readings) == ()
    slow = np.round(np.sin(0.02 * np.arange(2000))[:, None] * [5.0, 1.0, 1.0] / 0.1) * 0.1
    assert losses.clipped_note("shank", replace(one, angular_velocity=slow).readings) == ()


def test_readings_that_are_held_at_a_beat_are_no_end_of_a_range():
    """An accelerometer of 25 Hz that is logged at 100 Hz repeats its greatest reading."""
    one = still(count=2000)
    swing = 25 * np.sin(2 * np.pi * 0.7 * one.times)[:, None] * [1.0, 0.3, 0.1]
    held = (one.specific_force + swing)[np.arange(2000) // 4 * 4]
    assert losses.clipped_note("shank", replace(one, specific_force=held).readings) == ()
    (note,) = losses.clipped_note(
        "shank", replace(one, specific_force=np.clip(held, -16.0, 16.0)).readings
    )
    assert "stays at 16 m/s2 of acceleration" in note


@pytest.mark.parametrize(
    ("rate_hz", "digit"),
    [(75, 0.01), (148.15, 0.01), (833, 0.001), (42, 0.01), (90.9, 0.01), (140, 0.01), (70, 0.01)],
)
def test_steps_of_rounded_times_are_no_loss_and_real_gaps_among_them_are(rate_hz, digit):
    exact = 7.003 + np.arange(4000) / rate_hz
    for rounded in (np.round, np.floor):
        times = digit * rounded(exact / digit)
        assert gap_note("shank", same_times.spread(times)[0]) == ()
        lost = np.delete(times, np.r_[1500:1530, 3000:3060])
        (note,) = gap_note("shank", same_times.spread(lost)[0])
        missing = int(note.split()[2])
        assert missing == pytest.approx(90, abs=2)


@pytest.mark.parametrize("share", [0.003, 0.02, 0.1, 0.3])
def test_samples_lost_at_random_are_counted_whatever_their_share(rng, share):
    times = np.arange(4000) / 100
    kept = times[rng.random(4000) > share]
    (note,) = gap_note("shank", kept)
    assert int(note.split()[2]) == round(100 * float(kept[-1] - kept[0])) + 1 - len(kept)


def test_instruments_that_end_apart_are_in_doubt():
    times = np.arange(1000) / 100
    assert losses.ends_note("a", times, times[:-40]) == ()
    (note,) = losses.ends_note("a", times[:500], times)
    assert "its angular velocities end 5 s before its accelerations" in note
    (note,) = losses.ends_note("a", times, times[:500])
    assert "its accelerations end 5 s before its angular velocities" in note


@pytest.mark.parametrize("value", [None, 0.0])
def test_one_instrument_that_stands_still_while_the_other_goes_on_is_noted(value):
    """A gyroscope that was lost is written as the last reading, or as 0, 0, 0."""
    one = swaying(seconds=20.0, lean=0.3)
    rate = one.angular_velocity.copy()
    rate[900:950] = rate[899] if value is None else value
    (note,) = held_note(replace(one, angular_velocity=rate))
    assert "samples repeat the angular velocities of the one before" in note
    assert "nothing is known" not in note
    assert "510 ms at 8.9" in note or "500 ms at 9.0" in note
    digits = np.round(rate / 0.005) * 0.005
    assert len(held_note(replace(one, angular_velocity=digits))) == 1
    # at rest digits as coarse as a sensor's noise repeat by chance, and a loss costs nothing
    calm = still(count=2000)
    coarse = replace(calm, angular_velocity=np.round(calm.angular_velocity / 0.004) * 0.004)
    assert held_note(coarse) == ()


def test_one_instrument_of_coarse_digits_in_a_slow_motion_is_not_held(rng):
    """Its readings stay for long, and go on by a digit."""
    times = np.arange(3000) / 100
    noise = rng.normal(size=(3000, 3))
    digit = np.radians(0.5)
    coarse = np.round(0.1 * digit * noise / digit + 0.3) * digit
    coarse += digit * np.round(2 * np.sin(0.8 * times))[:, None]
    pushed = [0, 0, 9.8] + np.sin(2 * np.pi * 0.4 * times)[:, None] * [0.9, 0.7, 0.5] + 0.02 * noise
    assert held_note(ImuRecording("a", times, coarse, pushed)) == ()
    step = 9.80665 / 128
    tilt = np.radians(20) * np.sin(2 * np.pi * 0.05 * times)
    felt = 9.80665 * np.stack([np.sin(tilt), 0 * tilt, np.cos(tilt)], -1)
    turning = 0.3 * np.sin(2 * np.pi * 0.5 * times)[:, None] * [0, 0.2, 1] + 0.002 * noise
    assert held_note(ImuRecording("a", times, turning, np.round(felt / step) * step)) == ()
