"""What aids a sensor is measured against the truth, the same by every order of asking."""

import numpy as np
import pytest

from legsim import config
from legsim.config import RunConfig
from legsim.core.errors import LegsimError
from legsim.study import aiding
from legsim.study.aiding import Left

ALL = ("uncorrected", "dead-reckoning", "standing", "beads-1", "beads-2", "fiducials")


def settings(**kinds: str) -> RunConfig:
    """A scan of 62 views in 8 s."""
    named = {
        "motion.file": "subject01/squat_30.trc",
        "scan.views": "62",
        "scan.increment_deg": "3.2",
        "scan.rate_hz": "7.75",
        "methods.fiducials.detector": "unbounded",
        "methods.fiducials.error_px": "0.2",
        **{key.replace("__", "."): value for key, value in kinds.items()},
    }
    return config.load_settings(
        preset="demo", overrides=tuple(f"{key}={value}" for key, value in named.items())
    )


def measured(asked: RunConfig, aids: tuple[str, ...], seed: int = 1) -> dict[str, Left]:
    (found,) = aiding.measure(asked, aids, [seed], lambda *_: None)
    return found


def test_an_exact_sensor_and_start_leave_nothing():
    """No more than the phantom's bone moves against its sensor's splines."""
    found = measured(settings(), ("uncorrected", "dead-reckoning"))
    assert found["dead-reckoning"].mm < 1e-3
    assert found["dead-reckoning"].degrees < 1e-4
    assert not found["uncorrected"].followed
    assert found["uncorrected"].px_after_similarity > 0.2


@pytest.mark.end_to_end
def test_a_consumer_sensor_is_meters_off_alone_and_sharp_with_beads():
    found = measured(settings(imu__noise__kind="bmi160", methods__start="rough"), ALL)
    assert found["dead-reckoning"].mm > 500
    assert found["beads-2"].px_after_similarity < 0.3 * found["uncorrected"].px_after_similarity
    assert found["fiducials"].px_after_similarity < 0.5 * found["uncorrected"].px_after_similarity
    again = measured(settings(imu__noise__kind="bmi160", methods__start="rough"), ("beads-2",))
    assert again["beads-2"] == found["beads-2"]


def test_a_sensor_that_the_scan_does_not_see_is_refused():
    sensors = "[{name='shank_l', segment='calcn_l', distance_mm=50}]"
    with pytest.raises(LegsimError, match=r"methods.sensor: shank_l is on calcn, which the scan"):
        measured(settings(imu__sensors=sensors), ("uncorrected",))


def test_sensors_draw_anew_by_seed():
    asked = settings(imu__noise__kind="bmi160", methods__start="rough")
    setup = aiding.placed(asked)
    one, same, other = (
        aiding.sensed(asked.model_copy(update={"seed": seed}), setup) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one.signals.specific_force, same.signals.specific_force)
    assert np.abs(one.signals.specific_force - other.signals.specific_force).max() > 0.1
    assert np.abs(one.starts[0].world_from_sensor - other.starts[0].world_from_sensor).max() > 1e-3
