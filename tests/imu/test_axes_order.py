"""Columns in another order than the other instrument's are in doubt."""

from dataclasses import replace

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.imu.recording import check_plausible, checked
from tests.examples.sensors import still, swaying


@pytest.mark.parametrize(
    ("order", "signs", "said"),
    [
        ((1, 0, 2), (1, 1, 1), "(y, x, z)"),
        ((0, 1, 2), (1, -1, 1), "(x, -y, z)"),
        ((2, 0, 1), (1, 1, 1), "(y, z, x)"),
    ],
)
def test_a_gyroscope_in_another_order_is_in_doubt(order, signs, said):
    one = swaying(seconds=30.0)
    turned = one.angular_velocity[:, list(order)] * signs
    (note,) = checked(replace(one, angular_velocity=turned)).notes
    assert note.startswith("In doubt: sensor shank: gravity turns in its accelerometer as by its")
    assert f"with the axes {said} of it" in note
    assert "check the order and the signs" in note


def test_the_same_axes_and_noise_are_not():
    assert checked(swaying(seconds=30.0)).notes == ()
    assert checked(still(count=3000)).notes == ()


def test_both_in_another_handedness_are_refused_with_the_order():
    """Tables of phones hold z, y, x."""
    one = swaying(seconds=30.0)
    mirrored = replace(
        one,
        angular_velocity=one.angular_velocity[:, ::-1],
        specific_force=one.specific_force[:, ::-1],
    )
    with pytest.raises(LegsimError, match="the columns of both are not in the order x, y, z"):
        check_plausible(mirrored)


@pytest.mark.parametrize("lean", [0.15, 0.5])
@pytest.mark.parametrize("kind", ["angles", "another instrument", "another time"])
def test_what_is_no_gyroscope_knows_nothing_of_a_tilt(rng, kind, lean):
    one = swaying(seconds=30.0, lean=lean)
    columns = {
        "angles": np.cumsum(one.angular_velocity, axis=0) / 100,
        "another instrument": [0.3, 0.1, -0.4] + 0.05 * rng.normal(size=(3000, 3)),
        "another time": np.roll(one.angular_velocity, 250, axis=0),
    }
    notes = checked(replace(one, angular_velocity=columns[kind])).notes
    assert any("of which its gyroscope knows nothing" in note for note in notes)


@pytest.mark.parametrize("shift", [0.5, 2.0, 4.0])
def test_a_sensor_that_is_pushed_aside_does_not_tilt(rng, shift):
    """Its gyroscope has nothing to know."""
    one = still(count=3000)
    push = shift * np.sin(2 * np.pi * 0.4 * one.times)[:, None] * [1, 0, 0]
    pushed = replace(one, specific_force=one.specific_force + push)
    assert not [note for note in checked(pushed).notes if "knows nothing" in note]


@pytest.mark.parametrize("factor", [0.6, 0.8, 1.2, 1.9])
def test_a_wrong_rate_is_seen_in_how_fast_a_sensor_tilts(factor):
    one = swaying(seconds=30.0, lean=0.3)
    (note,) = checked(replace(one, times=factor * one.times)).notes
    assert f"sees it tilt {1 / factor:.2f} times as fast as its gyroscope does" in note
    near = replace(one, angular_velocity=1.05 * one.angular_velocity)
    assert checked(near).notes == ()
