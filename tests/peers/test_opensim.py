"""The leg, its scaling and its inverse kinematics are OpenSim's (pip install opensim; python -m
pytest -m peer).
"""

import numpy as np
import pytest

from legsim.core import transforms
from legsim.imu import simulation
from legsim.imu.sensors import Sensor
from legsim.kinematics import inverse_kinematics
from legsim.kinematics.joint_splines import JointSplines
from legsim.kinematics.leg_model import COORDINATES, LegModel
from legsim.kinematics.skeleton import SEGMENTS, SegmentScales
from legsim.mocap.trajectories import JointTrajectories

pytestmark = [pytest.mark.peer, pytest.mark.filterwarnings("ignore::DeprecationWarning")]
POSTURES = 500


@pytest.fixture(scope="session")
def opensim_peer():
    pytest.importorskip("opensim", reason="pip install opensim")
    from tools.benchmarks.peers import opensim_kinematics as opensim_peer

    return opensim_peer


@pytest.fixture(scope="session")
def model_file(shared_data):
    return shared_data / "opensim/gait2392_thelen2003muscle.osim"


@pytest.fixture(params=["generic", "scaled"])
def scales(request):
    if request.param == "generic":
        return None
    return SegmentScales(np.random.default_rng(4).uniform(0.8, 1.2, (len(SEGMENTS), 3)))


def test_poses_agree_in_random_postures(opensim_peer, model_file, scales, rng, agree):
    leg = LegModel.load(scales)
    low, high = leg.coordinate_ranges.T
    values = low + (high - low) * rng.random((POSTURES, len(COORDINATES)))
    theirs = opensim_peer.body_poses(opensim_peer.load(model_file, scales), values)
    poses = leg.segment_poses(
        JointTrajectories(np.arange(POSTURES, dtype=float), COORDINATES, values)
    )
    ours = np.stack([poses.of(name) for name in opensim_peer.BODIES], 1)
    away = np.linalg.norm(ours[..., :3, 3] - theirs[..., :3, 3], axis=-1).max()
    agree("positions of bodies, own leg", "OpenSim", 1e3 * away, 0.05, "mm")
    turned = transforms.rotation_angle(np.swapaxes(ours[..., :3, :3], -1, -2) @ theirs[..., :3, :3])
    agree("rotations of bodies, own leg", "OpenSim", np.degrees(turned.max()), 0.01, "deg")


def test_masses_mass_centers_and_inertias_agree(opensim_peer, model_file, scales, agree):
    leg, model = LegModel.load(scales), opensim_peer.load(model_file, scales)
    for name in opensim_peer.BODIES:
        body = model.getBodySet().get(name)
        inertia, center = body.get_inertia(), body.get_mass_center()
        agree("masses", "OpenSim", abs(leg.mass_of(name) / body.getMass() - 1), 1e-6, "1")
        ratios = leg.inertia_of(name) / [inertia.get(k) for k in range(3)]
        agree("moments of inertia", "OpenSim", np.abs(ratios - 1).max(), 1e-9, "1")
        away = leg.mass_center_of(name) - [center.get(k) for k in range(3)]
        agree("mass centers", "OpenSim", 1e3 * np.abs(away).max(), 1e-6, "mm")


@pytest.mark.parametrize("trial", [0, 1, 2], ids=["squats", "squats_seven", "walking"])
def test_inverse_kinematics_agrees_on_real_recordings(
    opensim_peer, model_file, shared_data, trial, agree
):
    from tools.benchmarks import ik as bench_ik

    problem = bench_ik.prepare(shared_data / "mocap", bench_ik.TRIALS[trial])
    some = slice(0, 151)
    motion = type(problem.motion)(
        problem.motion.times[some],
        problem.motion.marker_names,
        problem.motion.positions_world[some],
    )
    ours = inverse_kinematics.solve(problem.leg, motion, problem.sites, bench_ik.SAME_TASKS)
    model = opensim_peer.load(model_file, problem.leg.scales)
    theirs = opensim_peer.inverse_kinematics(model, problem.sites, motion, accuracy=1e-10)
    assert len(ours.report.frames_unconverged) == 0
    costs = [
        ((p - motion.positions_world) ** 2).sum(-1) @ problem.sites.weights
        for p in (ours.modelled.positions_world, theirs.markers)
    ]
    more = (costs[0] / costs[1]).max() - 1
    agree("cost of markers in a frame, more than", "OpenSim", more, 1e-3, "1")
    # seven markers do not see the ankle
    unseen = ("ankle", "subtalar", "mtp") if trial == 1 else ()
    seen = [k for k, name in enumerate(COORDINATES) if not name.startswith(unseen or "-")]
    difference = ours.trajectories.values - theirs.values
    rms = np.sqrt((difference**2).mean(0))
    shifts = [COORDINATES.index(name) for name in ("pelvis_tx", "pelvis_ty", "pelvis_tz")]
    turned = np.degrees(rms[[k for k in seen if k not in shifts]]).max()
    agree("joint angles of recordings, RMS", "OpenSim", turned, 0.5, "deg")
    agree("pelvis of recordings, RMS", "OpenSim", 1e3 * rms[shifts].max(), 1.0, "mm")


@pytest.mark.parametrize("segment", ["tibia_l", "femur_l", "pelvis", "calcn_r"])
def test_sensors_agree_on_the_same_splines(opensim_peer, model_file, scales, segment, rng, agree):
    """Samples at 120 Hz of lively sines around a squat, splined by either; 1e-3 m/s^2 and 1e-4
    rad/s are demanded.
    """
    leg = LegModel.load(scales)
    times = np.arange(0, 3, 1 / 120)
    rate = 2 * np.pi * rng.uniform(0.3, 2.0, (2, len(COORDINATES)))
    waves = np.sin(times[:, None, None] * rate + rng.uniform(0, 6, rate.shape)).sum(1)
    base = np.array(
        [
            np.radians({"knee": -60, "hip_f": 50, "ankle": 20}.get(n[:5].rstrip("_"), 0))
            for n in COORDINATES
        ]
    )
    motion = JointTrajectories(times, COORDINATES, leg.default_coordinates + base + 0.05 * waves)
    sensor = Sensor.placed("s", segment, 0.14, (0.05, 0.01, -0.03), (0.4, -0.3, 0.8))
    at = np.linspace(1.0, 2.0, 25)
    ours = simulation.simulate(leg, JointSplines(motion), [sensor], at)
    theirs = opensim_peer.sensor_signals(
        opensim_peer.load(model_file, scales), motion, segment, sensor.segment_from_sensor, at
    )
    turning = np.abs(ours.angular_velocity[:, 0] - theirs[0]).max()
    agree("angular velocity of a sensor", "OpenSim", turning, 1e-4, "rad/s")
    force = np.abs(ours.specific_force[:, 0] - theirs[1]).max()
    agree("specific force of a sensor", "OpenSim", force, 1e-3, "m/s²")
    # not by lying still
    assert ours.specific_force[:, 0].std(0).max() > 0.5
