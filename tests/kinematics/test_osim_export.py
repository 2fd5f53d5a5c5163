"""The scaled leg as an OpenSim model: read back, it is the same leg."""

import numpy as np
import pytest

from legsim.kinematics import from_recording, marker_sites, osim_export, osim_file
from legsim.kinematics.leg_model import COORDINATES, LegModel
from legsim.kinematics.osim_leg import OsimLeg
from legsim.kinematics.skeleton import SEGMENTS, SegmentScales
from legsim.mocap import trc
from legsim.mocap.trajectories import JointTrajectories


@pytest.fixture
def scaled(rng) -> LegModel:
    return LegModel.load(SegmentScales(rng.uniform(0.8, 1.2, (len(SEGMENTS), 3)), 60.0))


@pytest.fixture
def again(tmp_path, scaled) -> OsimLeg:
    path = tmp_path / "leg.osim"
    path.write_text(osim_export.text(scaled, marker_sites.load(), name="Ann & Bob/2"))
    return OsimLeg(osim_file.read(path))


def test_bodies_markers_and_bounds_come_back(scaled, again, rng):
    low, high = scaled.coordinate_ranges.T
    values = low + (high - low) * rng.random((50, len(COORDINATES)))
    motion = JointTrajectories(np.arange(50.0), COORDINATES, values)
    assert again.coordinate_names == COORDINATES
    np.testing.assert_array_equal(again.default_coordinates, scaled.default_coordinates)
    np.testing.assert_allclose(again.coordinate_ranges[6:], scaled.coordinate_ranges[6:])
    ours, theirs = scaled.segment_poses(motion), again.body_poses(values)
    for name, pose in theirs.items():
        np.testing.assert_allclose(pose, ours.of(name), atol=1e-12)
    sites = marker_sites.load()
    found = again.marker_positions(values, again.marker_sites()[0].only(sites.names))
    np.testing.assert_allclose(found, scaled.marker_positions(values, sites), atol=1e-12)


def test_the_patella_follows_the_knee_as_in_the_leg(scaled, again, rng):
    """Its body, whose coordinate a coupler ties to the knee's."""
    from legsim.kinematics._osim_chain import Chain

    joints = [j for j in again.model.joints if j.child != "torso"]
    chain, values = Chain(joints), np.tile(scaled.default_coordinates, (9, 1))
    knee = np.linspace(-2.0, 0.1, 9)
    for side in "rl":
        values[:, COORDINATES.index(f"knee_angle_{side}")] = knee
    motion = again.complete(JointTrajectories(np.arange(9.0), COORDINATES, values))
    np.testing.assert_array_equal(motion.coordinate("knee_angle_l_beta"), knee)
    rotations, origins = chain.poses(np.stack([motion.coordinate(n) for n in chain.names], 1))
    ours = scaled.segment_poses(motion)
    for name in ("patella_r", "patella_l"):
        k = chain.bodies.index(name)
        np.testing.assert_allclose(origins[:, k], ours.of(name)[:, :3, 3], atol=1e-12)
        np.testing.assert_allclose(rotations[:, k], ours.of(name)[:, :3, :3], atol=1e-12)


def test_a_flexed_knee_is_the_same_for_both_signs(scaled):
    values = np.tile(scaled.default_coordinates, (3, 1))
    values[:, COORDINATES.index("knee_angle_l")] = (-1.0, -0.2, 0.1)
    poses = scaled.segment_poses(JointTrajectories(np.arange(3.0), COORDINATES, values))
    np.testing.assert_allclose(poses.knee_flexion("l"), (1.0, 0.2, -0.1), atol=1e-12)
    np.testing.assert_allclose(poses.knee_flexion("r"), 0.0, atol=1e-12)


def test_a_recording_is_solved_on_the_model_that_was_made_from_it(tmp_path):
    """Its own labels, its own place: what differs is how much priors draw at seven markers."""
    person = from_recording.solve_kinematics("subject01/squat_30.trc")
    assert person.fit is not None
    labels = person.fit.labels()
    path = tmp_path / "scaled_model.osim"
    path.write_text(osim_export.text(person.leg, person.fit.sites, name="person", labels=labels))
    again = from_recording.solve_kinematics("subject01/squat_30.trc", model=path)
    assert any("7 of the 7 markers on the model's legs" in note for note in again.notes)
    assert {*again.fit.modelled.marker_names} == {*labels.values()}
    centers = [p.leg.joint_centers(p.leg.segment_poses(p.trajectories)) for p in (person, again)]
    away = centers[0].positions_world - centers[1].positions_world
    assert np.linalg.norm(away, axis=-1).max() < 2.5e-3
    # and the file of the model's markers, which are named by role
    trc.save(tmp_path / "model_markers.trc", person.fit.modelled)
    modelled = from_recording.solve_kinematics(tmp_path / "model_markers.trc", model=path)
    assert any("7 of the 7 markers on the model's legs" in note for note in modelled.notes)


def test_labels_are_names_that_opensim_takes_and_none_is_there_twice(tmp_path, scaled):
    sites = marker_sites.load().only(["sacrum", "asis_r", "asis_l", "heel_r", "heel_l"])
    labels = {"sacrum": "Ann:V Sacral", "asis_r": "R/ASIS", "asis_l": "heel-r", "heel_r": "a b"}
    labels["heel_l"] = "a*b"
    path = tmp_path / "leg.osim"
    path.write_text(osim_export.text(scaled, sites, name="x", labels=labels))
    names = [marker.name for marker in osim_file.read(path).markers]
    assert names == ["Ann:V_Sacral", "sacrum", "R_ASIS", "asis_r", "heel-r", "asis_l", "heel_l"]
