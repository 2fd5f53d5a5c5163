"""Options of inverse kinematics."""

from legsim.kinematics.ik_options import IkOptions


def test_the_usual_priors_treat_both_legs_alike():
    priors = {p.coordinate: (p.weight, p.value) for p in IkOptions().priors}
    for name, prior in priors.items():
        assert priors[f"{name[:-1]}{'l' if name.endswith('r') else 'r'}"] == prior
