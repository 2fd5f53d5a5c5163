"""Cleaning: what it takes away and adds, and that a dropout never becomes motion."""

import numpy as np
import pytest
from scipy import signal

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.mocap import cleaning, files, marker_sets
from legsim.mocap.labels import PAPER_ROLES, MarkerMap
from legsim.mocap.trajectories import MarkerTrajectories
from tests.mocap.test_outliers import squat

LABELS = ("SACR", "RASI", "LASI", "RKNE", "LKNE", "RANK", "LANK")
SEVEN = MarkerMap.one_to_one("seven", PAPER_ROLES, LABELS)
PLACES = np.array(
    [
        [-0.15, 0, 0],
        [0.05, 0, 0.12],
        [0.05, 0, -0.12],
        [0, -0.45, 0.2],
        [0, -0.45, -0.2],
        [-0.05, -0.85, 0.15],
        [-0.05, -0.85, -0.15],
    ]
)
RATE = 120.0


def recording(*, noise: float = 0.0002, rate: float = RATE) -> MarkerTrajectories:
    """Seven markers that squat together."""
    path = squat(rate, noise=0)
    positions = (
        path[:, None] + PLACES + np.random.default_rng(3).normal(0, noise, (len(path), 7, 3))
    )
    return MarkerTrajectories(np.arange(len(path)) / rate, LABELS, positions)


def with_gap(motion: MarkerTrajectories, label: str, first: int, length: int) -> MarkerTrajectories:
    positions = np.array(motion.positions_world)
    positions[first : first + length, motion.marker_names.index(label)] = np.nan
    return MarkerTrajectories(motion.times, motion.marker_names, positions)


def test_roles_take_the_place_of_labels_and_nothing_is_found_in_clean_data():
    cleaned, report = cleaning.clean(recording(), SEVEN)
    assert cleaned.marker_names == PAPER_ROLES
    assert report.rate_hz == pytest.approx(RATE)
    assert not report.resampled
    assert all(
        (r.missing, r.longest_gap_s, r.jumps_removed, r.filled, r.left_missing) == (0, 0, 0, 0, 0)
        for r in report.roles
    )


def test_without_a_filter_clean_markers_are_left_to_the_last_bit():
    motion = recording()
    np.testing.assert_array_equal(
        cleaning.clean(motion, SEVEN, filter_hz=0)[0].positions_world, motion.positions_world
    )


@pytest.mark.parametrize(
    ("frequency", "gain"), [(0.5, 1.0), (4.81, np.sqrt(0.5)), (6.0, 0.5), (20.0, 0.008)]
)
def test_the_filter_has_the_stated_gain_and_no_delay(frequency, gain):
    motion = recording(noise=0)
    wave = 0.001 * np.sin(2 * np.pi * frequency * motion.times)
    moved = MarkerTrajectories(motion.times, LABELS, PLACES + 1 + wave[:, None, None] * [0, 0, 1])
    found = cleaning.clean(moved, SEVEN)[0].marker("sacrum")[300:900, 2] - 1
    np.testing.assert_allclose(found, gain * wave[300:900], atol=2e-5)


def test_what_does_not_move_stays_to_rounding_up_to_both_ends():
    still = MarkerTrajectories(
        np.arange(600) / RATE, LABELS, np.broadcast_to(PLACES + 1, (600, 7, 3))
    )
    np.testing.assert_allclose(
        cleaning.clean(still, SEVEN)[0].positions_world, still.positions_world, atol=1e-12
    )


def test_a_steady_drift_stays_up_to_both_ends():
    times = np.arange(600) / RATE
    drifting = MarkerTrajectories(times, LABELS, PLACES + 1 + times[:, None, None] * [0.1, 0, 0.2])
    np.testing.assert_allclose(
        cleaning.clean(drifting, SEVEN)[0].positions_world, drifting.positions_world, atol=1e-9
    )


@pytest.mark.parametrize("first", [100, 420, 480])
@pytest.mark.parametrize("length", [1, 12, 29])
def test_a_short_gap_is_bridged_within_a_millimetre_even_in_the_fastest_motion(first, length):
    whole = recording()
    cleaned, report = cleaning.clean(with_gap(whole, "RASI", first, length), SEVEN)
    expected = cleaning.clean(whole, SEVEN)[0]
    assert np.abs(cleaned.marker("asis_r") - expected.marker("asis_r")).max() < 0.0015
    found = report.of("asis_r")
    assert (found.missing, found.filled, found.left_missing) == (length, length, 0)
    assert found.longest_gap_s == pytest.approx(length / RATE)


@pytest.mark.parametrize("first", [0, 420, 1100])
def test_a_dropout_never_becomes_motion(first):
    whole = recording()
    cleaned, report = cleaning.clean(with_gap(whole, "RASI", first, 100), SEVEN)
    expected = cleaning.clean(whole, SEVEN)[0].marker("asis_r")
    found = cleaned.marker("asis_r")
    gap = np.zeros(len(found), bool)
    gap[first : first + 100] = True
    assert np.isnan(found[gap]).all()
    # the filter sees other neighbors at the edges; nothing of it is larger than the noise that it
    # takes away
    assert np.abs(found - expected)[~gap].max() < 0.002
    others = [k for k, role in enumerate(PAPER_ROLES) if role != "asis_r"]
    np.testing.assert_array_equal(
        cleaned.positions_world[:, others],
        cleaning.clean(whole, SEVEN)[0].positions_world[:, others],
    )
    assert report.of("asis_r").left_missing == 100


def test_a_long_gap_is_bridged_when_asked():
    cleaned, report = cleaning.clean(
        with_gap(recording(), "RASI", 100, 100), SEVEN, longest_gap_s=2.0
    )
    assert np.isfinite(cleaned.positions_world).all()
    assert report.of("asis_r").filled == 100


def test_a_long_gap_is_filled_from_other_markers_on_the_segment():
    seven = recording()
    crests = seven.positions_world[:, :1] + np.array([[0.08, 0.05, 0.14], [0.08, 0.05, -0.14]])
    whole = MarkerTrajectories(
        seven.times, (*LABELS, "RIC", "LIC"), np.concatenate([seven.positions_world, crests], 1)
    )
    nine = MarkerMap.one_to_one(
        "nine", (*PAPER_ROLES, "iliac_crest_r", "iliac_crest_l"), whole.marker_names
    )
    cleaned, report = cleaning.clean(with_gap(whole, "RASI", 380, 200), nine)
    assert (
        np.abs(cleaned.marker("asis_r") - cleaning.clean(whole, nine)[0].marker("asis_r")).max()
        < 0.001
    )
    assert (
        report.of("asis_r").filled,
        report.of("asis_r").rebuilt,
        report.of("asis_r").left_missing,
    ) == (200, 200, 0)


def test_exchanged_labels_leave_no_trace():
    whole = recording()
    positions = np.array(whole.positions_world)
    positions[500:520, [1, 2]] = positions[500:520, [2, 1]]
    cleaned, report = cleaning.clean(MarkerTrajectories(whole.times, LABELS, positions), SEVEN)
    assert (
        np.abs(cleaned.positions_world - cleaning.clean(whole, SEVEN)[0].positions_world).max()
        < 0.0015
    )
    assert (report.of("asis_r").jumps_removed, report.of("asis_l").jumps_removed) == (20, 20)


def test_a_middle_of_two_markers_is_their_mean_and_unseen_with_either():
    seven = recording()
    names = ("RPSI", "LPSI", *LABELS[1:])
    positions = np.concatenate(
        [
            seven.positions_world[:, :1] + [0, 0, 0.05],
            seven.positions_world[:, :1] - [0, 0, 0.05],
            seven.positions_world[:, 1:],
        ],
        1,
    )
    positions[300:400, [0, 2]] = np.nan  # RASI too: three others would tell where RPSI is
    middle = MarkerMap(
        "m", PAPER_ROLES, ((("RPSI", "LPSI"),), *(((label,),) for label in LABELS[1:]))
    )
    cleaned, report = cleaning.clean(
        MarkerTrajectories(seven.times, names, positions), middle, filter_hz=0
    )
    np.testing.assert_allclose(
        cleaned.marker("sacrum")[:300], seven.marker("SACR")[:300], atol=1e-15
    )
    assert np.isnan(cleaned.marker("sacrum")[300:400]).all()
    assert report.of("sacrum").missing == 100


def test_left_out_samples_are_made_even_and_bridged():
    whole = recording()
    kept = np.ones(len(whole.times), bool)
    kept[[50, 51, 400]] = False
    cleaned, report = cleaning.clean(
        MarkerTrajectories(whole.times[kept], LABELS, whole.positions_world[kept]),
        SEVEN,
        filter_hz=0,
    )
    assert report.resampled
    np.testing.assert_allclose(cleaned.times, whole.times, atol=1e-9)
    np.testing.assert_allclose(
        cleaned.positions_world[kept], whole.positions_world[kept], atol=1e-8
    )
    assert report.of("sacrum").filled == 3


def test_uneven_times_are_made_even(rng):
    even = recording(noise=0)
    jitter = even.times + np.r_[0, rng.uniform(-0.0015, 0.0015, len(even.times) - 2), 0]
    path = np.stack(
        [
            np.interp(jitter, even.times, even.positions_world[:, k, c])
            for k in range(7)
            for c in range(3)
        ],
        1,
    ).reshape(-1, 7, 3)
    cleaned, report = cleaning.clean(MarkerTrajectories(jitter, LABELS, path), SEVEN)
    assert report.resampled
    np.testing.assert_allclose(
        np.diff(cleaned.times), cleaned.times[1] - cleaned.times[0], rtol=1e-9
    )
    assert (
        np.abs(cleaned.positions_world - cleaning.clean(even, SEVEN)[0].positions_world).max()
        < 0.0005
    )


def test_another_alternative_is_taken_where_the_first_is_never_seen():
    seven = recording()
    positions = np.concatenate([seven.positions_world, seven.positions_world[:, :1]], 1)
    positions[:, 0] = np.nan
    either = MarkerMap(
        "m", PAPER_ROLES, ((("SACR",), ("BACK",)), *(((label,),) for label in LABELS[1:]))
    )
    report = cleaning.clean(MarkerTrajectories(seven.times, (*LABELS, "BACK"), positions), either)[
        1
    ]
    assert report.of("sacrum").labels == ("BACK",)


def test_a_required_marker_that_is_never_seen_is_one_clear_line():
    with pytest.raises(
        LegsimError,
        match=(
            r"^asis_r cannot be followed: RASI is not seen in any sample; label it and export "
            r"again, or name a static trial that shows it \(motion.scaling_file\)$"
        ),
    ):
        cleaning.clean(with_gap(recording(), "RASI", 0, 5000), SEVEN)


def test_a_further_marker_that_is_never_seen_is_reported():
    motion = recording()
    more = MarkerTrajectories(
        motion.times,
        (*LABELS, "RHEE"),
        np.concatenate([motion.positions_world, np.full((len(motion.times), 1, 3), np.nan)], 1),
    )
    cleaned, report = cleaning.clean(
        more, MarkerMap.one_to_one("eight", (*PAPER_ROLES, "heel_r"), (*LABELS, "RHEE"))
    )
    assert cleaned.marker_names == PAPER_ROLES
    assert report.never_seen == ("heel_r",)


@pytest.mark.parametrize(("change", "message"), [
    (lambda x: x * 1000, r"pelvis is 240 m wide: the unit of length is wrong; lengths are about 960 times too long"),
    (lambda x: x * [1, 1, -1], r"asis_r lies left of asis_l.*left and right, or .* are exchanged"),
    (lambda x: x[:, [0, 1, 2, 4, 3, 5, 6]], (r"epicondyle_lateral_r lies \d+ mm left of .* labels of the legs are exchanged; "
        r"exchange them")),
    (lambda x: x[:, [0, 1, 2, 3, 4, 6, 5]], (r"malleolus_lateral_r lies \d+ mm left of .* labels of the legs are exchanged; "
        r"exchange them")),
])  # fmt: skip
def test_what_is_not_a_person_is_refused(change, message):
    motion = recording()
    with pytest.raises(LegsimError, match=message):
        cleaning.clean(
            MarkerTrajectories(motion.times, LABELS, change(motion.positions_world)), SEVEN
        )


def turning(places) -> MarkerTrajectories:
    """Markers carried there and back: half of the time they face the other way."""
    yaw = np.pi * np.clip((np.arange(600) - 250) / 100, 0, 1)
    turns = transforms.axis_rotation([0, 1, 0], yaw)
    return MarkerTrajectories(
        np.arange(600) / RATE, LABELS, places @ np.swapaxes(turns, -1, -2) + 1
    )


@pytest.mark.parametrize(("length", "reported"), [(20, False), (60, True)])
def test_a_stretch_that_hides_most_markers_is_called_a_guess(length, reported):
    """A sixth of a second is bridged within millimeters, half a second is not."""
    motion = recording()
    positions = motion.positions_world.copy()
    positions[400 : 400 + length, :5] = np.nan
    _, report = cleaning.clean(
        MarkerTrajectories(motion.times, LABELS, positions), SEVEN, longest_gap_s=2.0
    )
    said = [note for note in report.notes if "the movement there is a guess" in note]
    assert len(said) == reported
    if reported:
        assert "from 3.333 to 3.825 s" in said[0]


def test_a_second_trial_behind_the_first_is_left_out_with_a_warning():
    motion = recording()
    again = motion.positions_world[:500] + np.array([2, 0, 1])
    positions = np.concatenate([motion.positions_world, again])
    times = np.arange(len(positions)) / RATE
    cleaned, report = cleaning.clean(MarkerTrajectories(times, LABELS, positions), SEVEN)
    assert len(cleaned.times) == len(motion.times)
    assert report.notes == (
        f"warning: 500 frames are left out whose markers jump away at {motion.times[-1]:.4g} s: "
        "frames are missing there, or another trial begins; cut the recording there",
    )


def test_who_turns_about_is_a_person_and_keeps_right_and_left():
    assert cleaning.clean(turning(PLACES), SEVEN)[1].roles[0].left_missing == 0
    with pytest.raises(LegsimError, match="left and right, or front and back, are exchanged"):
        cleaning.clean(turning(PLACES * [1, 1, -1]), SEVEN)


@pytest.mark.parametrize("filter_hz", [60.0, -1.0, np.nan])
def test_a_filter_that_does_not_fit_the_rate_is_refused(filter_hz):
    with pytest.raises(
        LegsimError, match="must lie below half the sampling rate of 120 Hz; 0 leaves"
    ):
        cleaning.clean(recording(), SEVEN, filter_hz=filter_hz)


def test_hardly_any_samples_are_refused():
    motion = recording()
    with pytest.raises(LegsimError, match="holds 3 samples, but at least 4"):
        cleaning.clean(
            MarkerTrajectories(motion.times[:3], LABELS, motion.positions_world[:3]), SEVEN
        )


@pytest.mark.parametrize(("first", "side", "word"), [(0, "l", "left"), (500, "r", "right")])
def test_exchanged_labels_of_knee_and_ankle_are_refused_with_the_time(first, side, word):
    motion = recording()
    positions = motion.positions_world.copy()
    pair = [LABELS.index(f"{side.upper()}{name}") for name in ("KNE", "ANK")]
    positions[first:, pair] = positions[first:, pair[::-1]]
    said = (
        rf"malleolus_lateral_{side} lies between the pelvis and .*first at {first / RATE:.4g} s: "
        rf"the labels of the {word} knee and ankle are exchanged"
    )
    with pytest.raises(LegsimError, match=said):
        cleaning.clean(MarkerTrajectories(motion.times, LABELS, positions), SEVEN)


def test_who_sits_on_the_heels_has_knee_and_ankle_in_order():
    """Thighs forward, shanks back under them."""
    motion = recording()
    sitting = PLACES.copy()
    sitting[3:5, :2], sitting[5:, :2] = (0.42, -0.08), (0.02, -0.15)
    positions = motion.positions_world - PLACES + sitting
    cleaned, _ = cleaning.clean(MarkerTrajectories(motion.times, LABELS, positions), SEVEN)
    assert cleaned.marker_names == PAPER_ROLES


@pytest.mark.parametrize(("factor", "step"), [(100.0, "1 s"), (1 / 60, "0.000167 s")])
def test_times_that_are_not_in_seconds_are_refused(factor, step):
    """A second or a sixtieth of a hundredth between samples: frame numbers, minutes."""
    motion = recording()
    times = np.arange(len(motion.times)) / 100 * factor
    with pytest.raises(LegsimError, match=rf"a sample every {step} is no recording .*in seconds"):
        cleaning.clean(MarkerTrajectories(times, LABELS, motion.positions_world), SEVEN)


@pytest.mark.parametrize("file", [
    "standing_bmc/static_run.trc", "standing_biobuddy/anat_pose_ECH.c3d", "standing_c3dio/Capture0008_Standing.c3d", "squat_dart/squat.c3d",
    "squats_subject4/squats1.trc", "squats_subject4/static1.trc", "walk_opensim/subject01_static.trc",
])  # fmt: skip
def test_real_recordings_keep_their_motion(shared_data, file):
    motion = files.load_markers(shared_data / "mocap" / file, up="z" if "anat" in file else None)
    marker_map = marker_sets.guess(motion.marker_names)
    cleaned, report = cleaning.clean(motion, marker_map)
    assert set(PAPER_ROLES) <= set(cleaned.marker_names)
    for role in PAPER_ROLES:
        raw = np.mean([motion.marker(label) for label in report.of(role).labels], axis=0)
        assert np.nanmedian(np.linalg.norm(cleaned.marker(role) - raw, axis=1)) < 0.0015
        assert report.of(role).left_missing < 0.2 * report.of(role).samples
        speed = np.linalg.norm(np.diff(cleaned.marker(role), axis=0), axis=1) * report.rate_hz
        assert np.nanmax(speed) < 4


def test_the_filter_is_scipys_forward_backward_butterworth():
    motion = recording()
    b, a = signal.butter(2, 6.0, fs=RATE)
    expected = signal.filtfilt(b, a, motion.marker("RKNE"), axis=0, padlen=60)
    np.testing.assert_allclose(
        cleaning.clean(motion, SEVEN)[0].marker("epicondyle_lateral_r"), expected, atol=1e-9
    )


def test_a_variable_rate_leaves_out_nothing():
    """Every second sample from the middle on, at its right time."""
    whole = recording(noise=0)
    kept = np.r_[
        np.arange(len(whole.times) // 2), np.arange(len(whole.times) // 2, len(whole.times), 2)
    ]
    cleaned, report = cleaning.clean(
        MarkerTrajectories(whole.times[kept], LABELS, whole.positions_world[kept]), SEVEN
    )
    assert {r.missing for r in report.roles} == {0}
    assert report.rate_hz == pytest.approx(RATE)
    expected = cleaning.clean(whole, SEVEN)[0]
    n = min(len(cleaned.times), len(expected.times))
    np.testing.assert_allclose(
        cleaned.positions_world[:n], expected.positions_world[:n], atol=0.0005
    )


def test_one_marker_for_both_knees_is_refused():
    motion = recording()
    labels = (*LABELS[:4], "RKNE", *LABELS[5:])
    with pytest.raises(LegsimError, match="RKNE plays both epicondyle_lateral_r and epicondyle"):
        cleaning.clean(motion, MarkerMap.one_to_one("seven", PAPER_ROLES, labels))


def test_one_marker_under_two_labels_is_refused():
    motion = recording()
    positions = motion.positions_world.copy()
    positions[:, LABELS.index("LKNE")] = positions[:, LABELS.index("RKNE")]
    with pytest.raises(LegsimError, match=r"RKNE \(epi.*_r\) and LKNE \(epi.*_l\) hold the same"):
        cleaning.clean(MarkerTrajectories(motion.times, LABELS, positions), SEVEN)


def test_held_samples_are_not_seen_and_reported():
    motion = recording()
    positions = motion.positions_world.copy()
    positions[300:360, LABELS.index("LKNE")] = positions[299, LABELS.index("LKNE")]
    cleaned, report = cleaning.clean(
        MarkerTrajectories(motion.times, LABELS, positions), SEVEN, filter_hz=0, longest_gap_s=0.3
    )
    assert report.of("epicondyle_lateral_l").missing == 60
    assert np.isnan(cleaned.marker("epicondyle_lateral_l")[300:360]).all()
    assert report.notes == (
        "LKNE repeats one position from 2.492 to 2.992 s (60 samples): taken as not seen",
    )


@pytest.mark.parametrize(
    ("axis", "angle"),
    [((0, 0, 1), np.pi / 2), ((0, 0, 1), -np.pi / 2), ((1, 0, 0), np.pi / 2), ((1, 1, 0), 2.0)],
)
def test_somebody_who_lies_has_right_and_left_too(axis, angle):
    lying = transforms.axis_rotation(axis, angle)
    motion = recording()
    turned = MarkerTrajectories(motion.times, LABELS, motion.positions_world @ lying.T)
    cleaned, _ = cleaning.clean(turned, SEVEN)
    upright, _ = cleaning.clean(motion, SEVEN)
    np.testing.assert_allclose(
        cleaned.positions_world, upright.positions_world @ lying.T, atol=1e-9
    )
    mirrored = motion.positions_world * [1, 1, -1]
    with pytest.raises(LegsimError, match="left and right, or front and back, are exchanged"):
        cleaning.clean(MarkerTrajectories(motion.times, LABELS, mirrored @ lying.T), SEVEN)


def test_frames_without_the_person_are_left_out_and_named():
    motion = recording()
    positions = motion.positions_world.copy()
    positions[:150] = np.nan
    positions[-30:] = np.nan
    part = MarkerTrajectories(motion.times, motion.marker_names, positions)
    cleaned, report = cleaning.clean(part, SEVEN)
    np.testing.assert_array_equal(cleaned.times, motion.times[150:-30])
    assert np.isfinite(cleaned.positions_world).all()
    assert all(r.missing == r.left_missing == 0 for r in report.roles)
    assert any(note.startswith("150 frames before") for note in report.notes)


def test_a_recording_at_twice_its_own_rate_is_as_if_it_had_been_exported_at_its_own():
    """Every second frame repeats the one before."""
    plain = recording()
    count = len(plain.times)
    twice = plain.positions_world[np.arange(count) // 2 * 2]
    cleaned, report = cleaning.clean(MarkerTrajectories(plain.times, LABELS, twice), SEVEN)
    slow = MarkerTrajectories(plain.times[::2], LABELS, plain.positions_world[::2])
    expected, _ = cleaning.clean(slow, SEVEN)
    np.testing.assert_allclose(cleaned.positions_world, expected.positions_world, atol=1e-12)
    assert f"{count // 2} of {count} frames repeat the frame before exactly" in report.notes[0]
