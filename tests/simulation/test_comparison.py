"""The table of a comparison, and what is refused before anything is computed.

That volumes and scores are those of the single steps is held by the README's example.
"""

from types import SimpleNamespace
from typing import cast

import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.correction.method import Correction, Scan
from legsim.correction.rigid import Uncorrected
from legsim.deformation.models import RigidMotion
from legsim.evaluation.similarity import RegionScores, Scores
from legsim.simulation.comparison import ScoreTable, compare
from legsim.simulation.simulated_scan import SimulatedScan, simulate_scan
from tests.examples.squat import ARM, GRID_VOXELS, squatting


def scores(ssim: float) -> Scores:
    regions = (RegionScores("leg", ssim, 0.01, 10.0, 100), RegionScores("shank", 1.0, 0.0, 9.0, 50))
    return Scores(regions, None)


TABLE = ScoreTable({"own <b>": scores(0.5), "rigid": scores(0.75)})


def test_rows_have_a_cell_per_column():
    assert TABLE.columns() == ("method", "SSIM leg", "SSIM shank", "RMSE leg", "RMSE shank")
    assert TABLE.rows()[1] == ("rigid", "0.750", "1.000", "0.010", "0.000")
    assert all(len(row) == len(TABLE.columns()) for row in TABLE.rows())


def test_a_method_is_found_by_name_or_the_names_are_listed():
    assert TABLE["rigid"].of("leg").ssim == 0.75
    with pytest.raises(LegsimError, match="unknown method 'x'; known: own <b>, rigid"):
        TABLE["x"]


def test_text_in_the_page_is_escaped_and_columns_of_the_text_line_up():
    assert "own &lt;b&gt;" in TABLE._repr_html_()
    lines = repr(TABLE).splitlines()
    assert len({line.index("0.") for line in lines[1:-1]}) == 1
    assert lines[-1] == TABLE.protocol


@pytest.mark.parametrize("methods", [{}, {"static": Uncorrected()}])
def test_no_method_and_one_named_like_the_reference_are_refused(methods):
    nothing = cast(SimulatedScan, SimpleNamespace())
    with pytest.raises(LegsimError, match="needs methods by name, none of them called 'static'"):
        compare(nothing, methods)


def test_an_unknown_kind_of_registration_is_refused():
    nothing = cast(SimulatedScan, SimpleNamespace())
    with pytest.raises(LegsimError, match="'moved'; choose one of reconstructed, resampled, none"):
        compare(nothing, {"own": Uncorrected()}, registered="moved")  # type: ignore[arg-type]


@pytest.mark.filterwarnings("ignore::legsim.reconstruction.weights.ShortScanWarning")
def test_a_right_volume_that_lies_elsewhere_is_as_good_as_one_in_place():
    scan = simulate_scan(squatting(), ARM, side="left")
    grid = scan.grid(GRID_VOXELS)
    shift = transforms.translation([0.4 * grid.spacing_xyz[0], 0.0, 0.0])

    def elsewhere(seen: Scan) -> Correction:
        still = RigidMotion.identity(seen.times).placed(shift)
        return Correction("elsewhere", scan.at_rest, still)

    fair = compare(scan, {"own": elsewhere}, grid).table["own"]
    resampled = compare(scan, {"own": elsewhere}, grid, registered="resampled").table["own"]
    loose = compare(scan, {"own": elsewhere}, grid, registered="none").table["own"]
    # 6 mm voxels and no noise: resampling alone leaves 0.005
    assert fair.of("leg").ssim > 0.9999
    assert fair.of("leg").rmse < 0.1 * resampled.of("leg").rmse < 0.05 * loose.of("leg").rmse
