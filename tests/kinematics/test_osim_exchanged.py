"""Labels that are exchanged on a user's model are refused by name; another size is no exchange."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.kinematics import _osim_exchanged, from_recording, osim_file
from legsim.kinematics.osim_leg import OsimLeg
from legsim.mocap.trajectories import MarkerTrajectories
from tests.examples import osim
from tests.kinematics.test_on_osim_model import TIMES, recorded, squat


@pytest.fixture
def leg(tmp_path) -> OsimLeg:
    text = osim.version_4(osim.two_legs(), markers=osim.MARKERS)
    return OsimLeg(osim_file.read(osim.saved(tmp_path, text)))


def exchanged(one: str, other: str):
    return lambda name: {one: other, other: one}.get(name, name)


@pytest.mark.parametrize(
    ("one", "other"),
    [("tibia_r_M0", "talus_r_M1"), ("tibia_l_M2", "femur_l_M0"), ("femur_r_M0", "tibia_r_M2")],
)
def test_two_labels_are_named_with_their_segments(tmp_path, leg, one, other):
    path = recorded(leg, tmp_path / "m.trc", name=exchanged(one, other))
    with pytest.raises(LegsimError, match=r"m.trc: by their distances .* are exchanged") as refusal:
        from_recording.solve_kinematics(path, model=leg.model.path)
    assert f"{one} (on {one[:-3]})" in str(refusal.value)
    assert f"{other} (on {other[:-3]})" in str(refusal.value)


@pytest.mark.parametrize("factor", [0.8, 1.0, 1.2])
def test_another_size_and_markers_put_on_by_hand_are_no_exchange(leg, factor, rng):
    sites, _ = leg.marker_sites()
    places = factor * leg.marker_positions(squat(leg).values, sites)
    places = places + 0.015 * rng.standard_normal((1, *places.shape[1:]))
    places[::3, 4] = np.nan
    _osim_exchanged.check(sites, MarkerTrajectories(TIMES, sites.names, places))
