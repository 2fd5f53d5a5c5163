"""A user's model takes the size of a person: known factors come back, and what cannot be known is
said.
"""

from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.kinematics import (
    from_recording,
    inverse_kinematics,
    on_osim_model,
    osim_file,
    osim_registration,
    osim_scaling,
)
from legsim.kinematics._osim_person import OsimPerson
from legsim.kinematics.ik_options import IkOptions
from legsim.kinematics.osim_leg import OsimLeg
from legsim.mocap import opensim, trc
from legsim.mocap.trajectories import JointTrajectories, MarkerTrajectories
from tests.examples import osim

GROUPS = ("pelvis", "femur_r", "tibia_r", "talus_r", "femur_l", "tibia_l", "talus_l")
SPLINE = (
    "<SimmSpline><x>-2 -1 0 0.2</x><y>-0.405 -0.41 -0.4 -0.4</y></SimmSpline>",
    "<SimmSpline><x>-2 -1 0 0.2</x><y>-0.01 0.004 0 0</y></SimmSpline>",
)


def gliding_knees() -> list[osim.J]:
    """Two legs whose knees glide along two axes of the femur, one of them oblique."""
    joints = []
    for joint in osim.two_legs():
        if joint.name.startswith("knee"):
            name = next(iter(joint.coordinates))
            axes = (
                ("rotation1", name, "0 0 1", osim.LINEAR),
                ("translation1", name, "1 0.2 0", SPLINE[1]),
                ("translation2", name, "0 1 0", SPLINE[0]),
            )
            joint = osim.J(
                joint.name, "CustomJoint", joint.parent, joint.child,
                child_at="0.004 0.01 0.002", coordinates=joint.coordinates, axes=axes,
            )  # fmt: skip
        joints.append(joint)
    return joints


@pytest.fixture
def leg(tmp_path: Path) -> OsimLeg:
    text = osim.version_4(gliding_knees(), markers=osim.MARKERS)
    return OsimLeg(osim_file.read(osim.saved(tmp_path, text)))


def moving(leg: OsimLeg, rng: np.random.Generator, frames: int = 30) -> JointTrajectories:
    """A way through random postures."""
    values = np.tile(leg.default_coordinates, (6, 1)) + rng.uniform(
        -0.3, 0.3, (6, len(leg.coordinate_names))
    )
    for k, name in enumerate(leg.coordinate_names):
        if name.startswith("knee"):
            values[:, k] = rng.uniform(-1.3, -0.1, 6)
    smooth = CubicSpline(np.arange(6), values)(np.linspace(0, 5, frames))
    smooth = np.clip(smooth, *leg.coordinate_ranges.T)
    return JointTrajectories(np.arange(frames) / 60, leg.coordinate_names, smooth)


def random_factors(rng: np.random.Generator) -> dict[str, FloatArray]:
    return {body: rng.uniform(0.9, 1.15) * rng.uniform(0.95, 1.05, 3) for body in GROUPS}


def recorded(leg: OsimLeg, motion: JointTrajectories) -> MarkerTrajectories:
    sites, _ = leg.marker_sites()
    return MarkerTrajectories(motion.times, sites.names, leg.marker_positions(motion.values, sites))


def settings(leg: OsimLeg) -> IkOptions:
    return IkOptions().settled(on_osim_model.model_priors(leg, leg.marker_sites()[0]))


def test_the_jacobian_is_the_derivative_of_the_markers(leg, rng):
    start = np.log(rng.uniform(0.9, 1.1, (len(leg.bodies), 3)))
    sites, _ = leg.marker_sites()
    places = osim_registration._first_places(leg, sites, start)
    moved = osim_registration.Places(
        places.names, places.bodies, places.locations, places.weights, np.full((len(sites.names), 3), 0.01)
    )  # fmt: skip
    values, h = moving(leg, rng, 4).values, 1e-6
    for growth in (
        osim_registration._whole_growth(leg, start),
        osim_registration._settling_growth(leg, start),
    ):
        model = OsimPerson(leg.model, (), growth, moved)
        theta = 0.02 * rng.normal(size=model.size)
        jacobian = model.jacobian(model(theta), values)
        for parameter in range(model.size):
            ahead, behind = (model(theta + s * h * np.eye(model.size)[parameter]) for s in (1, -1))
            slope = (
                ahead.leg.marker_positions(values, ahead.sites)
                - behind.leg.marker_positions(values, behind.sites)
            ) / (2 * h)
            np.testing.assert_allclose(jacobian[..., parameter], slope, atol=1e-8)


def test_known_factors_and_joint_centers_come_back(leg, rng):
    factors = random_factors(rng)
    true = OsimLeg(osim_scaling.scaled(leg.model, factors))
    motion = moving(true, rng)
    markers = recorded(true, motion)
    found = osim_registration.fit(leg, markers, leg.marker_sites()[0], settings(leg))
    for body in GROUPS:
        np.testing.assert_allclose(found.leg.model.factors[body], factors[body], rtol=1e-3)
    sites, config = found.registration.sites, found.registration.config
    solved = inverse_kinematics.solve(found.leg, markers, sites, config).trajectories
    centers = [
        each.joint_centers(each.segment_poses(way)).positions_world
        for each, way in ((found.leg, solved), (true, motion))
    ]
    assert np.linalg.norm(centers[0] - centers[1], axis=-1).max() < 0.5e-3
    assert found.registration.rms_after < 1e-4


def test_a_person_larger_in_everything_makes_everything_larger(tmp_path, rng):
    """Knees that turn only: OpenSim's rule makes a glide along an oblique axis larger still."""
    text = osim.version_4(osim.two_legs(), markers=osim.MARKERS)
    leg = OsimLeg(osim_file.read(osim.saved(tmp_path, text)))
    motion = moving(leg, rng)
    markers = recorded(leg, motion)
    grown = MarkerTrajectories(markers.times, markers.marker_names, 1.1 * markers.positions_world)
    found = osim_registration.fit(leg, grown, leg.marker_sites()[0], settings(leg))
    for body in leg.model.bodies:
        np.testing.assert_allclose(found.leg.model.factors[body], 1.1, rtol=1e-3)


def test_misplaced_markers_are_found_where_the_person_wears_them(leg, rng):
    motion = moving(leg, rng)
    markers = recorded(leg, motion)
    sites, _ = leg.marker_sites()
    row = sites.names.index("tibia_r_M1")
    pose = leg.segment_poses(motion).of("tibia_r")[:, :3, :3]
    places = markers.positions_world.copy()
    places[:, row] += pose @ (0.01, -0.02, 0.006)
    worn = MarkerTrajectories(markers.times, markers.marker_names, places)
    found = osim_registration.fit(leg, worn, sites, settings(leg)).registration
    shift = found.sites.position("tibia_r_M1") - sites.positions[row]
    np.testing.assert_allclose(shift, (0.01, -0.02, 0.006), atol=4e-3)
    assert found.rms_after < 0.3 * found.rms_before


@pytest.mark.parametrize("size", [1.0, 1.15])
def test_a_model_of_another_size_is_reported_with_the_fix(tmp_path, leg, rng, size):
    motion = moving(leg, rng)
    markers = recorded(leg, motion)
    places = size * markers.positions_world
    trc.save(tmp_path / "m.trc", MarkerTrajectories(markers.times, markers.marker_names, places))
    person = from_recording.solve_kinematics(tmp_path / "m.trc", model=leg.model.path, filter_hz=0)
    said = [note for note in person.notes if "not of this person's size" in note]
    assert len(said) == (size > 1)
    if said:
        assert "thighs +15 %, shanks +15 %, hips' distance +15 %" in said[0]
        assert "--scale-model" in said[0]
        scaled = from_recording.solve_kinematics(
            tmp_path / "m.trc", model=leg.model.path, scale_model=True, filter_hz=0
        )
        assert scaled.leg.thigh_length("r") == pytest.approx(size * leg.thigh_length("r"), rel=1e-3)
        assert not any("not of this person's size" in note for note in scaled.notes)
        assert scaled.fit.ik.rms < 0.1 * person.fit.ik.rms


def test_coordinates_move_a_model_scaled_from_a_trial_with_markers(tmp_path, leg, rng):
    motion = moving(leg, rng)
    markers = recorded(leg, motion)
    places = 0.9 * markers.positions_world
    trc.save(tmp_path / "m.trc", MarkerTrajectories(markers.times, markers.marker_names, places))
    opensim.save(tmp_path / "c.mot", motion)
    person = from_recording.solve_kinematics(
        tmp_path / "c.mot",
        model=leg.model.path,
        scale_model=True,
        filter_hz=0,
        scale_from=tmp_path / "m.trc",
    )
    assert person.leg.shank_length("l") == pytest.approx(0.9 * leg.shank_length("l"), rel=1e-3)


def test_what_cannot_be_scaled_is_refused(tmp_path, leg, rng):
    markers = recorded(leg, moving(leg, rng))
    trc.save(tmp_path / "m.trc", markers)
    for options, problem in (
        ({"scale_model": True}, r"m.trc \(settings\): motion.scale_model scales an OpenSim model"),
        (
            {"scale_model": True, "model": leg.model.path, "scale_file": leg.model.path},
            "given twice, by motion.scale_model and motion.scale_file",
        ),
        (
            {"model": leg.model.path, "scale_from": tmp_path / "m.trc"},
            "motion.scaling_file and motion.model; .*--scale-model",
        ),
    ):
        with pytest.raises(LegsimError, match=problem):
            from_recording.solve_kinematics(tmp_path / "m.trc", **options)
    sites, _ = leg.marker_sites()
    row = sites.names.index("femur_r_M2")
    places = markers.positions_world.copy()
    places[:, row] += leg.segment_poses(moving(leg, rng)).of("femur_r")[:, :3, 1] * -0.8
    wrong = MarkerTrajectories(markers.times, markers.marker_names, places)
    with pytest.raises(LegsimError, match=r"would be .* times as large along"):
        osim_registration.fit(leg, wrong, sites, settings(leg))
