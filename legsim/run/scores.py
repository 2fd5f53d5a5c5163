"""Every method's volume against the motion-free one, and what each left of the motion; written to
metrics.json.
"""

import json
from collections.abc import Callable
from dataclasses import asdict, fields

import numpy as np

from legsim.core import files
from legsim.core.files import key_of
from legsim.evaluation import registration, residual_motion, similarity
from legsim.evaluation.regions import SCALING_PERCENTILES, Region
from legsim.evaluation.registration import RegistrationError
from legsim.evaluation.residual_motion import Structure
from legsim.evaluation.scores import MethodResult, result_from
from legsim.evaluation.similarity import RegionMetrics
from legsim.geometry.volume import VolumeGrid
from legsim.run import c_arm
from legsim.run.folder import REGISTRATION_ERROR_FILE, registration_error
from legsim.run.stages import ScanSetup, StageContext
from legsim.run.volumes import Reconstructed

_SURFACES = (
    ("femur", "femur_cortex_l"),
    ("tibia", "tibia_cortex_l"),
    ("patella", "patella_cortex_l"),
    ("skin", "skin_l"),
)

_POINTS = 60


def score_methods(
    stage: StageContext,
    body: ScanSetup,
    corrected: tuple[Reconstructed, ...],
    regions: Callable[[], tuple[Region, ...]],
    grid: VolumeGrid,
) -> tuple[MethodResult, ...]:
    """A row a method; each is a stage of its own, so that a further method costs only itself.
    ``regions`` is asked at most once.
    """
    settings, folder = stage.settings, stage.folder
    seen: list[tuple[tuple[Region, ...], tuple[Structure, ...]]] = []
    results = []
    measures = [f.name for f in fields(RegionMetrics)]  # a folder of an older version has fewer
    for k, one in enumerate(corrected):
        stage.on_progress("comparing", k, len(corrected))
        path = folder.path / f"metrics-{one.volume.name}.json"
        made = [
            (name, folder.hash_of(name))
            for name in (*_files(corrected[0]), *_files(one))
            if folder.has(name)
        ]
        key = key_of(
            stage.scan_key, settings.evaluation.model_dump(), similarity.PROTOCOL, measures, made
        )
        if not folder.done(path.stem, key):
            with folder.stage(path.stem, key, [path.name]):
                if not seen:
                    seen.append(
                        (regions(), structures(body, grid, c_arm.field_of_view(settings.scan)))
                    )
                result = _compared(stage, body, one, corrected[0], *seen[0])
                files.write_text(path, json.dumps(asdict(result), indent=1) + "\n")
        results.append(result_from(json.loads(path.read_text("utf-8"))))
    stage.on_progress("comparing", len(corrected), len(corrected))
    _write_all(stage, results, _registration_error(stage, corrected[0], regions))
    return tuple(results)


def _registration_error(
    stage: StageContext, reference: Reconstructed, regions: Callable[[], tuple[Region, ...]]
) -> RegistrationError | None:
    """Of the registration that all methods go through; None where there is none."""
    if not stage.settings.evaluation.register_volumes:
        return None
    path = stage.folder.path / REGISTRATION_ERROR_FILE
    key = key_of(
        stage.scan_key,
        stage.settings.evaluation.model_dump(),
        similarity.PROTOCOL,
        stage.folder.hash_of(f"volume-{reference.volume.name}.mha"),
    )
    if not stage.folder.done(path.stem, key):
        with stage.folder.stage(path.stem, key, [path.name]):
            found = registration.registration_error(reference.volume.volume, regions())
            files.write_text(path, json.dumps(asdict(found), indent=1) + "\n")
    return registration_error(stage.folder.path)


def _write_all(
    stage: StageContext, results: list[MethodResult], missed: RegistrationError | None
) -> None:
    """metrics.json: every method's."""
    content = {
        "scaling": (
            f"percentiles {SCALING_PERCENTILES} of each volume inside the regions to 0 and 1"
        ),
        "registration_error": None if missed is None else asdict(missed),
        "methods": [asdict(r) for r in results],
    }
    key = key_of(content)
    if not stage.folder.done("metrics", key):
        with stage.folder.stage("metrics", key, ["metrics.json"]):
            files.write_text(
                stage.folder.path / "metrics.json", json.dumps(content, indent=1) + "\n"
            )


def _files(one: Reconstructed) -> tuple[str, ...]:
    label = one.volume.name
    return f"volume-{label}.mha", f"motion-{label}.npz", f"warp-{label}.npz"


def _compared(
    stage: StageContext,
    body: ScanSetup,
    one: Reconstructed,
    reference: Reconstructed,
    regions: tuple[Region, ...],
    seen: tuple[Structure, ...],
) -> MethodResult:
    name = one.volume.name
    register = stage.settings.evaluation.register_volumes
    metrics = similarity.evaluate(
        one.volume.volume, reference.volume.volume, regions, register=register
    )
    if one is reference:
        # its leg rests: nothing is left
        left = residual_motion.of_motion(None, tuple(s.at_rest() for s in seen), body.geometry)
    elif one.warped_by is not None:
        left = residual_motion.of_warp(one.warped_by, seen, body.geometry)
    else:
        left = residual_motion.of_motion(one.motion, seen, body.geometry)
    overall = None if one is reference else residual_motion.overall_mm(left)
    return MethodResult(name, metrics, overall, stage.folder.seconds(f"volume-{name}"), left)


def structures(body: ScanSetup, grid: VolumeGrid, field_of_view: float) -> tuple[Structure, ...]:
    """Points on the bones of the left knee and on its skin, within the field of view and the grid,
    and their true way.
    """
    start = body.poses.world_from_segment[0]
    vertices = body.phantom.posed(start, body.poses.segment_names)
    half = 0.5 * np.array(grid.shape_zyx[::-1]) * grid.spacing_xyz
    found = []
    for name, part in _SURFACES:
        k = body.phantom.part_index(part)
        away = vertices[k] - np.array(grid.center)
        pixels, _ = body.geometry.project(vertices[k])
        shown = ((pixels > 0) & (pixels < np.array(body.geometry.shape_vu[::-1]) - 1)).all((0, 2))
        inside = np.flatnonzero(
            (np.abs(away) < half).all(-1)
            & (np.hypot(away[:, 0], away[:, 2]) < field_of_view)
            & shown
        )
        if len(inside) < 3:
            continue
        chosen = vertices[k][
            inside[np.linspace(0, len(inside) - 1, min(_POINTS, len(inside))).astype(int)]
        ]
        segment = body.phantom.segments[k]
        paths = body.phantom.paths(
            chosen,
            segment,
            start=start,
            poses=body.poses.world_from_segment,
            segment_names=body.poses.segment_names,
        )
        found.append(Structure(name, not segment.startswith("soft"), paths))
    return tuple(found)
