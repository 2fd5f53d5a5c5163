"""Feet and joints whose labels are exchanged are refused by name, whichever way the person faces."""

import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.mocap import _person

TIMES = np.arange(50) / 50
PLACES = {
    "sacrum": (-0.15, 1.0, 0.0),
    "asis_r": (0.05, 1.0, 0.12),
    "epicondyle_lateral_r": (0.0, 0.5, 0.15),
    "epicondyle_medial_r": (0.0, 0.5, 0.05),
    "malleolus_lateral_r": (-0.04, 0.08, 0.14),
    "malleolus_medial_r": (-0.02, 0.09, 0.07),
    "heel_r": (-0.09, 0.04, 0.1),
}
"""m; those of the left are mirrored"""


def person(heading_deg: float = 0.0, plantarflexion_deg: float = 0.0) -> dict[str, np.ndarray]:
    """Markers (50, 3) by role of somebody who sways, with heels lifted about the ankle."""
    places = {k: np.array(v) for k, v in PLACES.items()}
    lift = transforms.axis_rotation(
        np.array([0, 0, 1.0]), np.array(-np.radians(plantarflexion_deg))
    )
    ankle = (places["malleolus_lateral_r"] + places["malleolus_medial_r"]) / 2
    places["heel_r"] = ankle + lift @ (places["heel_r"] - ankle)
    places |= {f"{k[:-2]}_l": v * [1, 1, -1] for k, v in places.items() if k.endswith("_r")}
    turn = transforms.axis_rotation(np.array([0, 1.0, 0]), np.array(np.radians(heading_deg)))
    sway = 0.02 * np.sin(5 * TIMES)[:, None]
    return {k: turn @ v + sway for k, v in places.items()}


@pytest.mark.parametrize("heading", [0.0, 100.0, 250.0])
@pytest.mark.parametrize("plantarflexion", [-25.0, 0.0, 45.0])
def test_who_is_labelled_right_is_a_person(heading: float, plantarflexion: float):
    _person.check(person(heading, plantarflexion), TIMES)


@pytest.mark.parametrize("heading", [0.0, 100.0, 250.0])
@pytest.mark.parametrize(
    ("one", "other", "problem"),
    [
        ("heel_r", "malleolus_lateral_r", r"heel_r lies \d+ mm nearer .* right heel and ankle are"),
        ("heel_l", "malleolus_lateral_l", "the labels of the left heel and ankle are exchanged"),
        (
            "epicondyle_lateral_r",
            "epicondyle_medial_r",
            "two sides of the right knee are exchanged",
        ),
        ("malleolus_lateral_l", "malleolus_medial_l", "two sides of the left ankle are exchanged"),
    ],
)
def test_exchanged_labels_are_refused_by_name(heading: float, one: str, other: str, problem: str):
    means = person(heading)
    means[one], means[other] = means[other], means[one]
    with pytest.raises(LegsimError, match=problem):
        _person.check(means, TIMES)


def test_a_medial_marker_that_is_seldom_seen_says_nothing():
    means = person()
    means["epicondyle_medial_r"] = np.full((50, 3), np.nan)
    means["heel_l"] = np.full((50, 3), np.nan)
    _person.check(means, TIMES)
