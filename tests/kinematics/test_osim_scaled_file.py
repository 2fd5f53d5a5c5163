"""The file of a scaled model is read as the scaled model."""

import numpy as np
import pytest

from legsim.kinematics import osim_file, osim_scaled_file, osim_scaling
from legsim.kinematics.osim_leg import OsimLeg
from tests.examples import osim
from tests.kinematics.test_osim_registration import gliding_knees, moving, random_factors


@pytest.mark.parametrize("version", [osim.version_4, osim.version_3])
def test_the_scaled_file_is_the_scaled_model(tmp_path, rng, version):
    joints = gliding_knees()
    markers = osim.MARKERS
    if version is osim.version_3:
        markers = markers.replace("socket_parent_frame>/bodyset/", "body>").replace(
            "</socket_parent_frame", "</body"
        )
    path = osim.saved(tmp_path, version(joints, markers=markers))
    scaled = osim_scaling.scaled(osim_file.read(path), random_factors(rng))
    leg = OsimLeg(scaled)
    again = OsimLeg(
        osim_file.read(osim.saved(tmp_path, osim_scaled_file.text(scaled), "scaled.osim"))
    )
    values = moving(leg, rng, 20).values
    for body, pose in leg.body_poses(values).items():
        np.testing.assert_allclose(again.body_poses(values)[body], pose, atol=1e-12)
    sites, _ = leg.marker_sites()
    there, _ = again.marker_sites()
    assert there.names == sites.names
    np.testing.assert_allclose(there.positions, sites.positions, atol=1e-12)
    factors = tmp_path / "factors.xml"
    factors.write_text(osim_scaled_file.scale_set(scaled.factors))
    by_file = OsimLeg(osim_scaling.scaled(osim_file.read(path), osim_scaling.read(factors)))
    np.testing.assert_allclose(
        by_file.body_poses(values)["talus_l"], leg.body_poses(values)["talus_l"], atol=1e-12
    )
