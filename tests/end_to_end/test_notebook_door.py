"""The Python of the README and of the notebook runs as it is written."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

import legsim as ls
from legsim.kinematics.from_recording import find_recording
from legsim.mocap.files import load_markers
from tests.references.c3d import c3d_bytes

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text("utf-8")
EXAMPLES = re.findall(r"```python\n(.*?)```", README, re.S)
pytestmark = pytest.mark.filterwarnings("ignore::legsim.reconstruction.weights.ShortScanWarning")


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with the recording that the README names."""
    monkeypatch.chdir(tmp_path)
    recording = load_markers(find_recording("subject01/squat_60.trc"))
    content = c3d_bytes(
        1e3 * recording.positions_world[..., [0, 2, 1]] * [1, -1, 1],  # z up
        recording.marker_names,
        rate=120.0,
        unit="mm",
        screens=("+X", "+Z"),
    )
    (tmp_path / "standing.c3d").write_bytes(content)
    return tmp_path


def test_the_first_example_gives_a_table_that_says_what_the_correction_did(here, monkeypatch):
    shown = []
    monkeypatch.setattr("legsim.view.show._in_notebook", lambda: True)
    monkeypatch.setattr("legsim.view.show._notebook_viewer", shown.append)
    names: dict = {}
    exec(EXAMPLES[0], names)
    assert len(shown) == 1
    scores, volume, truth = (names[k] for k in ("scores", "volume", "truth"))
    uncorrected = ls.evaluate(
        ls.fdk(names["scan"].seen.projections, names["grid"]), truth, scores_regions(names)
    )
    assert scores.of("leg").ssim > uncorrected.of("leg").ssim + 0.02
    assert f"<td>{scores.of('leg').ssim:.4f}</td>" in scores._repr_html_()
    assert volume.grid == truth.grid


def scores_regions(names: dict) -> tuple[ls.Region, ...]:
    return names["scan"].regions(names["grid"])


def test_projections_with_rtks_geometry_become_a_volume(here):
    person = ls.solve_kinematics("subject01/squat_60.trc")
    scan = ls.simulate_scan(person, ls.CArm.half(angles=np.radians(np.arange(0, 200, 8.0))))
    from legsim.geometry import image_files, save_geometry

    save_geometry("geometry.xml", scan.seen.projections.geometry)
    image_files.save_projections("projections.mha", scan.seen.projections)
    exec(EXAMPLES[1].replace("cubic(256, 1e-3", "cubic(64, 4e-3"), {})
    written = ls.load_volume("volume.mha")
    expected = ls.fdk(scan.seen.projections, written.grid)
    np.testing.assert_allclose(written.attenuation, expected.attenuation, atol=0.02)


def test_an_own_method_stands_beside_the_others(here):
    small = "ls.CArm.half(shape_vu=(120, 155), pixel_pitch=2.464e-3)"
    text = EXAMPLES[2].replace("ls.CArm.half()", small).replace("grid(256, 1e-3)", "grid(80, 3e-3)")
    names: dict = {}
    exec(text, names)
    table, volumes = names["table"], names["volumes"]
    assert list(volumes) == ["static", "own", "rigid", "joints"]
    assert table["rigid"].of("leg").ssim > table["own"].of("leg").ssim
    assert "SSIM leg" in repr(table)
    assert "<th>RMSE thigh</th>" in table._repr_html_()


def test_the_notebook_runs_from_top_to_bottom(here):
    cells = json.loads((ROOT / "docs/notebook.ipynb").read_text("utf-8"))["cells"]
    text = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    for whole, small in (
        ("ls.CArm.half()", "ls.CArm.half(shape_vu=(120, 155), pixel_pitch=2.464e-3)"),
        ("scan.grid(256, 1e-3)", "scan.grid(64, 4e-3)"),
        ("scan.grid(128, 2e-3)", "scan.grid(64, 4e-3)"),
    ):
        assert whole in text
        text = text.replace(whole, small)
    names: dict = {}
    exec(text, names)
    assert list(names["volumes"]) == ["static", "own", "rigid", "joints"]
    assert (here / "scan.rrd").stat().st_size > 1e5
