import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.deformation.models import ControlPointMotion, FieldMotion
from legsim.geometry.volume import VolumeGrid

GRID = VolumeGrid((2, 3, 4), (0.1, 0.1, 0.1), (0, 0, 0))


def test_values_are_copied_and_read_only():
    moved = np.zeros((2, 3, 3))
    motion = ControlPointMotion(np.arange(2.0), np.zeros((3, 3)), moved)
    moved[:] = 5
    assert (motion.moved == 0).all()
    with pytest.raises(ValueError, match="read-only"):
        motion.moved[0, 0, 0] = 1


def test_a_field_has_a_vector_a_node_and_view():
    assert (
        FieldMotion(np.arange(5.0), GRID, np.zeros((5, 2, 3, 4, 3))).displacements.dtype
        == np.float32
    )


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: ControlPointMotion(np.arange(2.0), np.zeros((0, 3)), np.zeros((2, 0, 3))),
            "at least one control point",
        ),
        (
            lambda: ControlPointMotion(
                np.arange(2.0), np.zeros((3, 3)), np.full((2, 3, 3), np.nan)
            ),
            "all coordinates finite",
        ),
        (
            lambda: ControlPointMotion(np.arange(2.0), np.zeros((3, 3)), np.zeros((3, 3, 3))),
            r"expected \(2, 3, 3\)",
        ),
        (
            lambda: ControlPointMotion([1.0, 0.0], np.zeros((3, 3)), np.zeros((2, 3, 3))),
            "must increase",
        ),
        (
            lambda: FieldMotion(np.arange(2.0), GRID, np.zeros((2, 4, 3, 2, 3))),
            r"expected \(2, 2, 3, 4, 3\)",
        ),
        (
            lambda: FieldMotion(np.arange(1.0), GRID, np.full((1, 2, 3, 4, 3), np.inf)),
            "not a finite number",
        ),
    ],
)
def test_impossible_motions_are_refused(make, message):
    with pytest.raises(LegsimError, match=message):
        make()
