import numpy as np
import pytest

from legsim.mocap.in_view import note_of, span_in_view

SEGMENTS = {
    **dict.fromkeys(("asis_r", "asis_l", "sacrum", "psis_r"), "pelvis"),
    "knee_r": "femur_r",
    "ankle_r": "tibia_r",
    "knee_l": "femur_l",
    "ankle_l": "tibia_l",
}


def shown(count: int = 20) -> dict[str, np.ndarray]:
    return {role: np.zeros((count, 3)) for role in SEGMENTS}


def test_somebody_seen_throughout_keeps_every_frame():
    assert span_in_view(shown(), SEGMENTS) == slice(0, 20)
    assert note_of(slice(0, 20), np.arange(20.0)) == ()


def test_who_walks_in_and_out_is_kept_between():
    roles = shown()
    for positions in roles.values():
        positions[:4] = np.nan
        positions[17:] = np.nan
    span = span_in_view(roles, SEGMENTS)
    assert span == slice(4, 17)
    (note,) = note_of(span, 0.1 * np.arange(20))
    assert note.startswith("4 frames before 0.400 s and 3 frames after 1.600 s are left out")


@pytest.mark.parametrize(
    ("hidden", "expected"),
    [
        (("psis_r",), slice(0, 20)),
        (("psis_r", "sacrum"), slice(0, 20)),
        (("psis_r", "sacrum", "asis_r"), slice(5, 20)),
        (("knee_r",), slice(0, 20)),
        (("knee_r", "ankle_r"), slice(5, 20)),
    ],
)
def test_two_markers_of_the_pelvis_and_one_of_each_leg_suffice(hidden, expected):
    roles = shown()
    for role in hidden:
        roles[role][:5] = np.nan
    assert span_in_view(roles, SEGMENTS) == expected


def test_gaps_inside_stay():
    roles = shown()
    for positions in roles.values():
        positions[8:12] = np.nan
    assert span_in_view(roles, SEGMENTS) == slice(0, 20)


def test_a_recording_that_never_shows_enough_is_left_to_those_who_refuse_it():
    roles = shown()
    roles["asis_r"][:10] = np.nan
    roles["asis_l"][10:] = np.nan
    roles["psis_r"][:] = roles["sacrum"][:] = np.nan
    assert span_in_view(roles, SEGMENTS) == slice(0, 20)
    assert span_in_view({"knee_r": np.zeros((3, 3))}, {"knee_r": "femur_r"}) == slice(0, 3)
