"""Options of inverse kinematics: what is refused, and how strong priors are."""

import pytest

from legsim.core.errors import LegsimError
from legsim.kinematics.ik_options import (
    CoordinateLock,
    CoordinateTask,
    IkOptions,
    PriorStrengths,
    leg_priors,
)


def test_the_usual_priors_treat_both_legs_alike():
    priors = {p.coordinate: (p.weight, p.value) for p in leg_priors()}
    for name, prior in priors.items():
        assert priors[f"{name[:-1]}{'l' if name.endswith('r') else 'r'}"] == prior


@pytest.mark.parametrize("name", ["hip_rotation", "subtalar", "toes"])
def test_a_strength_multiplies_its_own_prior_alone(name):
    part = {"toes": "mtp"}.get(name, name)
    settled = IkOptions(strengths=PriorStrengths(**{name: 3.0})).settled(leg_priors())
    for before, after in zip(leg_priors(), settled.priors, strict=True):
        factor = 3 if before.coordinate.startswith(part) else 1
        assert after.weight == factor * before.weight
    assert settled.flat_foot_weight == IkOptions().flat_foot_weight


def test_settled_options_stay_as_they_are():
    once = IkOptions(strengths=PriorStrengths(hip_rotation=2, flat_foot=0)).settled(leg_priors())
    assert once.flat_foot_weight == 0
    assert once.settled(()) == once


@pytest.mark.parametrize("weight", [-1.0, float("nan"), float("inf")])
@pytest.mark.parametrize(
    ("make", "what"),
    [
        (lambda w: IkOptions(marker_weights={"heel_r": w}), "marker heel_r"),
        (lambda w: IkOptions(tasks=(CoordinateTask("mtp_angle_r", w),)), "task of mtp_angle_r"),
        (lambda w: IkOptions(strengths=PriorStrengths(toes=w)), "prior toes"),
    ],
)
def test_a_weight_below_zero_is_refused(make, what, weight):
    with pytest.raises(LegsimError, match=rf"weight of {what} is .*give 0 or more"):
        make(weight)


def test_two_tasks_or_locks_of_a_coordinate_are_refused():
    with pytest.raises(LegsimError, match="mtp_angle_r has two tasks"):
        IkOptions(tasks=(CoordinateTask("mtp_angle_r", 1), CoordinateTask("mtp_angle_r", 2)))
    with pytest.raises(LegsimError, match="mtp_angle_r has two locks"):
        IkOptions(locked=(CoordinateLock("mtp_angle_r"), CoordinateLock("mtp_angle_r", 0.1)))


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_value_that_is_not_finite_is_refused(value):
    for what, options in (
        ("task", {"tasks": (CoordinateTask("mtp_angle_r", 1, value),)}),
        ("lock", {"locked": (CoordinateLock("mtp_angle_r", value),)}),
    ):
        with pytest.raises(LegsimError, match=f"value of the {what} of mtp_angle_r is {value}"):
            IkOptions(**options)
