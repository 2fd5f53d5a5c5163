"""Keys hold the code: every edit of what makes a stage's numbers changes its key, and no other's."""

import ast
import os
import re
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType

import pytest

from legsim import config
from legsim.core.errors import LegsimError
from legsim.opencl import device
from legsim.run import code, pipeline, sensors, stages
from legsim.run.code import PACKAGE, STAGES, CodeTree
from legsim.run.folder import RunFolder
from legsim.run.stages import StageContext

ALL = tuple(STAGES)
SCAN = ("kinematics", "projections")
VOLUMES = (*SCAN, "fdk", "volume")


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """The sources of the package, with the models beside it."""
    for folder in (PACKAGE, PACKAGE.parent / "models"):
        shutil.copytree(
            folder, tmp_path / folder.name, ignore=shutil.ignore_patterns("__pycache__")
        )
    return tmp_path / "legsim"


def keys(package: Path) -> dict[str, str]:
    """Fingerprint of each stage, as a new process would have it."""
    tree = CodeTree(package)
    return {stage: tree.fingerprint(codes) for stage, codes in STAGES.items()}


def changed_by(package: Path, file: str) -> set[str]:
    """Stages whose keys an edit of that file changes."""
    before = keys(package)
    with (package / file).open("ab") as stream:
        stream.write(b"\n# edited\n")
    after = keys(package)
    return {stage for stage in STAGES if before[stage] != after[stage]}


def test_the_same_code_elsewhere_has_the_same_keys(copy):
    assert keys(copy) == keys(PACKAGE)


@pytest.mark.parametrize(
    ("file", "in_keys_of", "not_in_keys_of"),
    [
        (
            "report/page.py",
            {"presentation"},
            {*ALL} - {"presentation", "replay", "study", "correct"},
        ),
        ("report/templates/report.html.j2", {"presentation", "replay", "correct"}, {*VOLUMES}),
        ("imu/simulation.py", {"imu", "correction", "ladder"}, {*VOLUMES, "scores"}),
        ("imu/noise.py", {"imu", "ladder"}, {*VOLUMES, "tissue_swing", "scores"}),
        ("imu/skin_mount.py", {"imu", "tissue_swing"}, {*VOLUMES}),
        ("core/constants.py", {"kinematics", "imu", "correction"}, {"fdk"}),
        ("core/transforms.py", {"kinematics", "imu", "projections", "fdk", "scores"}, set()),
        ("kinematics/_ik_newton.py", {"kinematics", "ladder"}, {"fdk", "cgls", "scores"}),
        ("opencl/kernels/backproject.cl", {"fdk", "cgls", "study"}, {*SCAN, "imu", "scores"}),
        ("opencl/kernels/project_mesh.cl", {"projections"}, {"fdk", "imu", "kinematics"}),
        ("opencl/kernels/voxelize.cl", {"scores"}, {"fdk", "imu", "kinematics", "projections"}),
        ("opencl/discovery.py", {"projections", "fdk", "scores"}, {"imu", "kinematics"}),
        ("correction/nonrigid.py", {"correction"}, {*VOLUMES, "imu"}),
        ("evaluation/similarity.py", {"scores"}, {*VOLUMES, "imu"}),
        ("reconstruction/weights.py", {"fdk"}, {*SCAN, "imu", "scores"}),
        ("run/sensors.py", {"imu", "tissue_swing", "ladder"}, {*VOLUMES}),
        ("cli/main.py", set(), {*ALL}),
        ("../models/lower_body/lower_body.xml", {"kinematics"}, {"fdk", "cgls"}),
        ("../models/leg_phantom/parts.toml", {"projections", "scores"}, {"kinematics", "imu"}),
        ("../models/marker_sets/cast.toml", {"kinematics"}, {"fdk", "scores"}),
    ],
)
def test_an_edit_changes_the_keys_of_what_it_makes_and_no_others(
    copy, file, in_keys_of, not_in_keys_of
):
    changed = changed_by(copy, file)
    assert in_keys_of <= changed
    assert not not_in_keys_of & changed


def test_an_edit_while_the_process_runs_is_refused(copy):
    tree = CodeTree(copy)
    tree.fingerprint(STAGES["imu"])
    path = copy / "imu/noise.py"
    path.write_bytes(path.read_bytes() + b"\n")
    with pytest.raises(LegsimError, match=r"noise\.py: was changed since .*; start it again"):
        tree.fingerprint(STAGES["imu"])
    assert tree.fingerprint(STAGES["projections"])


def test_every_import_of_the_package_is_found():
    """Against Python's own parser, lazy imports and several lines of names included."""
    for path in PACKAGE.rglob("*.py"):
        wanted = set()
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Import):
                wanted |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                wanted |= {f"{node.module}.{alias.name}" for alias in node.names}
        assert wanted <= code._source(path, re.compile("-")).imports, path


def test_every_module_that_the_table_names_is_there():
    there = {p.relative_to(PACKAGE).with_suffix("").as_posix() for p in PACKAGE.rglob("*.py")}
    there |= {p.parent.relative_to(PACKAGE).as_posix() for p in PACKAGE.rglob("__init__.py")}
    named = {n for one in STAGES.values() for n in (*one.followed, *one.alone)}
    assert not {n for n in named if n.replace(".", "/") not in there}


def test_a_model_in_a_new_folder_is_in_the_key_of_what_names_it(copy):
    (copy.parent / "models/knees").mkdir()
    (copy.parent / "models/knees/one.toml").write_text("a = 1")
    with (copy / "imu/noise.py").open("a") as stream:
        stream.write('\nKNEE = "knees/one.toml"\n')
    assert changed_by(copy, "../models/knees/one.toml") >= {"imu"}
    assert not changed_by(copy, "../models/knees/one.toml") & {*VOLUMES}


def test_versions_of_libraries_are_in_the_keys(monkeypatch):
    before = {stage: code.fingerprint(stage) for stage in STAGES}
    monkeypatch.setattr(code, "_version", lambda name: "0" if name == "mujoco" else name)
    first = {stage: code.fingerprint(stage) for stage in STAGES}
    assert all(before[stage] != first[stage] for stage in STAGES)
    monkeypatch.setattr(code, "_version", lambda name: "1" if name == "mujoco" else name)
    second = {stage: code.fingerprint(stage) for stage in STAGES}
    assert first["kinematics"] != second["kinematics"]
    assert first["fdk"] == second["fdk"]


def test_keys_of_all_stages_read_each_file_once(monkeypatch):
    """What makes them cheap: a run asks for those of every stage."""
    seen: list[Path] = []
    source = code._source

    def counted(path: Path, model: re.Pattern[str]):
        seen.append(path)
        return source(path, model)

    monkeypatch.setattr(code, "_source", counted)
    tree = CodeTree()
    for _ in range(2):
        for stage in (*VOLUMES, "imu", "correction", "scores", "presentation"):
            tree.fingerprint(STAGES[stage])
    assert len(seen) == len(set(seen)) > 100


def executed(call: Callable[[], object]) -> set[str]:
    """Files of the package in which some function ran."""
    seen: set[str] = set()

    def note(frame: FrameType, event: str, _: object) -> None:
        if event == "call":
            seen.add(frame.f_code.co_filename)

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        call()
    finally:
        sys.setprofile(before)
    inside = (os.path.relpath(name, PACKAGE) for name in seen)
    return {name for name in inside if not name.startswith(("..", "<")) and name.endswith(".py")}


PLUMBING = {
    *("core/progress.py", "core/memory.py", "core/errors.py", "__init__.py"),
    *("run/folder.py", "run/store.py", "run/lock.py", "run/code.py"),
}
"""Modules through which values pass unchanged; settings are in the keys by value"""


def in_keys(*parts: str) -> set[str]:
    return set(CodeTree().files(*(STAGES[part] for part in parts))) | PLUMBING


def beyond(ran: set[str], *parts: str) -> set[str]:
    """What ran without being in the keys of these parts."""
    return {n for n in ran - in_keys(*parts) if not n.startswith("config/")}


TINY = (
    *("scan.views=13", "scan.increment_deg=17", "scan.rate_hz=1.53", "scan.columns=60"),
    *("scan.rows=44", "scan.pixel_mm=6.4", "scan.rays_per_pixel=1", "scan.detector.photons=1000"),
    *("grid.voxels=24", "grid.voxel_mm=8", "methods.node_mm=40"),
    *("methods.start=fiducials", "methods.fiducials.detector=unbounded"),
    'methods.run=["static", "uncorrected", "rigid", "nonrigid-2d", "nonrigid-3d", "oracle-nonrigid"]',
)


@pytest.mark.end_to_end
def test_all_that_places_the_person_is_in_the_key_of_the_projections(tmp_path):
    ran = executed(lambda: _set_up(tmp_path, config.load_settings(overrides=TINY)))
    # sensors are placed with the phantom; they decide no projection
    placed = {"imu/sensors.py", "imu/skin_mount.py", "run/sensors.py"}
    assert beyond(ran, *SCAN) <= placed


PARTS = {
    "kinematics": ("kinematics",),
    "imu": ("kinematics", "imu"),
    "geometry": SCAN,
    "projections": SCAN,
    "volume-static": VOLUMES,
    "volume": (*VOLUMES, "correction", "imu"),
    "metrics": (*VOLUMES, "correction", "imu", "scores"),
    "registration": (*VOLUMES, "scores"),
}
"""Parts that decide the key of a stage, by the beginning of its name, the longest last"""


@pytest.mark.end_to_end
def test_all_that_runs_in_a_stage_is_in_its_key(tmp_path, monkeypatch):
    """What a stage calls, found by watching it, is what the table says or less."""
    cached, watched = RunFolder.cached, set()

    def watching(folder: RunFolder, stage: str, key: str, make: Callable) -> bool:
        made: list = []
        ran = executed(lambda: made.extend(make()))
        begins = [name for name in PARTS if stage.startswith(name)]
        if begins:
            watched.add(max(begins, key=len))
            assert not beyond(ran, *PARTS[max(begins, key=len)]), stage
        return cached(folder, stage, key, lambda: made)

    monkeypatch.setattr(RunFolder, "cached", watching)
    pipeline.run_scan(config.load_settings(overrides=TINY), tmp_path, presented=False)
    assert watched == PARTS.keys()


@pytest.mark.end_to_end
def test_a_swinging_phantom_has_its_sensors_code_in_the_key(tmp_path):
    changes = ("phantom.tissue_swing.amplitude=0.5",)
    swinging = config.load_settings(overrides=changes)
    mount = sensors.skin_mount(swinging.phantom.tissue_swing)
    assert mount.amplitude == 0.5
    ran = executed(
        lambda: _set_up(tmp_path, config.load_settings(overrides=(*changes, "scan.views=60")))
    )
    assert not beyond(ran, *SCAN, "tissue_swing")


def _set_up(folder: Path, settings: config.RunConfig) -> None:
    with RunFolder(folder, {}) as opened:
        stages.set_up(StageContext(settings, opened, device.open_device(), lambda *_: None))
