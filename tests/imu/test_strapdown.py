import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.imu import strapdown
from legsim.imu.signals import SensorStart
from legsim.imu.strapdown import Scheme
from tests.references.sway import GRAVITY, Sway

VIEWS = np.arange(248) / 31.0


def start_of(sway: Sway, at: np.ndarray) -> SensorStart:
    return SensorStart(sway.poses(at[:1])[0], sway.velocities(at[:1])[0])


def estimated(
    sway: Sway, rate_hz: float, at: np.ndarray, scheme: Scheme = "accurate"
) -> np.ndarray:
    times = np.arange(int(np.ceil(at[-1] * rate_hz)) + 2) / rate_hz
    return strapdown.integrate(times, *sway.signals(times), start_of(sway, at), at, scheme=scheme)


def errors(poses: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(mm, deg) at every time."""
    away = np.linalg.norm(poses[:, :3, 3] - truth[:, :3, 3], axis=-1)
    turned = transforms.rotation_angle(np.swapaxes(truth[:, :3, :3], -1, -2) @ poses[:, :3, :3])
    return away * 1e3, np.degrees(turned)


def test_noise_free_drift_after_eight_seconds_is_far_below_a_voxel():
    for seed in range(5):
        sway = Sway.standing(seed)
        away, turned = errors(estimated(sway, 120, VIEWS), sway.poses(VIEWS))
        assert away.max() < 1e-4  # mm
        assert turned.max() < 1e-7  # deg


@pytest.mark.parametrize(
    ("rate_hz", "mm", "deg"),
    [(31, 2e-2, 2e-5), (60, 1e-3, 1e-6), (200, 1e-5, 1e-8), (1000, 1e-6, 1e-9)],
)
def test_drift_at_other_rates(rate_hz: float, mm: float, deg: float):
    sway = Sway.standing(1)
    away, turned = errors(estimated(sway, rate_hz, VIEWS), sway.poses(VIEWS))
    assert away.max() < mm
    assert turned.max() < deg


def test_order_of_the_accurate_scheme():
    # doubling the rate gains more than a fourth-order method's 16
    sway = Sway.standing(2, position_mm=20, angle_deg=8)
    coarse, fine = (
        errors(estimated(sway, rate, VIEWS), sway.poses(VIEWS))[0].max() for rate in (20, 40)
    )
    assert coarse / fine > 16


def test_published_recursion_drifts_as_a_first_order_scheme_does():
    # millimeters at every rate, and only half of it gone when the rate doubles
    sway = Sway.standing(3)
    found = []
    for rate_hz in (31, 62, 124):
        at = np.arange(8 * rate_hz) / rate_hz
        found.append(
            np.sqrt((errors(estimated(sway, rate_hz, at, "paper"), sway.poses(at))[0] ** 2).mean())
        )
    assert found[0] > 2
    assert found[0] / found[1] == pytest.approx(2, rel=0.15)
    assert found[1] / found[2] == pytest.approx(2, rel=0.15)


def test_published_recursion_is_the_papers_equations():
    """Written out with the paper's own quantities: S' = Dg S, Dg = S Dl S^-1, v' = G^T (a + g + v),
    all per sample.
    """
    sway, dt = Sway.standing(4), 1 / 31
    times = np.arange(60) * dt
    rate, force = sway.signals(times)
    pose, v = sway.poses(times)[0], sway.poses(times)[0][:3, :3].T @ sway.velocities(times)[0] * dt
    for t in range(59):
        g_matrix = transforms.rotation_from_vector(rate[t] * dt)
        delta_global = pose @ transforms.rigid(g_matrix, v) @ np.linalg.inv(pose)
        v = g_matrix.T @ (force[t] * dt**2 + pose[:3, :3].T @ GRAVITY * dt**2 + v)
        pose = delta_global @ pose
    got = strapdown.integrate(times, rate, force, start_of(sway, times), times, scheme="paper")[-1]
    np.testing.assert_allclose(got, pose, atol=1e-12)


def test_a_sensor_at_rest_stays():
    base = transforms.rotation_from_vector([0.3, -0.8, 1.2])
    times = np.arange(961) / 120
    force = np.broadcast_to(base.T @ -GRAVITY, (961, 3))
    start = SensorStart(transforms.rigid(base, [1.0, 2.0, 3.0]), np.zeros(3))
    for scheme in ("accurate", "paper"):
        poses = strapdown.integrate(times, np.zeros((961, 3)), force, start, VIEWS, scheme=scheme)
        np.testing.assert_allclose(
            poses, np.broadcast_to(start.world_from_sensor, poses.shape), atol=1e-11
        )


def test_uniform_circle_with_constant_signals():
    # turning about world z at w on radius r: constant rate, constant centripetal force plus gravity
    # turned into the sensor
    w, r, times = 1.5, 0.2, np.arange(0, 4.001, 0.01)
    rotation = transforms.axis_rotation([0, 0, 1], w * times)
    force = np.array([-(w**2) * r, 0, 0]) - np.einsum("nji,j->ni", rotation, GRAVITY)
    start = SensorStart(transforms.rigid(np.eye(3), [r, 0, 0]), np.array([0, w * r, 0]))
    poses = strapdown.integrate(times, np.tile([0, 0, w], (len(times), 1)), force, start, times)
    expected = transforms.rigid(
        rotation, r * np.stack([np.cos(w * times), np.sin(w * times), 0 * times], -1)
    )
    np.testing.assert_allclose(poses, expected, atol=1e-9)


def test_coning_is_followed():
    # the axis of rotation itself turns: the mean rate alone would drift
    spin, tilt, times = 2 * np.pi * 3, np.radians(5), np.arange(481) / 120
    rotation = (
        transforms.axis_rotation([0, 0, 1], spin * times)
        @ transforms.axis_rotation([1, 0, 0], tilt)
        @ transforms.axis_rotation([0, 0, 1], -spin * times)
    )
    back = np.swapaxes(rotation, -1, -2)
    rate = spin * (np.einsum("nij,j->ni", back, [0, 0, 1.0]) - [0, 0, 1])
    start = SensorStart(transforms.rigid(rotation[0], np.zeros(3)), np.zeros(3))
    poses = strapdown.integrate(times, rate, -np.einsum("nij,j->ni", back, GRAVITY), start, times)
    assert (
        np.degrees(
            transforms.rotation_angle(np.swapaxes(rotation, -1, -2) @ poses[:, :3, :3])
        ).max()
        < 2e-5
    )


def test_a_change_of_world_changes_nothing_but_the_world():
    """About the vertical and anywhere: the same signals from a turned start give turned poses."""
    sway = Sway.standing(5)
    times = np.arange(400) / 120
    signals, start = sway.signals(times), start_of(sway, times)
    moved = transforms.rigid(transforms.axis_rotation([0, 1, 0], 0.7), [3.0, -1.0, 0.5])
    other = SensorStart(moved @ start.world_from_sensor, moved[:3, :3] @ start.velocity)
    for scheme in ("accurate", "paper"):
        expected = moved @ strapdown.integrate(times, *signals, start, times[::7], scheme=scheme)
        np.testing.assert_allclose(
            strapdown.integrate(times, *signals, other, times[::7], scheme=scheme),
            expected,
            atol=1e-10,
        )


def test_integration_can_stop_and_go_on():
    sway = Sway.standing(6)
    times = np.arange(961) / 120
    whole = estimated(sway, 120, np.array([0.5, 3.21, 7.0]))
    middle = np.array([3.21, 7.0])
    rest = strapdown.integrate(times, *sway.signals(times), start_of(sway, middle), middle)
    np.testing.assert_allclose(rest[-1], whole[-1], atol=1e-7)


def test_uneven_samples():
    sway, rng = Sway.standing(7), np.random.default_rng(7)
    times = np.sort(np.concatenate([[0, 8.0], rng.uniform(0, 8, 1500)]))
    poses = strapdown.integrate(
        times, *sway.signals(times), start_of(sway, VIEWS[:240]), VIEWS[:240]
    )
    assert errors(poses, sway.poses(VIEWS[:240]))[0].max() < 0.05


def trapezoid_positions(
    times: np.ndarray, rate: np.ndarray, force: np.ndarray, start: SensorStart
) -> np.ndarray:
    """The plainest second-order integration, at the samples: what noise does to it is what noise
    must do.
    """
    rotation, velocity, position = (
        start.world_from_sensor[:3, :3],
        start.velocity,
        start.world_from_sensor[:3, 3],
    )
    found = [position]
    for k, dt in enumerate(np.diff(times)):
        after = rotation @ transforms.rotation_from_vector(dt * (rate[k] + rate[k + 1]) / 2)
        gain = dt * ((rotation @ force[k] + after @ force[k + 1]) / 2 + GRAVITY)
        position, velocity, rotation = position + dt * (velocity + gain / 2), velocity + gain, after
        found.append(position)
    return np.array(found)


def test_splines_amplify_noise_no_more_than_a_trapezoid():
    """The same noise through both: RMS drift over many draws agrees within a few per cent."""
    rng, sway = np.random.default_rng(8), Sway.standing(8)
    times = np.arange(241) / 120
    rate, force = sway.signals(times)
    start, truth = start_of(sway, times), sway.poses(times)[:, :3, 3]
    spline_square, plain_square = 0.0, 0.0
    for _ in range(60):
        noisy = rate + rng.normal(0, 1e-3, rate.shape), force + rng.normal(0, 2e-2, force.shape)
        spline_square += (
            (strapdown.integrate(times, *noisy, start, times)[:, :3, 3] - truth) ** 2
        ).sum()
        plain_square += ((trapezoid_positions(times, *noisy, start) - truth) ** 2).sum()
    assert np.sqrt(spline_square / plain_square) == pytest.approx(1, abs=0.03)


def test_single_wanted_time_is_the_start():
    sway, times = Sway.standing(9), np.arange(10) / 120
    start = start_of(sway, np.array([0.02]))
    np.testing.assert_array_equal(
        strapdown.integrate(times, *sway.signals(times), start, [0.02])[0], start.world_from_sensor
    )


def test_two_samples_are_enough_for_a_straight_line():
    start = SensorStart(np.eye(4), np.zeros(3))
    poses = strapdown.integrate(
        [0.0, 1.0], np.zeros((2, 3)), [[0, 9.80665, 0], [6, 9.80665, 0]], start, [0, 0.5, 1.0]
    )
    np.testing.assert_allclose(poses[:, 0, 3], [0, 0.125, 1.0], atol=1e-12)  # 6 t^3/6


@pytest.mark.parametrize(
    ("at", "match"),
    [
        ([0.0, 9.0], "the sensor recorded 0 to"),
        ([-1.0, 1.0], "the sensor recorded 0 to"),
        ([1.0, 0.5], "must increase strictly"),
    ],
)
def test_refuses_times_outside(at: list[float], match: str):
    sway, times = Sway.standing(0), np.arange(120) / 120
    with pytest.raises(LegsimError, match=match):
        strapdown.integrate(times, *sway.signals(times), start_of(sway, times), at)


def test_refuses_samples_that_are_not_numbers():
    sway, times = Sway.standing(0), np.arange(120) / 120
    rate, force = sway.signals(times)
    force[17, 1] = np.nan
    with pytest.raises(LegsimError, match=r"sample 17 .* is not a number"):
        strapdown.integrate(times, rate, force, start_of(sway, times), times)


def test_refuses_a_start_that_is_no_pose():
    with pytest.raises(LegsimError, match="not a rigid pose"):
        SensorStart(np.diag([1.0, 1.0, -1.0, 1.0]), np.zeros(3))
    with pytest.raises(LegsimError, match="not finite"):
        SensorStart(np.eye(4), np.array([np.nan, 0, 0]))


def test_refuses_unknown_schemes():
    sway, times = Sway.standing(0), np.arange(120) / 120
    with pytest.raises(LegsimError, match="known: accurate, paper"):
        strapdown.integrate(
            times, *sway.signals(times), start_of(sway, times), times, scheme="fast"
        )  # type: ignore[arg-type]


@pytest.mark.parametrize("gaps", [False, True])
def test_a_long_recording_around_the_views_changes_nothing(rng, monkeypatch, gaps):
    """Also with gaps at the ends of the views, whose bridges reach beyond them."""
    sway, views = Sway.standing(1), VIEWS[:93]
    times = np.arange(-6000, 7000) / 200 + 1e-4 * rng.uniform(size=13000)
    if gaps:
        kept = np.abs(times[:, None] - [-0.05, 1.5, views[-1] + 0.05]).min(1) > 0.1
        times = times[kept]
    rate, force = sway.signals(times)
    force = force + 0.02 * rng.normal(size=force.shape)
    start = start_of(sway, views)
    lengths, through = [], strapdown._accurate
    monkeypatch.setattr(
        strapdown, "_accurate", lambda t, *rest: lengths.append(len(t)) or through(t, *rest)
    )
    near = strapdown.integrate(times, rate, force, start, views)
    monkeypatch.setattr(strapdown, "about", lambda *_: slice(None))
    np.testing.assert_allclose(
        near, strapdown.integrate(times, rate, force, start, views), rtol=0, atol=1e-13
    )
    assert lengths[0] < 1200 < 12000 < lengths[1]
