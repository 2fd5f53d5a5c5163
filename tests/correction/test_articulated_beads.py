"""Rigid bones along two biased sensors whose beads are seen; who rests is left alone."""

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.correction import articulated_beads
from legsim.correction.articulated_beads import ArticulatedBeads, BeadedLeg
from legsim.correction.control_points import AttachedPoint
from legsim.correction.method import Scan
from legsim.correction.path_measurements import BeadShadows
from legsim.correction.tied_sensors import TiedPaths, tied_paths
from legsim.deformation.models import FieldMotion, RigidMotion
from legsim.geometry.volume import VolumeGrid
from tests.correction.test_tied_sensors import (
    KNEE,
    LEG,
    PRIORS,
    SHANK,
    TIE,
    parting_missed,
    scanned,
    shadows,
    swinging,
)

pytestmark = pytest.mark.filterwarnings("ignore::legsim.reconstruction.weights.ShortScanWarning")
NODES = VolumeGrid.cubic(1, 0.15, KNEE.tolist()).coarse(0.02)
POINTS = (
    AttachedPoint("thigh_l", TIE.hip_in_thigh),
    AttachedPoint("shank_l", TIE.knee_in_shank),
    AttachedPoint("shank_l", TIE.ankle_in_shank),
)


def scan(rng: np.random.Generator) -> Scan:
    return replace(scanned(rng), joints=(POINTS,))


def method(rng: np.random.Generator, px: float = 0.3) -> ArticulatedBeads:
    leg = BeadedLeg(lambda name: shadows(name, rng, px), TIE.knee_in_thigh)
    return ArticulatedBeads(leg, PRIORS, NODES)


def missed(motion: FieldMotion | RigidMotion, name: str, points: FloatArray) -> float:
    """m, RMS."""
    true = np.stack([m[:3, :3] @ points.T + m[:3, 3:] for m in LEG[name].motion()])
    return float(np.sqrt(((motion.carry(points) - np.swapaxes(true, 1, 2)) ** 2).sum(-1).mean()))


@pytest.fixture
def bending(monkeypatch: pytest.MonkeyPatch):
    """A thigh that turns by 2 degrees on a shank that does not."""
    monkeypatch.setitem(LEG, "thigh_l", swinging(2.0))


@pytest.mark.usefixtures("bending")
def test_thigh_and_shank_are_followed_each_on_its_side(rng: np.random.Generator):
    """From rough starts and biased signals, meters off alone; no bone is in these images."""
    found = method(rng)(scan(rng))
    assert isinstance(found.motion, FieldMotion)
    for name, height in (("thigh_l", 0.06), ("shank_l", -0.06)):
        points = KNEE + np.array([[0.0, height, 0.0]])
        still = np.linalg.norm(LEG[name].motion()[:, :3] @ [*points[0], 1] - points[0], axis=-1)
        assert missed(found.motion, name, points) < 0.6 * np.sqrt((still**2).mean())
    assert "thigh_l: 2 beads, 100 % of their shadows found" in found.notes[0]
    assert "of the motion of thigh and shank that was found" in found.notes[2]


@pytest.mark.parametrize("degrees", [1.0, 2.0, 4.0])
def test_the_stated_error_of_how_thigh_and_shank_part_is_about_the_true_one(
    degrees: float, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
):
    kept: list[TiedPaths] = []

    def tied(*given: Any) -> TiedPaths:
        kept.append(tied_paths(*given))
        return kept[-1]

    monkeypatch.setattr(articulated_beads, "tied_paths", tied)
    monkeypatch.setitem(LEG, "thigh_l", swinging(degrees))
    leg = BeadedLeg(lambda name: shadows(name, rng), LEG["thigh_l"].place(0.0))
    points = (replace(POINTS[0], position_sensor=LEG["thigh_l"].place(0.4)), *POINTS[1:])
    found = ArticulatedBeads(leg, PRIORS, NODES)(replace(scanned(rng), joints=(points,)))
    said = next(note for note in found.notes if "against each other" in note)
    stated = re.search(r"with an error of (\S+) mm", said)
    assert stated is not None
    assert 1e3 * parting_missed(kept[0]) < 2 * float(stated[1])


@pytest.mark.parametrize("hidden", ["thigh_l", "shank_l"])
def test_a_segment_none_of_whose_beads_is_seen_goes_where_the_other_does(
    hidden: str, rng: np.random.Generator
):
    def seen(name: str, one: str = hidden) -> BeadShadows:
        found = shadows(name, rng)
        return replace(found, pixels=np.full_like(found.pixels, np.nan)) if name == one else found

    own = ArticulatedBeads(BeadedLeg(seen, TIE.knee_in_thigh), PRIORS, NODES)
    found = own(scan(rng))
    shown = next(name for name in LEG if name != hidden)
    assert isinstance(found.motion, RigidMotion)
    assert found.method == "articulated-beads"
    assert found.notes[0].startswith(f"In doubt: articulated-beads: no bead beside {hidden}")
    points = KNEE + np.array([[0.0, 0.06 if shown == "thigh_l" else -0.06, 0.0]])
    still = np.linalg.norm(transforms.apply(LEG[shown].motion(), points) - points, axis=-1)
    assert missed(found.motion, shown, points) < 0.6 * np.sqrt((still**2).mean())
    nowhere = BeadedLeg(lambda name: seen(name, name), TIE.knee_in_thigh)
    with pytest.raises(LegsimError, match="none of 2 beads was found in 3 views"):
        ArticulatedBeads(nowhere, PRIORS, NODES)(scan(rng))


def test_who_may_rest_is_left_alone(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch):
    """Where the motion is no larger than its error."""
    monkeypatch.setattr(articulated_beads, "DISCERNED", 1e3)
    found = method(rng)(scan(rng))
    assert isinstance(found.motion, RigidMotion)
    assert (found.motion.moved_from_reference == np.eye(4)).all()
    assert "do not determine it, and the scan is left as it is" in found.notes[-1]


def test_a_leg_that_moves_as_one_is_followed_nearly_as_one(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
):
    """What parts its bones is error alone."""
    monkeypatch.setitem(LEG, "thigh_l", replace(LEG["thigh_l"], sway=SHANK))
    found = method(rng)(scan(rng))
    assert isinstance(found.motion, FieldMotion)
    points = KNEE + np.array([[0.0, 0.06, 0.0], [0.0, -0.06, 0.0]])
    still = np.linalg.norm(transforms.apply(LEG["shank_l"].motion(), points) - points, axis=-1)
    assert missed(found.motion, "thigh_l", points) < 0.6 * np.sqrt((still**2).mean())
    parted = found.motion.carry(points) - transforms.apply(LEG["shank_l"].motion(), points)
    assert np.sqrt(((parted[:, 0] - parted[:, 1]) ** 2).sum(-1).mean()) < 0.5e-3


def test_a_leg_without_two_sensors_is_refused(rng: np.random.Generator):
    with pytest.raises(LegsimError, match="knows the place of hip, knee and ankle on no sensor"):
        method(rng)(replace(scan(rng), joints=()))
    wrong = (POINTS[1], POINTS[1], POINTS[2])
    with pytest.raises(LegsimError, match="needs the hip on the thigh's sensor"):
        method(rng)(replace(scan(rng), joints=(wrong,)))


def test_the_leg_in_the_isocenter_is_followed(rng: np.random.Generator):
    """Of two, whichever comes first."""
    beside = tuple(
        replace(p, position_sensor=p.position_sensor + np.array([0.3, 0, 0])) for p in POINTS
    )
    asked: list[str] = []

    def beads(name: str) -> BeadShadows:
        asked.append(name)
        return shadows(name, rng)

    both = replace(scan(rng), joints=(beside, POINTS))
    own = ArticulatedBeads(BeadedLeg(beads, TIE.knee_in_thigh), PRIORS, NODES)
    assert asked == []
    assert own(both).notes[0].startswith("articulated-beads, thigh_l")
    assert asked == ["thigh_l", "shank_l"]
