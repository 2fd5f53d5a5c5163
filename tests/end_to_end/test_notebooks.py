"""Every notebook of docs/notebooks runs from top to bottom, at a size of seconds, and shows one
picture.
"""

import ast
import json
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "docs/notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
SMALLER = (
    ("VIEWS, PIXELS, PITCH = 100, (120, 155), 2.464e-3", "VIEWS, PIXELS, PITCH = 40, (40, 52), 7.4e-3"),
    ("scan.grid(96, 2.5e-3)", "scan.grid(32, 7.5e-3)"),
    ("shape_zyx = [64, 64, 64]\nspacing_mm = [4.0, 4.0, 4.0]", "shape_zyx = [24, 24, 24]\nspacing_mm = [10.0, 10.0, 10.0]"),
    ("angles=np.radians([0.0, 90.0]))", "angles=np.radians([0.0, 90.0]), shape_vu=(60, 78), pixel_pitch=4.9e-3)"),
)  # fmt: skip

pytestmark = [
    pytest.mark.end_to_end,
    pytest.mark.filterwarnings("ignore::legsim.reconstruction.weights.ShortScanWarning"),
]


def cells(path: Path) -> list[str]:
    """Code of a notebook, for a small scan."""
    found = json.loads(path.read_text("utf-8"))["cells"]
    texts = ["".join(cell["source"]) for cell in found if cell["cell_type"] == "code"]
    for whole, small in SMALLER:
        texts = [text.replace(whole, small) for text in texts]
    return texts


def shown(text: str, names: dict) -> object:
    """Runs a cell; the value of its last expression, which a notebook shows."""
    tree = ast.parse(text)
    if not isinstance(tree.body[-1], ast.Expr):
        exec(compile(tree, "cell", "exec"), names)
        return None
    last = tree.body.pop()
    assert isinstance(last, ast.Expr)
    exec(compile(tree, "cell", "exec"), names)
    return eval(compile(ast.Expression(last.value), "cell", "eval"), names)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_shows_one_picture(path, tmp_path, monkeypatch):
    import matplotlib.pyplot as plt
    from matplotlib.figure import Figure

    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(FOLDER.parents[1]))
    plt.switch_backend("Agg")
    names: dict = {}
    values = [shown(text, names) for text in cells(path)]
    figures = [value for value in values if isinstance(value, Figure)]
    figures += [plt.figure(number) for number in plt.get_fignums()]
    plt.close("all")
    assert len(figures) == 1
    figures[0].savefig(tmp_path / "picture.png")
    assert (tmp_path / "picture.png").stat().st_size > 3000


def test_notebooks_hold_no_outputs_and_every_smaller_size_is_somewhere():
    sources = ""
    for path in NOTEBOOKS:
        found = json.loads(path.read_text("utf-8"))["cells"]
        assert all(not cell.get("outputs") for cell in found)
        sources += "".join("".join(cell["source"]) for cell in found)
    assert len(NOTEBOOKS) >= 7
    assert all(whole in sources for whole, _ in SMALLER)
