"""Joint coordinates of other people's files: wraps, wrong units, jumps, rows written twice."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.mocap.coordinates import RawCoordinates

NAMES = (
    *("pelvis_tilt", "pelvis_list", "pelvis_rotation", "pelvis_tx", "pelvis_ty", "pelvis_tz"),
    *("hip_flexion_r", "hip_adduction_r", "hip_rotation_r", "knee_angle_r", "ankle_angle_r"),
    *("hip_flexion_l", "hip_adduction_l", "hip_rotation_l", "knee_angle_l", "ankle_angle_l"),
)
TIMES = np.arange(240) / 120
SLIDING = [NAMES.index(f"pelvis_t{axis}") for axis in "xyz"]
TURNING = [k for k in range(len(NAMES)) if k not in SLIDING]


def squat() -> np.ndarray:
    """A squat in rad and m (n, c)."""
    bend = 0.5 * (1 - np.cos(np.pi * TIMES))
    deep = np.radians([-17, -1, 3, 0, 0, 0, 52, -9, -10, -60, 25, 52, -10, -9, -60, 25])
    stands = np.radians([4, 1, 3, 0, 0, 0, 5, -4, -3, -4, 6, 4, -5, -4, -5, 6])
    values = stands + bend[:, None] * (deep - stands)
    values[:, SLIDING] = [0.04, 0.95, -0.02] + bend[:, None] * [0.1, -0.13, 0]
    return values


def raw(values, *, degrees: bool | None = False, times=TIMES, names=NAMES) -> RawCoordinates:
    return RawCoordinates("m.mot", np.asarray(times), tuple(names), np.asarray(values), degrees)


def in_degrees(values) -> np.ndarray:
    turned = values.copy()
    turned[:, TURNING] = np.degrees(turned[:, TURNING])
    return turned


@pytest.mark.parametrize("degrees", [False, True])
def test_a_squat_is_taken_as_it_is_without_a_word(degrees):
    given = in_degrees(squat()) if degrees else squat()
    motion, notes = raw(given, degrees=degrees).to_plausible_motion()
    np.testing.assert_allclose(motion.values, squat(), atol=1e-14)
    assert notes == ()


@pytest.mark.parametrize("degrees", [False, True])
@pytest.mark.parametrize("convention", ["-180 to 180", "0 to 360"])
@pytest.mark.parametrize("name", ["pelvis_rotation", "pelvis_tilt", "hip_rotation_r"])
def test_angles_that_wrap_are_unwrapped_and_reported(name, convention, degrees):
    values, k = squat(), NAMES.index(name)
    values[:, k] = 0.3 * np.sin(3 * TIMES) + (np.pi if name.startswith("pelvis") else 0)
    wrapped = values.copy()
    turn = 2 * np.pi
    low = -np.pi if convention.startswith("-") else 0.0
    wrapped[:, k] = (values[:, k] - low) % turn + low
    given = in_degrees(wrapped) if degrees else wrapped
    motion, notes = raw(given, degrees=degrees).to_plausible_motion()
    off = motion.coordinate(name) - values[:, k]
    np.testing.assert_allclose(off, turn * np.round(off[0] / turn), atol=1e-12)
    wraps = np.abs(np.diff(wrapped[:, k])).max() > np.pi
    assert [name in note and "unwrapped" in note for note in notes] == [True] * int(wraps)


def test_joints_counted_from_0_to_360_without_a_wrap_are_turned():
    values = squat()
    values[:, TURNING] %= 2 * np.pi
    motion, notes = raw(in_degrees(values), degrees=True).to_plausible_motion()
    np.testing.assert_allclose(motion.coordinate("knee_angle_l"), squat()[:, 14], atol=1e-12)
    assert any("knee_angle_l is counted from 0 to 360" in note for note in notes)


@pytest.mark.parametrize("rows", [slice(None), slice(0, 30)], ids=["squat", "stance"])
@pytest.mark.parametrize("full_turn", [False, True])
def test_radians_that_the_file_calls_degrees_are_refused_with_the_fix(rows, full_turn):
    values = squat()[rows]
    if full_turn:
        values[:, TURNING] %= 2 * np.pi
    given = raw(values, degrees=True, times=TIMES[rows])
    with pytest.raises(LegsimError, match=r"as radians do.*write inDegrees=no.*motion\.angles=rad"):
        given.to_plausible_motion()
    assert given.to_plausible_motion(in_degrees=True)[0].values[0, 0] == np.deg2rad(values[0, 0])
    np.testing.assert_array_equal(given.to_motion(in_degrees=False).values, values)


@pytest.mark.parametrize("rows", [slice(None), slice(0, 30)], ids=["squat", "stance"])
def test_degrees_that_the_file_calls_radians_are_refused_with_the_fix(rows):
    given = raw(in_degrees(squat())[rows], times=TIMES[rows])
    with pytest.raises(LegsimError, match=r"degrees at 0 s, which no joint.*write inDegrees=yes"):
        given.to_plausible_motion()
    motion, _ = given.to_plausible_motion(in_degrees=True)
    np.testing.assert_allclose(motion.values, squat()[rows], atol=1e-14)


def test_a_pose_of_zeros_may_be_in_either_unit():
    values = np.zeros((240, len(NAMES)))
    for degrees in (False, True):
        assert raw(values, degrees=degrees).to_plausible_motion()[1] == ()


@pytest.mark.parametrize(("unit", "factor"), [("mm", 1000.0), ("cm", 100.0), ("in", 1 / 0.0254)])
def test_positions_in_another_unit_are_refused_with_the_fix(unit, factor):
    values = squat()
    values[:, SLIDING] *= factor
    with pytest.raises(
        LegsimError, match=rf"pelvis_ty is .* m in the median.*motion\.unit={unit} "
    ):
        raw(values[:, 4:5], names=["pelvis_ty"]).to_plausible_motion()
    motion, _ = raw(values).to_plausible_motion(unit=unit)
    np.testing.assert_allclose(motion.values, squat(), atol=1e-12)


def test_the_height_of_the_pelvis_tells_the_unit_of_all_its_positions():
    """Forward and sideways positions may be any number of meters."""
    values = squat()
    values[:, SLIDING] *= 1000.0
    values[:, SLIDING[0]] = -200.0
    with pytest.raises(LegsimError, match=r"pelvis_ty is .*motion\.unit=mm"):
        raw(values).to_plausible_motion()


@pytest.mark.parametrize(
    ("factor", "what"),
    [(1000.0, "milliseconds"), (120.0, "numbers of frames"), (1e6, "milliseconds")],
)
def test_times_in_another_unit_are_refused(factor, what):
    with pytest.raises(LegsimError, match=rf"\(time\): a sample every .*{what}; write seconds"):
        raw(squat(), times=np.round(TIMES * factor, 9)).to_plausible_motion()


def test_a_few_poses_may_be_a_second_apart():
    assert raw(squat()[:5], times=np.arange(5.0)).to_plausible_motion()[1] == ()


@pytest.mark.parametrize(("name", "size", "stated"), [
    ("pelvis_tx", 0.5, "0.5 m"), ("pelvis_ty", -0.05, "0.05 m"), ("knee_angle_l", 0.4, "22.9 degrees"),
    ("pelvis_rotation", 3.0, "172 degrees"),
])  # fmt: skip
def test_a_step_is_reported_with_time_coordinate_and_size(name, size, stated):
    values = squat()
    k = NAMES.index(name)
    values[120:, k] += size
    motion, notes = raw(values).to_plausible_motion()
    np.testing.assert_array_equal(motion.values, values)
    assert len(notes) == 1
    assert notes[0].startswith(f"warning: {name} jumps by {stated} at 1 s, within 0.00833 s")


def test_somebody_who_stops_for_a_sample_halts():
    """Two strides put together with the frame between them twice."""
    values = squat()
    values[:, 3] = 6 * TIMES
    values[120:, 3] -= 6 * (TIMES[1] - TIMES[0])
    (note,) = raw(values).to_plausible_motion()[1]
    assert note.startswith("warning: pelvis_tx halts: it moves by 0 instead of 0.05 m at 1 s")


@pytest.mark.parametrize(("step", "said"), [
    (-3.5, "jumps by 7.5 degrees"),
    (-0.1, "halts: it moves by 0.1 instead of 4 degrees"),
    (0.5, "halts: it moves by 0.5 instead of 4 degrees"),
    (9.0, "jumps by 9 degrees"),
])  # fmt: skip
def test_a_step_back_is_a_jump_from_where_the_joint_would_be(step, said):
    steps = np.full(39, 4.0)
    steps[20] = step
    knee = np.radians(np.cumsum([-100, *steps]))
    file = raw(knee[:, None], times=np.arange(40) / 240, names=("knee_angle_r",))
    (note,) = file.to_plausible_motion()[1]
    assert note.startswith(f"warning: knee_angle_r {said} at 0.0875 s")


@pytest.mark.parametrize("noise", [0.0, 0.002])
def test_a_jump_of_somebody_alive_is_no_step(noise, rng):
    """3 m/s and 20 rad/s, as in sprints and kicks, seen by a pose estimator with noise."""
    values = squat()
    values[:, 3] += 0.3 * np.sin(10 * TIMES)
    values[:, 9] -= 0.6 + 0.6 * np.sin(30 * TIMES)
    values += noise * rng.standard_normal(values.shape)
    assert raw(values).to_plausible_motion()[1] == ()


def test_a_row_written_twice_with_rounded_times_is_left_out():
    times, values = np.insert(TIMES, 100, TIMES[99] + 1e-9), np.insert(squat(), 100, squat()[99], 0)
    motion, notes = raw(values, times=times).to_plausible_motion()
    np.testing.assert_array_equal(motion.times, TIMES)
    np.testing.assert_array_equal(motion.values, squat())
    assert notes == (
        "1 row left out, which follow the row before by less than any rounding (first 1e-09 s "
        "after 0.825 s)",
    )


def test_every_second_row_written_twice_is_left_out():
    """A motion of 60 Hz that was written at 120."""
    given = squat()[np.arange(240) // 2 * 2]
    motion, notes = raw(given).to_plausible_motion()
    np.testing.assert_array_equal(motion.values, squat()[::2])
    np.testing.assert_array_equal(motion.times, TIMES[::2])
    (note,) = notes
    assert note.startswith("warning: 120 of 240 frames repeat the frame before exactly")


def test_a_computed_movement_may_pause():
    given = squat()
    given[100:120] = given[99]
    motion, notes = raw(given).to_plausible_motion()
    assert len(motion.times) == 240
    assert notes == ()


def test_degrees_whose_widest_step_is_that_of_a_turn_in_radians_are_degrees():
    """A knee of 120 degrees that is sampled with few frames may step by 6.28 degrees."""
    values = in_degrees(squat())[::8]
    k = NAMES.index("knee_angle_l")
    values[:, k] = -120.0 + 0.1 * np.arange(len(values))
    values[15:, k] += 2 * np.pi - 0.1
    values[:, [j for j in TURNING if j != k]] *= 0.02
    motion, _ = raw(values, degrees=True, times=TIMES[::8]).to_plausible_motion()
    assert motion.coordinate("knee_angle_l")[0] == pytest.approx(np.radians(-120))


def test_the_lengths_of_a_users_model_are_in_the_given_unit_whatever_their_names():
    values = np.array([[900.0, 400.0, 0.1]] * 30)
    found = raw(values, times=TIMES[:30], names=("pelvis_ty", "glide", "knee_angle_r"))
    motion = found.to_motion(unit="mm", rotations=("knee_angle_r",), lengths=("pelvis_ty", "glide"))
    np.testing.assert_allclose(motion.values[0], [0.9, 0.4, 0.1])
    by_name = found.to_motion(unit="mm")
    np.testing.assert_allclose(by_name.values[0], [0.9, 400, 0.1])
