"""projtable.txt: a scanner's own table, made ones, and what is refused."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.geometry import files, projtable
from tests.geometry.test_files import circular


def test_a_written_table_reads_back(tmp_path):
    text = projtable.text_of(circular())
    assert projtable.is_table(text)
    matrices = projtable.matrices(tmp_path / "p.txt", text)
    np.testing.assert_allclose(matrices[:, 2, 3], 1.0)
    scaled = matrices / np.linalg.norm(matrices[:, 2, :3], axis=-1)[:, None, None]
    np.testing.assert_allclose(scaled, circular().matrices * [1, 1, 1, 1e3], rtol=1e-9, atol=1e-6)


def test_a_scanners_table_is_its_matrices(shared_data):
    """The same scan as the table with view numbers, in ten digits."""
    cases, detector = shared_data / "cases", {"columns": 620, "rows": 480}
    table = files.read_geometry(cases / "25_other_geometries/projtable.txt", **detector)
    assert (table.format, len(table.geometry)) == ("projtable", 240)
    other = files.load_geometry(cases / "22_matrix_index/indexed.txt", **detector)
    point = other.rotation_center()[None]
    np.testing.assert_allclose(table.geometry.project(point)[0], other.project(point)[0], atol=1e-3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.replace("\n5\n", "\n6\n"), "announces 6 views, 5 are there"),
        (lambda t: t.replace("@3", "@4"), r"\(line 18\): view '4' is out of order"),
        (
            lambda t: t.replace("0.0 0.0\n", "0.0 0.0\n1 2\n3 4\n"),
            r"\(line 6\): its view has no 3x4",
        ),
        (lambda t: t.replace("0.0 0.0", "x"), "its view has no 3x4"),
        (lambda t: t[: t.index("@")], "holds no view"),
    ],
)
def test_broken_tables_are_refused(tmp_path, change, message):
    with pytest.raises(LegsimError, match=message):
        projtable.matrices(tmp_path / "p.txt", change(projtable.text_of(circular())))
