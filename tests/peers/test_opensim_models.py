"""Legs read from OpenSim models move as OpenSim moves them (pip install opensim; python -m pytest
-m peer).
"""

import os
from pathlib import Path

import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.kinematics import (
    from_recording,
    inverse_kinematics,
    marker_sites,
    on_osim_model,
    osim_export,
    osim_file,
    osim_marker_set,
    osim_scaled_file,
    osim_scaling,
)
from legsim.kinematics.ik_options import IkOptions, PriorStrengths
from legsim.kinematics.leg_model import COORDINATES, LegModel
from legsim.kinematics.osim_leg import OsimLeg
from legsim.kinematics.skeleton import JOINT_CENTERS, SEGMENTS, SegmentScales
from legsim.mocap.trajectories import JointTrajectories, MarkerTrajectories
from tests.examples import task_sets

pytestmark = [pytest.mark.peer, pytest.mark.filterwarnings("ignore::DeprecationWarning")]
POSTURES = 500
MODELS = (
    "gait2392_thelen2003muscle",
    "gait2392_subject01_scaled",
    "gait10dof18musc",
    "FullBodyModel_Hamner2010_v2_0",
    "Rajagopal2016",
)
OTHERS = sorted(Path(os.environ.get("LEGSIM_OSIM_FOLDER", "nowhere")).glob("*.osim"))
"""any other models, in the folder that LEGSIM_OSIM_FOLDER names"""
CENTER_OF = {"hip": "femur", "knee": "tibia", "ankle": "talus"}


@pytest.fixture(scope="session")
def opensim_peer():
    pytest.importorskip("opensim", reason="pip install opensim")
    from tools.benchmarks.peers import opensim_kinematics as opensim_peer

    return opensim_peer


@pytest.mark.parametrize("name", MODELS)
def test_bodies_markers_and_centers_agree_in_random_postures(
    opensim_peer, shared_data, rng, name, agree
):
    path = shared_data / f"opensim/{name}.osim"
    check(opensim_peer.any_model(path), OsimLeg(osim_file.read(path)), opensim_peer, rng, agree)


@pytest.mark.parametrize("name", MODELS)
def test_scaled_models_agree_with_opensims_scaling(opensim_peer, shared_data, rng, name, agree):
    path = shared_data / f"opensim/{name}.osim"
    read = osim_file.read(path)
    factors = {body: rng.uniform(0.8, 1.2, 3) for body in read.bodies}
    leg = OsimLeg(osim_scaling.scaled(read, factors))
    check(opensim_peer.any_model(path, factors), leg, opensim_peer, rng, agree)


@pytest.mark.parametrize("name", MODELS)
def test_the_scaled_models_file_opens_to_the_same_leg(
    opensim_peer, shared_data, rng, tmp_path, name, agree
):
    """Bodies, joint centers, markers and masses, as OpenSim itself scales the user's file."""
    path = shared_data / f"opensim/{name}.osim"
    read = osim_file.read(path)
    factors = {body: rng.uniform(0.8, 1.2, 3) for body in read.bodies}
    scaled = osim_scaling.scaled(read, factors)
    (tmp_path / "scaled.osim").write_text(osim_scaled_file.text(scaled))
    opened = opensim_peer.any_model(tmp_path / "scaled.osim")
    check(opened, OsimLeg(scaled), opensim_peer, rng, agree)
    theirs = opensim_peer.any_model(path, factors)
    for body in read.bodies:
        one, two = (model.getBodySet().get(body) for model in (opened, theirs))
        assert one.getMass() == pytest.approx(two.getMass(), rel=1e-9)
        moments = [[m.get(k) for m in (b.get_inertia(),) for k in range(6)] for b in (one, two)]
        np.testing.assert_allclose(moments[0], moments[1], rtol=1e-9, atol=1e-12)
        centers = [[b.getMassCenter().get(k) for k in range(3)] for b in (one, two)]
        np.testing.assert_allclose(centers[0], centers[1], atol=1e-12)


@pytest.mark.parametrize("path", OTHERS, ids=lambda path: path.stem)
def test_a_folder_of_models_agrees_or_is_refused_by_name(opensim_peer, rng, path, agree):
    try:
        leg = OsimLeg(osim_file.read(path))
    except LegsimError as error:
        pytest.skip(str(error).removeprefix(f"{path}: "))
    try:
        model = opensim_peer.any_model(path)
    except RuntimeError as error:
        pytest.skip(f"OpenSim itself does not open it: {error}")
    check(model, leg, opensim_peer, rng, agree)


def check(model, leg, opensim_peer, rng, agree):
    """Bodies, joint centers and markers of both within 0.05 mm and 0.01 degrees."""
    theirs = opensim_peer.random_postures(model, POSTURES, rng)
    columns = [theirs.coordinates.index(n) for n in leg.coordinate_names]
    values = theirs.values[:, columns]
    ours = leg.body_poses(values)
    assert set(ours) >= {leg.body_of(segment) for segment in SEGMENTS}
    for body, pose in ours.items():
        away = pose[:, :3, 3] - theirs.bodies[body][:, :3, 3]
        far = 1e3 * np.linalg.norm(away, axis=-1).max()
        agree("positions of bodies, .osim", "OpenSim", far, 0.05, "mm")
        turned = np.swapaxes(pose[:, :3, :3], 1, 2) @ theirs.bodies[body][:, :3, :3]
        angle = np.degrees(transforms.rotation_angle(turned).max())
        agree("rotations of bodies, .osim", "OpenSim", angle, 0.01, "deg")
    times = np.arange(POSTURES, dtype=float)
    poses = leg.segment_poses(JointTrajectories(times, leg.coordinate_names, values))
    centers = leg.joint_centers(poses)
    for center in JOINT_CENTERS:
        joint, side = center.split("_")
        true = theirs.centers[leg.body_of(f"{CENTER_OF[joint]}_{side}")]
        far = 1e3 * np.linalg.norm(centers.of(center) - true, axis=-1).max()
        agree("joint centers, .osim", "OpenSim", far, 0.05, "mm")
    sites, _ = leg.marker_sites()
    for k, marker in enumerate(sites.names):
        away = leg.marker_positions(values, sites)[:, k] - theirs.markers[marker]
        agree("markers, .osim", "OpenSim", 1e3 * np.abs(away).max(), 0.05, "mm")


@pytest.mark.parametrize("name", ["gait2392_thelen2003muscle", "gait2392_subject01_scaled"])
def test_a_marker_set_is_put_on_a_model_as_opensim_does_it(
    opensim_peer, shared_data, rng, tmp_path, name, agree
):
    """By Model::updateMarkerSet: some replace, some are added, some were there before. And what
    is written of the scaled model opens to the same.
    """
    import opensim  # pyright: ignore[reportMissingImports]

    path = shared_data / f"opensim/{name}.osim"
    given = tmp_path / "set.xml"
    text = (shared_data / "opensim/gait2392_Scale_MarkerSet.xml").read_text()
    given.write_text(text.replace('name="R.', 'name="own.R.'))
    read, _ = osim_marker_set.with_set(osim_file.read(path), given)
    model = opensim_peer.any_model(path)
    model.initSystem()
    model.updateMarkerSet(opensim.MarkerSet(str(given)))
    assert model.getNumMarkers() == len(read.markers)
    check(model, OsimLeg(read), opensim_peer, rng, agree)
    scaled = osim_scaling.scaled(read, {b: rng.uniform(0.8, 1.2, 3) for b in read.bodies})
    (tmp_path / "scaled.osim").write_text(osim_scaled_file.text(scaled))
    opened = opensim_peer.any_model(tmp_path / "scaled.osim")
    assert opened.getNumMarkers() == len(read.markers)
    check(opened, OsimLeg(scaled), opensim_peer, rng, agree)


@pytest.mark.parametrize("name", ["gait2392_subject01_scaled", "Rajagopal2016"])
def test_inverse_kinematics_by_the_models_own_markers_agrees(
    opensim_peer, shared_data, rng, name, agree
):
    """The walking trial of that subject; of the other model a walk of its own with 5 mm of noise."""
    path = shared_data / f"opensim/{name}.osim"
    leg, _ = on_osim_model.held_leg(OsimLeg(osim_file.read(path)))
    walk = shared_data / "mocap/walk_opensim/subject01_walk1.trc"
    scaled = shared_data / "opensim/gait2392_subject01_scaled.osim"
    person = from_recording.solve_kinematics(walk, model=scaled, filter_hz=0, marker_noise=0)
    if name == "gait2392_subject01_scaled":
        measured = person.fit.measured
        sites = leg.marker_sites()[0].only(measured.marker_names)
    else:
        sites, _ = leg.marker_sites()
        sites = sites.only([n for n in sites.names if not n.endswith("JC")])
        values = np.tile(leg.default_coordinates, (len(person.trajectories.times), 1))
        for k, coordinate in enumerate(leg.coordinate_names):
            sign = -1 if coordinate.startswith("knee_angle") else 1
            values[:, k] = sign * person.trajectories.coordinate(coordinate)
        places = leg.marker_positions(values, sites)
        measured = MarkerTrajectories(
            person.trajectories.times, sites.names, places + rng.normal(0, 5e-3, places.shape)
        )
    plain = IkOptions(priors=(), flat_foot_weight=0.0)
    ours = inverse_kinematics.solve(leg, measured, sites, plain)
    values, places = opensim_peer.own_markers(
        opensim_peer.any_model(path), measured, leg.coordinate_names, accuracy=1e-10
    )
    assert len(ours.report.frames_unconverged) == 0
    costs = [
        np.nansum((p - measured.positions_world) ** 2, axis=(1, 2))
        for p in (ours.modelled.positions_world, places)
    ]
    assert (costs[0] <= costs[1] * (1 + 1e-6)).all()
    away = np.degrees(np.abs(ours.trajectories.values - values).max())
    agree("coordinates by own markers, .osim", "OpenSim", away, 0.01, "deg")


def test_tasks_are_weighed_as_opensims_tool_weighs_them(opensim_peer, shared_data, tmp_path, agree):
    """Markers of several weights, one without a task, coordinates held loosely and hard."""
    path = shared_data / "opensim/gait2392_subject01_scaled.osim"
    walk = shared_data / "mocap/walk_opensim/subject01_walk1.trc"
    names = OsimLeg(osim_file.read(path)).marker_sites()[0].names
    weights = {n: 10 if "ASIS" in n else 1 + k % 3 for k, n in enumerate(names) if n != "R.Heel"}
    held = [task_sets.coordinate(f"lumbar_{n}", 1000) for n in ("extension", "bending", "rotation")]
    text = task_sets.task_set(
        *(task_sets.marker(name, weight) for name, weight in weights.items()),
        task_sets.marker("Nobody", 7),
        *held,
        task_sets.coordinate("hip_flexion_r", 0.01, "manual_value", 0.6),
        task_sets.coordinate("subtalar_angle_l", 1000),
    )
    (tmp_path / "tasks.xml").write_text(task_sets.document(text))
    theirs = opensim_peer.run_tool(path, walk, text, tmp_path)
    none = PriorStrengths(0, 0, 0, 0, 0)
    options = IkOptions(tasks_file=tmp_path / "tasks.xml", strengths=none)
    ours = from_recording.solve_kinematics(
        walk, model=path, filter_hz=0, marker_noise=0, ik=options
    ).trajectories
    rows = np.searchsorted(ours.times, theirs.times - 1e-6)
    for name in ours.coordinate_names:
        away = np.degrees(np.abs(ours.coordinate(name)[rows] - theirs.coordinate(name)).max())
        agree("coordinates by weighted tasks", "OpenSim", away, 0.01, "deg")


def test_the_scaled_leg_opens_in_opensim_to_the_same_bodies_and_masses(
    opensim_peer, tmp_path, rng, agree
):
    scales = SegmentScales(rng.uniform(0.8, 1.2, (len(SEGMENTS), 3)), 62.0)
    leg, path = LegModel.load(scales), tmp_path / "scaled_model.osim"
    path.write_text(osim_export.text(leg, marker_sites.load(), name="person"))
    model = opensim_peer.any_model(path)
    theirs = opensim_peer.random_postures(model, POSTURES, rng)
    values = theirs.values[:, [theirs.coordinates.index(n) for n in COORDINATES]]
    times = np.arange(POSTURES, dtype=float)
    ours = leg.segment_poses(JointTrajectories(times, COORDINATES, values))
    for body in SEGMENTS:
        away = ours.of(body)[:, :3, 3] - theirs.bodies[body][:, :3, 3]
        far = 1e3 * np.linalg.norm(away, axis=-1).max()
        agree("positions of bodies, written .osim", "OpenSim", far, 0.05, "mm")
        assert model.getBodySet().get(body).getMass() == pytest.approx(leg.mass_of(body))
    places = leg.marker_positions(values, marker_sites.load())
    for k, marker in enumerate(marker_sites.load().names):
        far = 1e3 * np.abs(places[:, k] - theirs.markers[marker]).max()
        agree("markers, written .osim", "OpenSim", far, 0.05, "mm")
    assert sum(
        model.getBodySet().get(k).getMass() for k in range(model.getNumBodies())
    ) == pytest.approx(62.0)
