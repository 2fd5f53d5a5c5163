"""The recording of a run: known by its content, and solved as the settings say."""

from pathlib import Path

import numpy as np
import pytest

from legsim.config import MotionConfig, TremorConfig
from legsim.core.errors import LegsimError
from legsim.kinematics.leg_model import COORDINATES
from legsim.mocap import opensim
from legsim.mocap.trajectories import JointTrajectories
from legsim.run import motion
from tests.examples import osim


def recording(path: Path, bend: float, seconds: int = 1) -> MotionConfig:
    """A file of a bent knee, and the settings that name it."""
    values = np.where([name.startswith("knee") for name in COORDINATES], bend, 0.0)
    count = 60 * seconds
    still = JointTrajectories(np.arange(count) / 60, COORDINATES, np.tile(values, (count, 1)))
    opensim.save(path, still)
    return MotionConfig(file=str(path))


def test_a_recording_is_known_by_its_content_whatever_its_name(tmp_path):
    first, other = (recording(tmp_path / f"{n}.mot", -0.5) for n in "ab")
    before = motion.fingerprint(first)
    (tmp_path / "b.mot").write_bytes((tmp_path / "a.mot").read_bytes())
    assert motion.fingerprint(other) == before
    assert motion.fingerprint(recording(tmp_path / "a.mot", -0.6)) != before


def test_settings_are_passed_on(tmp_path):
    plain = motion.solve(recording(tmp_path / "a.mot", -0.5))
    np.testing.assert_allclose(plain.trajectories.coordinate("knee_angle_l"), -0.5, atol=1e-12)
    assert plain.fit is None


def test_a_model_and_scales_are_passed_on_and_known_by_their_content(tmp_path):
    text = osim.version_4(osim.two_legs())
    model = osim.saved(tmp_path, text)
    scales = tmp_path / "s.xml"
    scale = "<Scale><scales>1 {} 1</scales><segment>femur_l</segment></Scale>"
    scales.write_text(f"<OpenSimDocument>{scale.format(1.2)}</OpenSimDocument>")
    settings = recording(tmp_path / "a.mot", -0.5).model_copy(
        update={"model": str(model), "scale_file": str(scales)}
    )
    assert motion.solve(settings).leg.thigh_length("l") == pytest.approx(1.2 * 0.41)
    before = motion.fingerprint(settings)
    scales.write_text(f"<OpenSimDocument>{scale.format(1.31)}</OpenSimDocument>")
    scaled = motion.fingerprint(settings)
    osim.saved(tmp_path, text.replace("-0.41", "-0.4155"))
    assert len({*before, *scaled, *motion.fingerprint(settings)}) == 5


def test_a_tremor_moves_the_bones_and_is_reported(tmp_path):
    settings = recording(tmp_path / "a.mot", -0.5, seconds=4)
    still = motion.solve(settings)
    tremor = TremorConfig(acceleration_mg=2.0, seed=3)
    shaken, again, other = (
        motion.solve(settings.model_copy(update={"tremor": each}))
        for each in (tremor, tremor, tremor.model_copy(update={"seed": 4}))
    )
    assert np.ptp(still.trajectories.coordinate("knee_angle_l")) < 1e-9
    knee = np.degrees(shaken.trajectories.coordinate("knee_angle_l"))
    assert 1e-4 < knee.std() < 1e-2
    assert "a tremor of 2 mg at 8-12 Hz was added" in shaken.notes
    np.testing.assert_array_equal(again.trajectories.values, shaken.trajectories.values)
    assert not np.array_equal(other.trajectories.values, shaken.trajectories.values)


def test_a_model_whose_knees_cannot_move_over_its_feet_has_no_tremor(tmp_path):
    model = osim.saved(tmp_path, osim.version_4(osim.two_legs()))
    settings = recording(tmp_path / "a.mot", -0.5, seconds=4).model_copy(
        update={"model": str(model), "tremor": TremorConfig(acceleration_mg=2.0)}
    )
    with pytest.raises(LegsimError, match="leave the knees no way to move"):
        motion.solve(settings)
