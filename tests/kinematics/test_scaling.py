"""Scale factors: a known person is measured back, in any posture, and nonsense is refused."""

import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.kinematics import marker_sites, scaling
from legsim.kinematics.leg_model import COORDINATES, LegModel
from legsim.kinematics.marker_sites import MarkerSites
from legsim.kinematics.skeleton import SEGMENTS, SegmentScales, segment_index
from legsim.mocap.trajectories import MarkerTrajectories

GENERIC = LegModel.load()
SITES = marker_sites.load()
SEVEN = (
    "sacrum",
    *(
        f"{part}_{side}"
        for part in ("asis", "epicondyle_lateral", "malleolus_lateral")
        for side in "rl"
    ),
)
MORE = (
    *SEVEN,
    *(
        f"{part}_{side}"
        for part in ("epicondyle_medial", "malleolus_medial", "heel", "meta5")
        for side in "rl"
    ),
)


def person(seed=0):
    """A leg with its own proportions and sites whose pelvis obeys the regression."""
    rng = np.random.default_rng(seed)
    factors = np.ones((len(SEGMENTS), 3))
    for name in SEGMENTS:
        factors[segment_index(name)] = rng.uniform(0.9, 1.1)
    for side in "rl":
        factors[segment_index(f"toes_{side}")] = factors[segment_index(f"talus_{side}")] = factors[
            segment_index(f"calcn_{side}")
        ]
        factors[segment_index(f"patella_{side}")] = factors[segment_index(f"femur_{side}")]
    scales = SegmentScales(factors)
    return LegModel.load(scales), regressed(SITES.scaled(scales), scales)


def regressed(sites, scales, depth=0.17):
    """ASIS and sacrum placed so that Harrington's regression points at the model's hip centers, the
    marker plane level.
    """
    hip = np.array([-0.0707, -0.0661, 0.0835]) * scales.of("pelvis")
    width = (hip[2] - 0.0073) / 0.33
    front = hip + np.array((0.24 * depth + 0.0099, 0.30 * width + 0.0109, -hip[2]))
    positions = sites.positions.copy()
    for name, place in (
        ("asis_r", (0, 0, width / 2)),
        ("asis_l", (0, 0, -width / 2)),
        ("sacrum", (-depth, 0, 0)),
    ):
        positions[sites.index(name)] = front + place
    return MarkerSites(sites.names, sites.segments, positions, sites.weights)


def recording(leg, sites, names, knee_deg):
    values = np.tile(leg.default_coordinates, (len(knee_deg), 1))
    for side in "rl":
        values[:, COORDINATES.index(f"knee_angle_{side}")] = np.radians(knee_deg)
        values[:, COORDINATES.index(f"hip_flexion_{side}")] = -0.9 * np.radians(knee_deg)
        values[:, COORDINATES.index(f"hip_adduction_{side}")] = np.radians(-6)
    used = sites.only(names)
    return MarkerTrajectories(
        np.arange(len(values)) / 100, used.names, leg.marker_positions(values, used)
    )


@pytest.mark.parametrize(
    "knee_deg",
    [np.full(5, -3.0), np.full(5, -60.0), np.linspace(0, -100, 50)],
    ids=["stand", "held", "squat"],
)
def test_thigh_and_shank_are_found_in_any_posture(knee_deg):
    leg, sites = person()
    found = scaling.fit(GENERIC, recording(leg, sites, SEVEN, knee_deg), SITES)
    scaled = LegModel.load(found.scales)
    for side in "rl":
        assert scaled.thigh_length(side) == pytest.approx(leg.thigh_length(side), abs=2e-4)
        assert scaled.shank_length(side) == pytest.approx(leg.shank_length(side), abs=1.5e-3)


def test_the_pelvis_markers_are_placed_so_that_the_hips_obey_the_regression():
    leg, sites = person()
    found = scaling.fit(GENERIC, recording(leg, sites, SEVEN, np.full(5, -30.0)), SITES)
    front = (found.sites.position("asis_r") + found.sites.position("asis_l")) / 2
    hip = np.array([-0.0707, -0.0661, 0.0835]) * found.scales.of("pelvis")
    width, depth = (
        found.measurement("pelvis_width").measured,
        found.measurement("pelvis_depth").measured,
    )
    assert np.linalg.norm(
        found.sites.position("asis_r") - found.sites.position("asis_l")
    ) == pytest.approx(width)
    assert np.linalg.norm(front - found.sites.position("sacrum")) == pytest.approx(depth)
    ahead = (front - found.sites.position("sacrum")) / depth
    assert (hip - front) @ ahead == pytest.approx(-0.24 * depth - 0.0099)
    assert (hip - front) @ (-ahead[1], ahead[0], 0) == pytest.approx(-0.30 * width - 0.0109)
    assert hip[2] == pytest.approx(0.33 * width + 0.0073)


def test_medial_and_foot_markers_scale_widths_and_feet():
    leg, sites = person()
    found = scaling.fit(GENERIC, recording(leg, sites, MORE, np.linspace(0, -60, 20)), SITES)
    for side in "rl":
        for part in ("femur", "calcn", "toes"):
            np.testing.assert_allclose(
                found.scales.of(f"{part}_{side}"), leg.scales.of(f"{part}_{side}"), atol=2e-3
            )
        assert found.scales.of(f"tibia_{side}")[2] == pytest.approx(
            leg.scales.of(f"tibia_{side}")[2], abs=1e-6
        )


def test_two_psis_stand_for_the_sacrum():
    leg, sites = person()
    names = (*SEVEN[1:], "psis_r", "psis_l")
    positions = sites.positions.copy()
    for side, z in (("r", 0.061), ("l", -0.061)):
        positions[sites.index(f"psis_{side}")] = sites.position("sacrum") + np.array((0, 0, z))
    both = MarkerSites(sites.names, sites.segments, positions, sites.weights)
    with_psis = scaling.fit(GENERIC, recording(leg, both, names, np.full(5, -30.0)), SITES)
    with_sacrum = scaling.fit(GENERIC, recording(leg, sites, SEVEN, np.full(5, -30.0)), SITES)
    assert with_psis.measurement("pelvis_depth").measured == pytest.approx(
        with_sacrum.measurement("pelvis_depth").measured
    )
    np.testing.assert_allclose(with_psis.scales.of("femur_r"), with_sacrum.scales.of("femur_r"))
    assert with_psis.sites.position("psis_r")[2] - with_psis.sites.position("psis_l")[
        2
    ] == pytest.approx(0.122)


def test_a_sacral_marker_beside_both_psis_keeps_its_place():
    """On the sacrum, 3 cm below the middle of the PSIS, which alone tells the depth."""
    leg, sites = person()
    names = (*SEVEN, "psis_r", "psis_l")
    positions, middle = sites.positions.copy(), sites.position("sacrum")
    for side, z in (("r", 0.061), ("l", -0.061)):
        positions[sites.index(f"psis_{side}")] = middle + np.array((0, 0, z))
    below = np.array((0.005, -0.03, 0.002))
    positions[sites.index("sacrum")] = middle + below
    both = MarkerSites(sites.names, sites.segments, positions, sites.weights)
    found = scaling.fit(GENERIC, recording(leg, both, names, np.full(5, -30.0)), SITES)
    plain = scaling.fit(GENERIC, recording(leg, sites, SEVEN, np.full(5, -30.0)), SITES)
    assert found.measurement("pelvis_depth").measured == pytest.approx(
        plain.measurement("pelvis_depth").measured
    )
    mean = (found.sites.position("psis_r") + found.sites.position("psis_l")) / 2
    away = found.sites.position("sacrum") - mean
    assert np.linalg.norm(away) == pytest.approx(np.linalg.norm(below))
    assert away[2] == pytest.approx(below[2])


def test_frames_that_hide_a_marker_and_outliers_do_not_matter():
    leg, sites = person()
    whole = recording(leg, sites, SEVEN, np.linspace(0, -90, 60))
    positions = whole.positions_world.copy()
    positions[10:25, whole.marker_names.index("asis_r")] = np.nan
    positions[30:34, whole.marker_names.index("malleolus_lateral_l")] += 0.5
    found = scaling.fit(
        GENERIC, MarkerTrajectories(whole.times, whole.marker_names, positions), SITES
    )
    expected = scaling.fit(GENERIC, whole, SITES)
    np.testing.assert_allclose(found.scales.factors, expected.scales.factors, atol=1e-3)
    assert found.measurement("thigh_r").frames == 45


@pytest.mark.parametrize(("axis", "angle"), [((0, 0, 1), -95), ((0, 0, 1), 90), ((1, 0, 0), 95)])
def test_who_lies_is_measured_like_who_stands(axis, angle):
    """On the face, on the back, on the side, and a little head down."""
    leg, sites = person()
    standing = recording(leg, sites, SEVEN, np.full(5, -10.0))
    turn = transforms.axis_rotation(axis, np.radians(angle))
    lying = MarkerTrajectories(
        standing.times, standing.marker_names, standing.positions_world @ turn.T
    )
    np.testing.assert_allclose(
        scaling.fit(GENERIC, lying, SITES).scales.factors,
        scaling.fit(GENERIC, standing, SITES).scales.factors,
        rtol=1e-9,
    )


def test_the_mass_is_passed_on():
    leg, sites = person()
    assert (
        scaling.fit(
            GENERIC, recording(leg, sites, SEVEN, np.zeros(3)), SITES, mass=80.0
        ).scales.mass
        == 80.0
    )


def renamed(motion, names):
    return MarkerTrajectories(motion.times, tuple(names), motion.positions_world)


def exchanged(motion):
    swap = {"r": "l", "l": "r"}
    return renamed(
        motion, [n[:-1] + swap[n[-1]] if n[-2:] in ("_r", "_l") else n for n in motion.marker_names]
    )


def hidden(motion, name):
    positions = motion.positions_world.copy()
    positions[:, motion.marker_names.index(name)] = np.nan
    return MarkerTrajectories(motion.times, motion.marker_names, positions)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (
            lambda m: MarkerTrajectories(m.times, m.marker_names, m.positions_world * 1000),
            r"pelvis_width measures .* m, expected .*lengths are about 1\d00 times too long: give the unit",
        ),
        (exchanged, "right and left are exchanged"),
        (
            lambda m: renamed(m, ["back" if n == "sacrum" else n for n in m.marker_names]),
            "no marker has the role sacrum",
        ),
        (lambda m: hidden(m, "asis_l"), "marker asis_l is never seen"),
        (lambda m: hidden(m, "epicondyle_lateral_r"), "marker epicondyle_lateral_r is never seen"),
    ],
)
def test_nonsense_is_refused(spoil, message):
    leg, sites = person()
    with pytest.raises(LegsimError, match=message):
        scaling.fit(GENERIC, spoil(recording(leg, sites, SEVEN, np.full(5, -10.0))), SITES)
