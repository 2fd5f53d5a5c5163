"""What aids a sensor is measured against the truth, the same by every order of asking."""

import numpy as np
import pytest

from legsim import config
from legsim.config import RunConfig
from legsim.core.errors import LegsimError
from legsim.run import motion, stages, volumes
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
    setup = stages.place(asked, motion.solve(asked.motion))
    one, same, other = (
        aiding.sensed(asked.model_copy(update={"seed": seed}), setup) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one.signals.specific_force, same.signals.specific_force)
    assert np.abs(one.signals.specific_force - other.signals.specific_force).max() > 0.1
    assert np.abs(one.starts[0].world_from_sensor - other.starts[0].world_from_sensor).max() > 1e-3


def test_phantom_and_starts_are_those_of_a_run(tmp_path):
    """One function sets up both: a file of legs is read, tissue swings, fiducials give starts."""
    asked = settings(
        phantom__tissue_swing__amplitude="1",
        methods__start="fiducials",
        methods__fiducials__error_px="5",
    )
    setup = stages.place(asked, motion.solve(asked.motion))
    plain = stages.place(settings(), setup.person)
    assert len(setup.poses.segment_names) > len(plain.poses.segment_names)
    found = aiding.sensed(asked, setup).starts[0].world_from_sensor
    exact = aiding.sensed(settings(), plain).starts[0].world_from_sensor
    assert np.abs(found - exact).max() > 1e-4
    with pytest.raises(LegsimError, match=r"PHANTOM\.toml"):
        stages.place(settings(phantom__file=str(tmp_path / "PHANTOM.toml")), setup.person)


def test_what_no_aid_can_be_made_of_is_refused():
    with pytest.raises(LegsimError, match=r"methods\.sensor: unknown sensor 'typo'; name one of"):
        aiding.check(settings(methods__sensor="typo"), ALL)
    with pytest.raises(LegsimError, match='has no images in \\[aiding\\]; set it to "exact"'):
        aiding.check(settings(methods__fiducials__found="images"), ALL)
    aiding.check(settings(methods__fiducials__found="images"), ("beads-1",))


def test_noise_that_is_drawn_into_shadows_is_stated_of_them():
    asked = settings(methods__fused__error_px="2", methods__fiducials__error_px="3")
    setup = stages.place(asked, motion.solve(asked.motion))
    assert volumes.exact_beads(asked, setup).error_px == 2
    assert volumes.fused_fiducials(asked, setup).error_px == 3
    assert volumes.exact_beads(settings(), setup).error_px == 0.3
