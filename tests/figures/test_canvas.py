"""Figures draw what they are given, on the right side, with units, and the same way every time."""

import ast
import io
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from legsim import figures
from legsim.deformation.models import RigidMotion
from legsim.figures import BoxGroup, ErrorLine, ErrorPanel, HeatMap
from tests.examples import scene as example_scene


@pytest.fixture(scope="module")
def scan():
    return example_scene.scan_scene()


@pytest.fixture(scope="module")
def replay(scan):
    return scan.replay


def decoded(figure: Figure) -> np.ndarray:
    with Image.open(io.BytesIO(figures.png(figure, dpi=60))) as picture:
        return np.asarray(picture.convert("RGB"))


def labels(figure: Figure) -> str:
    return " ".join(
        text for ax in figure.axes for text in (ax.get_xlabel(), ax.get_ylabel(), ax.get_title())
    )


@pytest.fixture(scope="module")
def made(scan):
    return one_of_each(scan)


def one_of_each(scan):
    replay = scan.replay
    truth = RigidMotion.from_poses(replay.poses.times, replay.poses.of("tibia_r"))
    estimates = [("none", RigidMotion.identity(truth.times))]
    groups = [
        BoxGroup("rigid", "30 deg", np.linspace(0.9, 1, 5)),
        BoxGroup("uncorrected", "30 deg", np.linspace(0.7, 0.8, 5)),
    ]
    table = HeatMap("SI units", np.array([[1.0, 10.0], [0.1, np.nan]]), ("0", "1"), ("0", "none"))
    return {
        "slices": figures.slices(scan.slices),
        "overlay": figures.overlay(scan.slices[0], scan.slices[1:]),
        "montage": figures.projection_montage(scan.projections, count=5),
        "angles": figures.joint_angles(replay.trajectories, replay.angles()),
        "imu": figures.imu_curves(replay.imu),
        "sway": figures.sway(replay.joint_centers),
        "residuals": figures.marker_residuals(replay),
        "errors": figures.motion_errors(truth, estimates, replay.joint_centers.of("knee_r")[0]),
        "boxes": figures.box_plots(groups, axis_label="SSIM"),
        "noise": figures.error_lines(
            [
                ErrorPanel(
                    "both sensors",
                    "rotation (deg)",
                    1.0,
                    (ErrorLine("SI", np.arange(3.0), np.ones(3)),),
                )
            ]
        ),
        "maps": figures.heat_maps([table], row_axis="f_a", column_axis="f_g", unit="RMSE (mm)"),
        "still": figures.still(replay, 0.5),
    }


@pytest.mark.parametrize(
    ("kind", "unit"),
    [
        ("slices", "1/mm"),
        ("montage", "line integral"),
        ("angles", "deg"),
        ("imu", "m/s²"),
        ("imu", "deg/s"),
        ("sway", "mm"),
        ("residuals", "mm"),
        ("errors", "mm"),
        ("errors", "deg"),
        ("boxes", "SSIM"),
        ("maps", "RMSE (mm)"),
        ("noise", "rotation (deg)"),
    ],
)
def test_axes_carry_units(made, kind, unit):
    assert unit in labels(made[kind])


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("angles", "right left"),
        ("imu", "x y z"),
        ("residuals", "worst marker RMS of all markers"),
        ("errors", "none"),
        ("sway", "knee_l"),
    ],
)
def test_curves_are_explained_once_where_no_curve_is_hidden(made, kind, words):
    figure = made[kind]
    legend_text = " ".join(
        text.get_text() for legend in figure.legends for text in legend.get_texts()
    )
    assert words in legend_text
    assert not any(ax.get_legend() for ax in figure.axes)


@pytest.mark.parametrize("kind", ["angles", "imu", "sway", "residuals", "errors", "still"])
def test_no_text_is_cut_off_or_hides_another(made, kind):
    figure = made[kind]
    figure.canvas.draw()
    legends = [legend.get_window_extent() for legend in figure.legends]
    for ax in figure.axes:
        numbers = (
            [text for axis in (ax.xaxis, ax.yaxis) for text in drawn_numbers(axis)]
            if ax.axison
            else []
        )
        names = [
            text
            for text in (ax.xaxis.label, ax.yaxis.label, ax.title)
            if text.get_text() and (ax.axison or text is ax.title)
        ]
        for text in (*numbers, *names):
            box = text.get_window_extent()
            assert (
                min(box.x0, box.y0, figure.bbox.width - box.x1, figure.bbox.height - box.y1) >= 0
            ), text
            assert not any(box.overlaps(other) for other in legends), text
        for name in names:
            assert not any(
                name.get_window_extent().overlaps(number.get_window_extent()) for number in numbers
            ), name


def drawn_numbers(axis):
    """Labels of the ticks within the plot."""
    low, high = sorted(axis.get_view_interval())
    ticks = [tick for tick in axis.get_major_ticks() if low <= tick.get_loc() <= high]
    return [tick.label1 for tick in ticks if tick.label1.get_visible() and tick.label1.get_text()]


def test_every_figure_is_drawn_on_white(made):
    for name, figure in made.items():
        picture = decoded(figure)
        assert (picture[0, 0] == 255).all(), name
        assert picture.std() > 5, name


def test_the_same_scene_gives_the_same_bytes(replay):
    first, second = (figures.png(figures.still(replay, 0.5), dpi=60) for _ in range(2))
    assert first == second


def test_no_global_state_of_pyplot():
    for path in Path(figures.__file__).parent.glob("*.py"):
        names = [
            a.name
            for n in ast.walk(ast.parse(path.read_text()))
            if isinstance(n, ast.Import)
            for a in n.names
        ]
        modules = [
            n.module or ""
            for n in ast.walk(ast.parse(path.read_text()))
            if isinstance(n, ast.ImportFrom)
        ]
        assert not any("pyplot" in name for name in names + modules)


@pytest.mark.parametrize("name", ["a$b_{c$", "$", "$x^2$ [red]", r"\$\frac$", "$unfinished"])
def test_names_are_drawn_as_they_are(name):
    """A dollar sign begins no formula, wherever a name can stand; letters are as wide as drawn."""
    figure = figures.canvas.new_figure(4, 3)
    (ax,) = figures.canvas.plot_axes(figure, 1)
    ax.plot([0, 1], [0, 1], label=name)
    ax.set_title(name)
    ax.set_ylabel(name)
    ax.set_xticks([0, 1], [name, name])
    ax.legend()
    assert decoded(figure).std() > 0
    assert not any(text.get_parse_math() for text in (ax.title, ax.yaxis.label))


def test_numbers_of_logarithmic_axes_stay_formulas():
    figure = figures.canvas.new_figure(4, 3)
    (ax,) = figures.canvas.plot_axes(figure, 1)
    ax.plot([1, 1e4], [1, 1e4])
    ax.set_yscale("log")
    assert decoded(figure).std() > 0
    powers = [text for text in ax.get_yticklabels() if "10" in text.get_text()]
    assert powers
    assert all(text.get_parse_math() for text in powers)
