"""Tables of matrices: how numbers in lines become views, and what is refused instead of misread."""

import numpy as np
import pytest
from scipy.io import savemat

from legsim.core.errors import LegsimError
from legsim.geometry import matrix_tables
from tests.geometry.test_files import corrected

ROWS = (corrected().matrices * [1, 1, 1, 1e3]).reshape(-1, 12)
NUMBERS = np.arange(5.0)[:, None]
SQUARE = np.concatenate([ROWS, np.tile([0, 0, 0, 1.0], (5, 1))], 1)


def text(rows) -> str:
    return "\n".join(" ".join(map(repr, row)) for row in np.asarray(rows, float).tolist())


FORMS = {
    "one view a line": text(ROWS),
    "with commas": text(ROWS).replace(" ", ", "),
    "a number first": text(np.hstack([NUMBERS, ROWS])),
    "numbered from 1": text(np.hstack([NUMBERS + 1, ROWS])),
    "4x4": text(SQUARE),
    "three lines a view": text(ROWS.reshape(-1, 4)),
    "four lines a view": text(SQUARE.reshape(-1, 4)),
    "its number above": "\n".join(
        f"{k}\n{text(m)}\n" for k, m in enumerate(ROWS.reshape(-1, 3, 4))
    ),
    "brackets": "\n".join(
        "[" + "; ".join("[" + text([row]) + "]" for row in m) + "]" for m in ROWS.reshape(-1, 3, 4)
    ),
}


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS)
def test_all_forms_of_text_are_the_same_views(tmp_path, form):
    (tmp_path / "m.txt").write_text("# a comment\n" + form + "\n% MATLAB's\n")
    np.testing.assert_array_equal(matrix_tables.load(tmp_path / "m.txt"), ROWS)


@pytest.mark.parametrize(
    "values",
    [ROWS, ROWS.reshape(-1, 3, 4), SQUARE, SQUARE.reshape(-1, 4, 4), np.hstack([NUMBERS, ROWS])],
    ids=lambda v: str(v.shape),
)
def test_all_shapes_of_arrays_are_the_same_views(tmp_path, values):
    np.save(tmp_path / "m.npy", values)
    np.testing.assert_array_equal(matrix_tables.load(tmp_path / "m.npy"), ROWS)


@pytest.mark.parametrize(
    "values",
    [
        ROWS,
        ROWS.reshape(-1, 3, 4).transpose(1, 2, 0),
        SQUARE.reshape(-1, 4, 4).transpose(1, 2, 0),
    ],
    ids=lambda v: str(v.shape),
)
def test_matlabs_files_hold_one_table(tmp_path, values):
    savemat(tmp_path / "m.mat", {"P": values, "comment": "scan", "sdd": 1198.0})
    np.testing.assert_array_equal(matrix_tables.load(tmp_path / "m.mat"), ROWS)
    savemat(tmp_path / "m.mat", {"P": values, "Q": values})
    with pytest.raises(LegsimError, match="holds 2 variables with 12 numbers per view"):
        matrix_tables.load(tmp_path / "m.mat")
    (tmp_path / "m.mat").write_bytes(b"nothing that MATLAB wrote")
    with pytest.raises(LegsimError, match="is not a MATLAB file"):
        matrix_tables.load(tmp_path / "m.mat")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (text(np.hstack([ROWS, NUMBERS, NUMBERS])), "lines of 14"),
        (text(ROWS[:, :11]), "lines of 11"),
        (text(ROWS.reshape(-1)[None]), "lines of 60"),
        (text(ROWS) + "\n1 2 3", r"line 6\): holds 63 numbers"),
        (
            text(np.hstack([NUMBERS[[0, 1, 3, 2, 4]], ROWS])),
            r"line 3\): of 13 numbers the first, 3",
        ),
        (text(np.hstack([10.5 * NUMBERS + 0.3, ROWS])), r"line 1\): of 13 numbers the first, 0\.3"),
        (
            text(np.where(np.arange(16) == 15, 2.0, SQUARE)),
            r"line 1\): 16 numbers .* last row is 0 0 0 2",
        ),
        (text(ROWS.reshape(-1, 4)[:-1]), "lines of 4"),
        ("# nothing", "holds 0 numbers"),
        ("1 2 3 x", r"line 1\): 'x' is not a number"),
    ],
)
def test_other_counts_are_refused(tmp_path, content, message):
    (tmp_path / "m.txt").write_text(content)
    with pytest.raises(LegsimError, match=message):
        matrix_tables.load(tmp_path / "m.txt")


def test_written_text_reads_back_to_the_last_bit(tmp_path):
    (tmp_path / "m.txt").write_text(matrix_tables.text_of(ROWS, "a comment"))
    np.testing.assert_array_equal(matrix_tables.load(tmp_path / "m.txt"), ROWS)


def test_a_table_with_view_numbers_of_a_scanner(shared_data):
    rows = matrix_tables.load(shared_data / "cases/22_matrix_index/indexed.txt")
    assert rows.shape == (240, 12)
    assert rows[:, 11] == pytest.approx(1.0)
