"""No command writes over what it reads, whatever the name: itself, a link, or a file of a folder."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import tifffile
import trimesh

from legsim.cli import inputs
from legsim.cli import main as cli_main
from legsim.deformation.files import save_motion
from legsim.deformation.models import RigidMotion
from legsim.geometry import files as geometry_files
from legsim.geometry import image_files
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.mocap import opensim
from legsim.mocap.trajectories import JointTrajectories


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """One file of each kind that commands read."""
    folder = tmp_path_factory.mktemp("inputs")
    geometry = ConeBeamGeometry.circular(
        times=np.arange(8) / 30,
        angles=np.radians(45.0 * np.arange(8)),
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=(6, 8),
        pixel_pitch=20e-3,
    )
    geometry_files.save_geometry(folder / "g.json", geometry)
    image_files.save_projections(
        folder / "p.mha", Projections(geometry, np.ones((8, 6, 8), np.float32))
    )
    grid = VolumeGrid.cubic(8, 5e-3, (0, 0, 0))
    values = np.random.default_rng(0).uniform(10, 20, grid.shape_zyx).astype(np.float32)
    image_files.save_volume(folder / "v.mha", Volume(grid, values))
    image_files.save_volume(folder / "l.mha", Volume(grid, np.full((8, 8, 8), 1e3, np.float32)))
    save_motion(folder / "m.npz", RigidMotion.identity(geometry.times))
    tifffile.imwrite(folder / "flat.tif", np.ones((6, 8), np.float32))
    trimesh.creation.icosphere(radius=20.0).export(folder / "ball.ply")
    (folder / "phantom.toml").write_text(
        '[[part]]\nname = "b"\nfile = "ball.ply"\nunit = "mm"\nattenuation_per_mm = 0.02\n'
    )
    opensim.save(
        folder / "a.mot", JointTrajectories([0.0, 0.1], ("knee_angle_r",), [[-0.1], [-0.2]])
    )
    return folder


RECONSTRUCT = (
    *("reconstruct", "p.mha", "--geometry", "g.json", "--like", "v.mha", "--motion", "m.npz"),
    *("--flat", "flat.tif", "--dark", "flat.tif"),
)
COMMANDS = [
    (("convert", "a.mot"), "a.mot", ".mot"),
    (("geometry", "convert", "g.json"), "g.json", ".json"),
    (("project", "phantom.toml", "--geometry", "g.json"), "phantom.toml", ".mha"),
    (("project", "phantom.toml", "--geometry", "g.json"), "g.json", ".mha"),
    *((RECONSTRUCT, name, ".mha") for name in ("p.mha", "g.json", "v.mha", "m.npz", "flat.tif")),
    *(
        (("evaluate", "v.mha", "v.mha", "--regions", "l.mha", "--no-register"), name, ".json")
        for name in ("v.mha", "l.mha")
    ),
]


@pytest.mark.parametrize("name", ["itself", "soft", "hard", "elsewhere"])
@pytest.mark.parametrize(
    ("command", "read", "ending"), COMMANDS, ids=[f"{c[0]}-{r}" for c, r, _ in COMMANDS]
)
def test_an_output_that_is_an_input_is_refused(
    made, tmp_path, monkeypatch, capsys, name, command, read, ending
):
    folder = tmp_path / "copy"
    shutil.copytree(made, folder)
    monkeypatch.chdir(folder)
    out = folder / read if name == "itself" else folder / f"out{ending}"
    if name == "soft":
        out.symlink_to(folder / read)
    elif name == "hard":
        out.hardlink_to(folder / read)
    elif name == "elsewhere":
        out = folder / ".." / "copy" / read
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    refused(capsys, *command, "--out", out)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def refused(capsys, *arguments):
    with pytest.raises(SystemExit) as caught:
        cli_main.main([str(argument) for argument in arguments])
    assert caught.value.code == 1
    error = " ".join(capsys.readouterr().err.split())
    assert "is a file that is read here, and would be lost" in error, error


@pytest.mark.parametrize("option", ["motion.file", "motion.scaling_file"])
def test_a_run_does_not_write_over_its_settings_or_recording(tmp_path, monkeypatch, capsys, option):
    """The results' folder holds what is read: the settings have a result's name."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "config.toml").write_text("# mine\n")
    refused(capsys, "run", "config.toml", "--preset", "demo", "--out", ".")
    assert (tmp_path / "config.toml").read_text() == "# mine\n"
    (tmp_path / "r.toml").write_text("")
    (tmp_path / "config.toml").unlink()
    (tmp_path / "config.toml").hardlink_to(tmp_path / "r.toml")
    refused(capsys, "run", "--preset", "demo", "--set", f"{option}=r.toml", "--out", ".")
    assert (tmp_path / "config.toml").read_text() == ""


def test_a_replay_does_not_write_over_its_recording(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    shipped = Path(__file__).parents[2] / "motions/subject01/squat_30.trc"
    times = np.arange(0, 1, 0.02)
    opensim.save(
        tmp_path / "coordinates.mot",
        JointTrajectories(times, ("knee_angle_r",), -0.2 - 0.1 * np.sin(times)[:, None]),
    )
    before = (tmp_path / "coordinates.mot").read_bytes()
    refused(capsys, "replay", "coordinates.mot", "--out", ".")
    shutil.copy(shipped, tmp_path / "a.trc")
    refused(capsys, "replay", "a.trc", "--out", "replayed", "--image", "a.trc")
    assert (tmp_path / "coordinates.mot").read_bytes() == before
    assert (tmp_path / "a.trc").read_bytes() == shipped.read_bytes()


def test_a_study_does_not_write_over_its_description(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    shipped = Path(__file__).parents[2] / "legsim/study/shipped/quick.toml"
    shutil.copy(shipped, tmp_path / "study.toml")
    refused(capsys, "study", "study.toml", "--out", ".")
    assert (tmp_path / "study.toml").read_bytes() == shipped.read_bytes()


def test_files_of_a_folder_and_of_a_pattern_are_inputs(tmp_path):
    for name in ("v_1.tif", "v_2.tif", "w.tif"):
        (tmp_path / name).touch()
    found = inputs.paths_in([tmp_path / "v_*.tif", {"a": [f"x.y={tmp_path / 'w.tif'}", "text", 3]}])
    assert sorted(path.name for path in found if path.exists()) == ["v_1.tif", "v_2.tif", "w.tif"]


def test_every_command_with_an_output_is_guarded():
    """A new command is, too, where it is registered like the others."""
    groups = [cli_main.app, cli_main.geometry_app]
    commands = [c.callback for group in groups for c in group.registered_commands]
    assert len(commands) > 10
    assert all(hasattr(command, "__wrapped__") for command in commands)
