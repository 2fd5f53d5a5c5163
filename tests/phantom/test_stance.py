"""A standing leg is not doubted; one upside down, back to front or called by the other side is."""

import numpy as np
import pytest

from legsim.phantom import leg_phantom
from legsim.phantom._stance import objections


@pytest.fixture(scope="module")
def bones() -> dict[str, np.ndarray]:
    phantom = leg_phantom.load_leg_phantom().phantom
    names = [f"{bone}_cortex_{side}" for bone in ("femur", "tibia", "patella") for side in "lr"]
    found = {p.name.replace("_cortex", ""): p.vertices for p in phantom.parts if p.name in names}
    assert len(found) == 6
    for side, lateral in (("l", -1), ("r", 1)):
        found[f"fibula_{side}"] = found[f"tibia_{side}"] + [0, 0, lateral * 0.03]
    return found


def test_legs_that_stand_are_not_doubted(bones):
    assert objections(bones) == []
    assert objections({k: v for k, v in bones.items() if k in ("femur_l", "patella_l")}) == []


@pytest.mark.parametrize(
    ("mirror", "said"),
    [
        ([1, -1, 1], "upside down"),
        ([-1, 1, 1], "front and back are exchanged"),
        ([1, 1, -1], "left and right are exchanged"),
    ],
)
def test_what_is_exchanged_is_named(bones, mirror, said):
    lines = objections({name: points * mirror for name, points in bones.items()})
    assert lines
    assert all(said in line for line in lines)


def test_a_left_leg_called_right_is_named_by_its_fibula(bones):
    called = {name.replace("_l", "_r"): v for name, v in bones.items() if name.endswith("_l")}
    (line,) = objections(called)
    assert "fibula_r is not outside of tibia_r" in line
