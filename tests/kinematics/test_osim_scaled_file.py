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


def test_a_marker_that_is_there_twice_moves_twice(tmp_path, rng):
    """Else the file would have one name in two places, and be refused."""
    twice = osim.MARKERS + osim.MARKERS[: osim.MARKERS.index("</Marker>") + len("</Marker>")]
    path = osim.saved(tmp_path, osim.version_4(gliding_knees(), markers=twice))
    scaled = osim_scaling.scaled(osim_file.read(path), random_factors(rng))
    text = osim_scaled_file.text(scaled)
    again = OsimLeg(osim_file.read(osim.saved(tmp_path, text, "scaled.osim")))
    sites, _ = OsimLeg(scaled).marker_sites()
    there, _ = again.marker_sites()
    assert there.names == sites.names
    np.testing.assert_allclose(there.positions, sites.positions, atol=1e-12)


def test_a_connected_marker_on_an_offset_frame_moves_to_its_body(tmp_path, rng):
    """The spelling of OpenSim 4's previews; a location in the body belongs to no offset frame."""
    joints = gliding_knees()
    knee = next(j for j in joints if j.name == "knee_r")
    connected = (
        "<Marker name='on_frame'><connectors><Connector_PhysicalFrame_ name='parent_frame'>"
        "<connectee_name>femur_r/shifted</connectee_name></Connector_PhysicalFrame_></connectors>"
        "<location>0.01 0.02 0.03</location></Marker>"
    )
    text = osim.version_4(joints, markers=osim.MARKERS + connected).replace(
        f"<Body name='{knee.parent}'><mass>1</mass>",
        f"<Body name='{knee.parent}'><mass>1</mass><components><PhysicalOffsetFrame name='shifted'>"
        "<translation>0 -0.1 0</translation><orientation>0 0 0.5</orientation>"
        "</PhysicalOffsetFrame></components>",
    )
    scaled = osim_scaling.scaled(osim_file.read(osim.saved(tmp_path, text)), random_factors(rng))
    again = osim_file.read(osim.saved(tmp_path, osim_scaled_file.text(scaled), "scaled.osim"))
    (marker,) = [m for m in scaled.markers if m.name == "on_frame"]
    (there,) = [m for m in again.markers if m.name == "on_frame"]
    assert there.body == marker.body == "femur_r"
    np.testing.assert_allclose(there.location, marker.location, atol=1e-12)
