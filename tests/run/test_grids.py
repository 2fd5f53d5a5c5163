"""The grid is what a user says, else the field of view, and contradictions are refused."""

from pathlib import Path

import pytest

from legsim.core.errors import LegsimError
from legsim.geometry import image_files
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.reconstruction import field_of_view
from legsim.run.grids import WantedGrid
from tests.examples import measured


def test_numbers_are_in_mm_around_the_rotation_center():
    geometry = measured.geometry()
    grid, notes = WantedGrid(shape_zyx=(4, 5, 6), spacing_mm=(1.0, 2.0, 3.0)).of(geometry)
    assert grid == VolumeGrid((4, 5, 6), (1e-3, 2e-3, 3e-3), tuple(geometry.rotation_center()))
    assert notes == ()
    placed = WantedGrid(shape_zyx=(4, 5, 6), spacing_mm=(1, 2, 3), center_mm=(10, 20, 30))
    assert placed.of(geometry)[0].center == pytest.approx((0.01, 0.02, 0.03))


def test_another_volumes_grid(tmp_path: Path):
    grid = VolumeGrid((4, 5, 6), (1e-3, 2e-3, 3e-3), (0.01, 0.02, 0.03))
    volume = Volume(grid, measured.np.zeros((4, 5, 6), measured.np.float32))
    image_files.save_volume(tmp_path / "v.mha", volume)
    found, _ = WantedGrid(like=tmp_path / "v.mha").of(measured.geometry())
    assert found.alike(grid)


def test_the_field_of_view_is_reported():
    geometry = measured.geometry()
    grid, notes = WantedGrid().of(geometry)
    assert grid == field_of_view.grid_of(geometry)
    assert "grid: the field of view, " in notes[0]
    moved, _ = WantedGrid(center_mm=(1.0, 2.0, 3.0)).of(geometry)
    assert moved.center == pytest.approx((1e-3, 2e-3, 3e-3))
    assert moved.shape_zyx == grid.shape_zyx


@pytest.mark.parametrize(
    ("where", "said"),
    [("", "^--like already"), ("scan.toml (grid)", r"^scan.toml \(grid\): like al")],
)
def test_contradictions_are_named_as_they_were_given(where, said):
    with pytest.raises(LegsimError, match=said):
        WantedGrid(like=Path("v.mha"), spacing_mm=(1, 1, 1), where=where).of(measured.geometry())
    with pytest.raises(LegsimError, match=r"without .*spacing.mm; give both"):
        WantedGrid(shape_zyx=(4, 4, 4), where=where).of(measured.geometry())
