"""Options of inverse kinematics for whole recordings: on legsim's own leg and on a user's model."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.kinematics import from_recording, marker_sites, osim_file
from legsim.kinematics._ik_names import Tasks
from legsim.kinematics.ik_options import (
    CoordinateLock,
    CoordinatePrior,
    CoordinateTask,
    IkOptions,
    PriorStrengths,
    leg_priors,
)
from legsim.kinematics.ik_tasks import IkTaskSet
from legsim.kinematics.leg_model import COORDINATES, LegModel
from legsim.kinematics.osim_leg import OsimLeg
from legsim.mocap import trc
from legsim.mocap.labels import MarkerMap
from legsim.mocap.trajectories import MarkerTrajectories
from tests.examples import osim
from tests.examples.task_sets import coordinate, document, marker, task_set

LABELS = {
    "sacrum": "SACR",
    **{
        f"{role}_{side.lower()}": f"{side}{label}"
        for role, label in (
            ("asis", "ASI"),
            ("epicondyle_lateral", "KNE"),
            ("epicondyle_medial", "KNM"),
            ("malleolus_lateral", "ANK"),
            ("heel", "HEE"),
            ("toe", "TOE"),
        )
        for side in "RL"
    },
}
"""role and label of the made recording"""

TIMES = np.arange(60) / 60


@pytest.fixture(scope="module")
def marker_map(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("map") / "mine.toml"
    lines = [f'{role} = "{label}"' for role, label in LABELS.items()]
    path.write_text("\n".join(["[roles]", *lines]))
    return path


@pytest.fixture(scope="module")
def squat() -> MarkerTrajectories:
    """A squat with 2 mm of noise, so that weights matter."""
    leg, share = LegModel.load(), np.sin(np.pi * TIMES)[:, None] ** 2
    bent = leg.posture(*np.radians((50, -70, 15))) - leg.default_coordinates
    values = leg.default_coordinates + share * bent
    places = leg.marker_positions(values, marker_sites.load().only(list(LABELS)))
    places = places + 2e-3 * np.random.default_rng(5).normal(size=places.shape[1:])
    return MarkerTrajectories(TIMES, tuple(LABELS.values()), places)


def solved(folder, motion, marker_map, **keywords):
    trc.save(folder / "squat.trc", motion)
    return from_recording.solve_kinematics(folder / "squat.trc", marker_map=marker_map, **keywords)


def without(motion, *labels):
    kept = [k for k, name in enumerate(motion.marker_names) if name not in labels]
    names = tuple(motion.marker_names[k] for k in kept)
    return MarkerTrajectories(motion.times, names, motion.positions_world[:, kept])


def same(one, other) -> bool:
    return np.array_equal(one.trajectories.values, other.trajectories.values)


@pytest.mark.parametrize("name", ["RHEE", "heel_r"])
def test_a_marker_of_weight_zero_is_as_one_that_is_not_there(tmp_path, squat, marker_map, name):
    weighed = solved(tmp_path, squat, marker_map, ik=IkOptions(marker_weights={name: 0}))
    absent = solved(tmp_path, without(squat, "RHEE"), marker_map)
    assert same(weighed, absent)
    assert not same(weighed, solved(tmp_path, squat, marker_map))
    assert "heel_r" not in weighed.fit.ik.marker_names


def test_the_scaling_recording_keeps_a_marker_of_weight_zero(tmp_path, squat, marker_map):
    """Medial markers of a static trial, left out of the movement."""
    trc.save(tmp_path / "static.trc", squat)
    static = {"scale_from": tmp_path / "static.trc"}
    medial = {"RKNM": 0, "LKNM": 0}
    weighed = solved(tmp_path, squat, marker_map, ik=IkOptions(marker_weights=medial), **static)
    assert same(weighed, solved(tmp_path, without(squat, *medial), marker_map, **static))
    assert weighed.fit.scaling.measurement("knee_width_r").measured > 0


def test_a_heavy_marker_is_followed_more_closely(tmp_path, squat, marker_map):
    plain = solved(tmp_path, squat, marker_map, register=False)
    heavy = solved(
        tmp_path, squat, marker_map, register=False, ik=IkOptions(marker_weights={"RKNE": 50})
    )
    k = plain.fit.ik.marker_names.index("epicondyle_lateral_r")
    assert heavy.fit.ik.marker_rms[k] < 0.2 * plain.fit.ik.marker_rms[k]
    assert heavy.fit.sites.weights[k] == 50


def test_a_needed_marker_of_weight_zero_is_refused_with_the_fix(tmp_path, squat, marker_map):
    with pytest.raises(LegsimError, match=r"leaves out asis_r, which scaling.*scaling_file"):
        solved(tmp_path, squat, marker_map, ik=IkOptions(marker_weights={"RASI": 0}))


def test_unknown_names_are_refused_with_the_valid_ones(tmp_path, squat, marker_map):
    with pytest.raises(LegsimError, match=r"squat\.trc.*RHEL is no marker.*heel_r.*RHEE"):
        solved(tmp_path, squat, marker_map, ik=IkOptions(marker_weights={"RHEL": 1}))
    names = ("nose", "mtp_angle_r")
    motion = MarkerTrajectories(
        TIMES, (*squat.marker_names, names[0]), np.append(squat.positions_world,
        squat.positions_world[:, :1] + 0.5, 1)
    )  # fmt: skip
    with pytest.raises(LegsimError, match="nose plays no role"):
        solved(tmp_path, motion, marker_map, ik=IkOptions(marker_weights={"nose": 1}))
    for options in (
        IkOptions(tasks=(CoordinateTask("knee", 1),)),
        IkOptions(locked=(CoordinateLock("knee"),)),
    ):
        with pytest.raises(LegsimError, match=r"unknown coordinate 'knee'.*knee_angle_r"):
            solved(tmp_path, squat, marker_map, ik=options)


def test_a_role_that_the_recording_lacks_may_be_weighed_and_is_mentioned(
    tmp_path, squat, marker_map
):
    found = solved(tmp_path, squat, marker_map, ik=IkOptions(marker_weights={"meta1_r": 3}))
    assert same(found, solved(tmp_path, squat, marker_map))
    assert any("this recording lacks: meta1_r" in note for note in found.notes)


@pytest.mark.parametrize(
    ("name", "value"), [("subtalar_angle_r", None), ("knee_angle_l", -0.3), ("pelvis_list", 0.02)]
)
def test_a_locked_coordinate_stays_to_the_bit(tmp_path, squat, marker_map, name, value):
    found = solved(tmp_path, squat, marker_map, ik=IkOptions(locked=(CoordinateLock(name, value),)))
    np.testing.assert_array_equal(found.trajectories.coordinate(name), value or 0.0)
    k = COORDINATES.index(name)
    assert found.fit.spread[k] < 1e-6
    assert found.fit.ik.coordinate_share[k] < 1e-6
    assert found.fit.ik.coordinate_at_limit[k] == 0
    assert len(found.fit.ik.frames_unconverged) == 0


@pytest.mark.parametrize(
    ("lock", "said"),
    [
        (CoordinateLock("knee_angle_r", 1.0), "knee_angle_r cannot be locked at 57.29.* deg"),
        (CoordinateLock("pelvis_ty", 1.0, "rad"), "pelvis_ty is a length; give .* mm"),
        (CoordinateLock("knee_angle_r", -0.1, "m"), "knee_angle_r is an angle; give .*degrees"),
    ],
)
def test_a_lock_that_cannot_be_is_refused(tmp_path, squat, marker_map, lock, said):
    with pytest.raises(LegsimError, match=said):
        solved(tmp_path, squat, marker_map, ik=IkOptions(locked=(lock,)))


def test_a_task_of_huge_weight_holds_the_value(tmp_path, squat, marker_map):
    task = CoordinateTask("knee_angle_r", 1e6, np.radians(-20))
    found = solved(tmp_path, squat, marker_map, ik=IkOptions(tasks=(task,)))
    angle = np.degrees(found.trajectories.coordinate("knee_angle_r"))
    np.testing.assert_allclose(angle, -20, atol=1e-3)


def test_a_task_is_weighed_against_the_mean_over_the_markers_as_in_opensim(
    tmp_path, squat, marker_map
):
    """Twice the weight of all markers changes nothing, also where some are not seen."""
    gaps = squat.positions_world.copy()
    gaps[20:40, squat.marker_names.index("RHEE")] = np.nan
    motion = MarkerTrajectories(TIMES, squat.marker_names, gaps)
    task = CoordinateTask("knee_angle_r", 1e-2, np.radians(-20))
    none = PriorStrengths(0, 0, 0, 0, 0)
    found = []
    for weight in (1.0, 2.0):
        weights = dict.fromkeys(LABELS, weight)
        options = IkOptions(marker_weights=weights, tasks=(task,), strengths=none)
        found.append(
            solved(
                tmp_path, motion, marker_map, ik=options, register=False, longest_gap=0,
            ).trajectories.coordinate("knee_angle_r")
        )  # fmt: skip
    np.testing.assert_allclose(found[0], found[1], atol=1e-7)
    assert -60 < np.degrees(found[0][30]) < -21


def test_what_is_pulled_and_locked_is_said_and_a_value_beyond_the_range(
    tmp_path, squat, marker_map
):
    options = IkOptions(
        tasks=(CoordinateTask("knee_angle_r", 1e-4, 1.0), CoordinateTask("pelvis_ty", 1e-4)),
        locked=(CoordinateLock("mtp_angle_r"),),
    )
    notes = solved(tmp_path, squat, marker_map, ik=options).notes
    assert "locked: mtp_angle_r" in notes
    assert "pulled by tasks: knee_angle_r (0.0001), pelvis_ty (0.0001)" in notes
    (warning,) = [note for note in notes if note.startswith("warning")]
    assert "knee_angle_r pulls to 57.3 deg, beyond its range of -160 to 20 deg" in warning
    plain = solved(tmp_path, squat, marker_map).notes
    assert not any("pulled" in note or "locked" in note for note in plain)


def test_an_unknown_coordinate_of_a_task_is_refused_on_any_leg(tmp_path, squat, marker_map):
    with pytest.raises(LegsimError, match="unknown coordinate 'lumbar' for a task"):
        solved(tmp_path, squat, marker_map, ik=IkOptions(tasks=(CoordinateTask("lumbar", 1),)))


def test_priors_off_are_priors_of_no_weight(tmp_path, squat, marker_map):
    off = solved(tmp_path, squat, marker_map, ik=IkOptions(strengths=PriorStrengths(0, 0, 0, 0, 0)))
    priors = tuple(CoordinatePrior(p.coordinate, 0.0) for p in leg_priors())
    zero = solved(tmp_path, squat, marker_map, ik=IkOptions(priors=priors, flat_foot_weight=0.0))
    assert same(off, zero)
    assert not same(off, solved(tmp_path, squat, marker_map))


def test_tasks_of_a_file_are_those_of_the_options_to_the_bit(tmp_path, squat, marker_map):
    weights = {label: 1.0 + k / 4 for k, label in enumerate(LABELS.values())} | {"RTOE": 0.0}
    text = task_set(
        *(marker(label, weight) for label, weight in weights.items() if weight),
        marker("Sternum", 3),
        coordinate("subtalar_angle_r", 0.5, "manual_value", 0.1),
        coordinate("lumbar_extension", 10),
    )
    (tmp_path / "tasks.xml").write_text(document(text))
    by_file = solved(tmp_path, squat, marker_map, ik=IkOptions(tasks_file=tmp_path / "tasks.xml"))
    given = IkOptions(marker_weights=weights, tasks=(CoordinateTask("subtalar_angle_r", 0.5, 0.1),))
    assert same(by_file, solved(tmp_path, squat, marker_map, ik=given))
    said = "\n".join(by_file.notes)
    assert "tasks.xml: tasks of markers that are not on these legs: Sternum" in said
    assert "tasks.xml: no task, so left out: toe_r" in said
    assert "no free coordinate of the legs: lumbar_extension" in said
    over = replace(given, marker_weights={"RTOE": 2.0, "heel_r": 0.0}, tasks=(
        CoordinateTask("subtalar_angle_r", 0.0),), tasks_file=tmp_path / "tasks.xml")  # fmt: skip
    plain = IkOptions(marker_weights=weights | {"RTOE": 2.0, "RHEE": 0.0})
    assert same(
        solved(tmp_path, squat, marker_map, ik=over),
        solved(tmp_path, squat, marker_map, ik=plain),
    )


def test_a_mean_of_two_labels_has_the_mean_of_their_weights(tmp_path, squat):
    """And none where one of them has none."""
    places = squat.positions_world
    back = squat.marker_names.index("SACR")
    apart = np.array([0.0, 0.0, 0.04])
    motion = MarkerTrajectories(
        TIMES,
        (*without(squat, "SACR").marker_names, "BACK1", "BACK2"),
        np.concatenate(
            [np.delete(places, back, 1), places[:, [back]] + apart, places[:, [back]] - apart], 1
        ),
    )
    roles = {**{r: f'"{n}"' for r, n in LABELS.items()}, "sacrum": '["BACK1", "BACK2"]'}
    path = tmp_path / "two.toml"
    path.write_text("\n".join(["[roles]", *(f"{r} = {n}" for r, n in roles.items())]))
    weights = {"BACK1": 2.0, "BACK2": 4.0}
    found = solved(tmp_path, motion, path, ik=IkOptions(marker_weights=weights))
    assert found.fit.sites.weights[found.fit.sites.index("sacrum")] == 3
    with pytest.raises(LegsimError, match="leaves out sacrum"):
        solved(tmp_path, motion, path, ik=IkOptions(marker_weights={"BACK1": 0, "BACK2": 4}))


def test_labels_are_found_with_what_all_of_the_recording_share():
    """The side of a role's two labels is no shared beginning."""
    names = [f"S01_{side}_knee_{at}" for side in "RL" for at in ("lat", "med")]
    knees = MarkerMap(
        "knees",
        ("epicondyle_lateral_r", "epicondyle_lateral_l"),
        ((tuple(names[:2]),), (tuple(names[2:]),)),
    )
    for given in ({"R_knee_lat": 0.0}, {"R_knee_lat": 0.0, "L_knee_med": 3.0}):
        tasks = Tasks(IkOptions(), IkTaskSet("tasks.xml", given, (), ()))
        weights, notes = tasks.marker_weights(knees, [*names, "S01_R_asis"], knees.roles)
        assert weights["epicondyle_lateral_r"] == 0
        untold = "" if len(given) > 1 else "tasks.xml: no task, so left out: epicondyle_lateral_l"
        assert "".join(notes) == untold


@pytest.mark.parametrize("sacrum", ['"SACR"', '["RPSI", "LPSI"]', None])
def test_the_middle_of_both_psis_counts_once_whatever_the_set_says(tmp_path, squat, sacrum):
    """One sacral marker, a mean of the PSIS, or none: the PSIS give the depth of the pelvis."""
    places, back = squat.positions_world, squat.marker_names.index("SACR")
    apart, below = np.array([0.0, 0.0, 0.04]), np.array([0.0, -0.02, 0.0])
    motion = MarkerTrajectories(
        TIMES,
        (*without(squat, "SACR").marker_names, "RPSI", "LPSI", "SACR"),
        np.concatenate(
            [np.delete(places, back, 1), *(places[:, [back]] + d for d in (apart, -apart, below))],
            1,
        ),
    )
    roles = {role: f'"{label}"' for role, label in LABELS.items()}
    roles |= {"psis_r": '"RPSI"', "psis_l": '"LPSI"', "sacrum": sacrum}
    path = tmp_path / "psis.toml"
    path.write_text("\n".join(["[roles]", *(f"{r} = {n}" for r, n in roles.items() if n)]))
    found = solved(tmp_path, motion, path)
    assert {"psis_r", "psis_l"} <= set(found.fit.sites.names)
    assert ("sacrum" in found.fit.sites.names) == (sacrum == '"SACR"')
    front = (motion.marker("RASI") + motion.marker("LASI")) / 2
    depth = np.linalg.norm(front[0] - places[0, back])
    assert found.fit.scaling.measurement("pelvis_depth").measured == pytest.approx(depth, rel=0.01)


def test_coordinates_take_no_options_of_inverse_kinematics(tmp_path):
    motion = tmp_path / "still.csv"
    rows = "\n".join(f"{t},0,-0.1" for t in TIMES)
    motion.write_text(f"time_s,hip_flexion_r_rad,knee_angle_r_rad\n{rows}\n")
    from_recording.solve_kinematics(motion)
    with pytest.raises(LegsimError, match=r"holds joint coordinates.*ik cannot apply"):
        from_recording.solve_kinematics(motion, ik=IkOptions(marker_weights={"heel_r": 1}))


@pytest.fixture
def model(tmp_path) -> Path:
    return osim.saved(tmp_path, osim.version_4(osim.two_legs(), markers=osim.MARKERS))


def on_model(folder, model, names, **keywords):
    """A squat of the model's own markers, solved with options."""
    leg = OsimLeg(osim_file.read(model))
    sites = leg.marker_sites()[0].only(names)
    bent = leg.posture(*np.radians((50, -70, 15))) - leg.default_coordinates
    values = leg.default_coordinates + np.sin(np.pi * TIMES)[:, None] ** 2 * bent
    places = leg.marker_positions(values, sites)
    places = places + 2e-3 * np.random.default_rng(5).normal(size=places.shape[1:])
    trc.save(folder / "m.trc", MarkerTrajectories(TIMES, sites.names, places))
    return from_recording.solve_kinematics(folder / "m.trc", model=model, **keywords)


def test_a_model_of_the_user_takes_weights_tasks_and_locks(tmp_path, model):
    names = OsimLeg(osim_file.read(model)).marker_sites()[0].names
    dropped, *rest = names[::-1]
    left = on_model(tmp_path, model, names, ik=IkOptions(marker_weights={dropped: 0}))
    assert dropped not in left.fit.ik.marker_names
    task = CoordinateTask("hip_a_r", 1e6, 0.3)
    lock = CoordinateLock("hip_b_l", 0.05)
    found = on_model(tmp_path, model, rest, ik=IkOptions(tasks=(task,), locked=(lock,)))
    np.testing.assert_allclose(found.trajectories.coordinate("hip_a_r"), 0.3, atol=1e-5)
    np.testing.assert_array_equal(found.trajectories.coordinate("hip_b_l"), 0.05)
    with pytest.raises(LegsimError, match=rf"NOBODY is no marker.*{rest[0]}"):
        on_model(tmp_path, model, names, ik=IkOptions(marker_weights={"NOBODY": 1}))
