"""The recording of a run: known by its content, and solved as the settings say."""

from pathlib import Path

import numpy as np
import pytest

from legsim.config import MotionConfig
from legsim.core.errors import LegsimError
from legsim.kinematics.leg_model import COORDINATES
from legsim.mocap import opensim
from legsim.mocap.trajectories import JointTrajectories
from legsim.run import motion
from tests.examples import osim


def recording(path: Path, bend: float) -> MotionConfig:
    """A file of a bent knee, and the settings that name it."""
    values = np.where([name.startswith("knee") for name in COORDINATES], bend, 0.0)
    still = JointTrajectories(np.arange(60) / 60, COORDINATES, np.tile(values, (60, 1)))
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


@pytest.mark.parametrize("count", [1, 5])
def test_a_recording_too_short_for_accelerations_is_named(tmp_path, count):
    still = np.zeros((count, len(COORDINATES)))
    file = tmp_path / "short.mot"
    opensim.save(file, JointTrajectories(np.arange(count) / 60, COORDINATES, still))
    with pytest.raises(LegsimError, match=rf"short\.mot: holds {count} samples? .* need 6; record"):
        motion.solve(MotionConfig(file=str(file)))
