"""Normal equations of a sensor's path: eliminated places change nothing, and no solution is said."""

import numpy as np
import pytest

from legsim.correction.path_problem import DivergedError, Normal, add_measurements, at_rest, solved


def test_a_step_is_that_of_all_unknowns_together(rng: np.random.Generator):
    """Three errors and two beads, beside the dense system of all nine."""
    rows, right = rng.normal(size=(40, 9)), rng.normal(size=40)
    rows[:20, 6:] = rows[20:, 3:6] = 0.0  # no measurement sees both beads
    dense, gradient = rows.T @ rows, rows.T @ right
    blocks = [slice(3, 6), slice(6, 9)]
    normal = Normal(
        dense[:3, :3],
        gradient[:3],
        np.stack([dense[:3, b] for b in blocks]),
        np.stack([dense[b, b] for b in blocks]),
        np.stack([gradient[b] for b in blocks]),
    )
    errors, places = normal.step()
    whole = -np.linalg.solve(dense, gradient)
    np.testing.assert_allclose(np.concatenate([errors, places.ravel()]), whole, rtol=1e-9)


def test_measurements_add_up_to_those_of_least_squares(rng: np.random.Generator):
    by, miss = rng.normal(size=(5, 2, 3)), rng.normal(size=(5, 2))
    matrix, right = np.zeros((3, 3)), np.zeros(3)
    add_measurements(matrix, right, miss, by)
    expected = np.linalg.lstsq(by.reshape(-1, 3), -miss.ravel())[0]
    np.testing.assert_allclose(-solved(matrix, right), expected, rtol=1e-9)


@pytest.mark.parametrize("matrix", [-np.eye(3), np.full((3, 3), np.nan)])
def test_equations_without_a_solution_say_what_to_check(matrix: np.ndarray):
    with pytest.raises(DivergedError, match="no path of the sensor fits its start"):
        solved(matrix, np.ones(3))


def test_whole_steps_that_run_away_are_tried_again_by_halves():
    """Steps 2.5 times too long: whole ones swing wider and wider, half ones come to rest."""

    def step(errors: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if np.abs(errors).max() > 1e3:
            raise DivergedError("far away")
        return -2.5 * errors, -places

    (errors, places), settled = at_rest(step, (np.array([1.0, -2.0]), np.ones(3)), errors=1)
    assert settled
    assert np.abs(errors).max() < 1e-3
    assert np.abs(places).max() < 1e-2

    def never(errors: np.ndarray) -> tuple[np.ndarray]:
        raise DivergedError(f"{errors} fit nothing")

    with pytest.raises(DivergedError, match="fit nothing"):
        at_rest(never, (np.ones(2),), errors=1)
