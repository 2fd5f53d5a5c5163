"""Scores of every method's volume against the motion-free one, and its residual motion.

They are written to metrics.json.
"""

import json
from collections.abc import Callable, Iterable
from dataclasses import asdict, fields, replace
from functools import cache
from pathlib import Path

import numpy as np

from legsim.config import EvaluationConfig
from legsim.core import files
from legsim.core.files import key_of
from legsim.evaluation import registration, residual_motion, similarity
from legsim.evaluation.regions import Region
from legsim.evaluation.registration import RegistrationError
from legsim.evaluation.residual_motion import Residual, Structure
from legsim.evaluation.scores import MethodResult, result_from
from legsim.evaluation.similarity import PreparedReference, RegionScores
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.run import code, methods
from legsim.run import corrected as corrected_volume
from legsim.run.corrected import Reconstructed
from legsim.run.folder import REGISTRATION_ERROR_FILE, registration_error
from legsim.run.stages import StageContext
from legsim.simulation.setup import ScanSetup, scan_regions, true_volume
from legsim.simulation.simulated_scan import SimulatedScan

_SURFACES = (
    ("femur", "femur_cortex"),
    ("tibia", "tibia_cortex"),
    ("patella", "patella_cortex"),
    ("skin", "skin"),
)

_POINTS = 60


def score_methods(
    stage: StageContext,
    scan: SimulatedScan,
    corrected: tuple[Reconstructed, ...],
    grid: VolumeGrid,
) -> tuple[MethodResult, ...]:
    """Scores the methods, one row each.

    Each method is a stage of its own, so that an additional method costs only itself. Regions are
    made at most once, and only where something is scored.
    """
    evaluation, folder = stage.settings.evaluation, stage.folder
    margin = 1e-3 * evaluation.air_margin_mm
    regions = cache(lambda: scan_regions(scan.setup, grid, stage.device, margin=margin))
    shown = cache(lambda: structures(scan.setup, grid))
    # a folder of an older version has fewer
    measures = [f.name for kind in (RegionScores, Residual) for f in fields(kind)]
    prepared = cache(lambda: _prepared(stage, scan.setup, corrected[0].load(), regions()))
    placing: tuple[object, ...] = ()
    if evaluation.registered == "reconstructed":  # what the volumes' own keys held
        settings = stage.settings.reconstruction
        placing = code.fingerprint("placed", settings.algorithm), settings.model_dump()
    results = []
    for k, one in enumerate(corrected):
        stage.on_progress("comparing", k, len(corrected))
        path = folder.path / f"metrics-{one.name}.json"
        made = [
            (name, folder.hash_of(name))
            for name in (*_files(corrected[0]), *_files(one))
            if folder.has(name)
        ]
        key = key_of(
            stage.scan_key,
            code.fingerprint("scores"),
            evaluation.model_dump(),
            similarity.PROTOCOL,
            measures,
            made,
            *placing,
        )

        def write(one: Reconstructed = one, path: Path = path) -> tuple[str, ...]:
            result = _scored(stage, scan, one, prepared(), shown())
            files.write_text(path, json.dumps(asdict(result), indent=1) + "\n")
            return (path.name,)

        folder.cached(path.stem, key, write)
        results.append(result_from(json.loads(path.read_text("utf-8"))))
    stage.on_progress("comparing", len(corrected), len(corrected))
    _write_all(stage, results, _registration_error(stage, corrected[0].load, regions))
    return tuple(results)


def resampled(settings: EvaluationConfig, corrected: Iterable[Reconstructed]) -> list[str]:
    """Says of which methods the volume cannot be reconstructed where it lies."""
    if settings.registered != "reconstructed":
        return []
    return [
        f"{one.name}: its images are its own, so that its volume is resampled where it lies "
        "elsewhere, not reconstructed like the others."
        for one in corrected
        if one.own_images and one.name != methods.REFERENCE
    ]


def _registration_error(
    stage: StageContext, reference: Callable[[], Volume], regions: Callable[[], tuple[Region, ...]]
) -> RegistrationError | None:
    """Error of the registration that all methods use; None without registration."""
    if stage.settings.evaluation.registered == "none":
        return None
    path = stage.folder.path / REGISTRATION_ERROR_FILE
    key = key_of(
        stage.scan_key,
        code.fingerprint("scores"),
        stage.settings.evaluation.model_dump(),
        similarity.PROTOCOL,
        stage.folder.hash_of(f"volume-{methods.REFERENCE}.mha"),
    )

    def write() -> tuple[str, ...]:
        found = registration.registration_error(reference(), regions(), stage.device)
        files.write_text(path, json.dumps(asdict(found), indent=1) + "\n")
        return (path.name,)

    stage.folder.cached(path.stem, key, write)
    return registration_error(stage.folder.path)


def _write_all(
    stage: StageContext, results: list[MethodResult], missed: RegistrationError | None
) -> None:
    """Writes metrics.json for all methods."""
    evaluation = stage.settings.evaluation
    content = {
        "protocol": similarity.PROTOCOL,
        "scaling": evaluation.scaling,
        "window": evaluation.window,
        "compared": similarity.protocol_sentence(
            evaluation.scaling, evaluation.window, evaluation.registered
        ),
        "registration_error": None if missed is None else asdict(missed),
        "methods": [asdict(r) for r in results],
    }

    def write() -> tuple[str, ...]:
        path = stage.folder.path / "metrics.json"
        files.write_text(path, json.dumps(content, indent=1) + "\n")
        return (path.name,)

    stage.folder.cached("metrics", key_of(content), write)


def _files(one: Reconstructed) -> tuple[str, ...]:
    label = one.name
    return (
        f"volume-{label}.mha",
        f"motion-{label}.npz",
        f"warp-{label}.npz",
        f"correction-{label}.json",
    )


def _prepared(
    stage: StageContext, setup: ScanSetup, reference: Volume, regions: tuple[Region, ...]
) -> PreparedReference:
    """The motion-free volume and the phantom, as all methods are scored against them."""
    evaluation = stage.settings.evaluation
    return similarity.prepare(
        reference,
        regions,
        scaling=evaluation.scaling,
        window=evaluation.window,
        phantom=true_volume(setup, reference.grid, stage.device, regions),
        device=stage.device,
    )


def _scored(
    stage: StageContext,
    scan: SimulatedScan,
    one: Reconstructed,
    prepared: PreparedReference,
    seen: tuple[Structure, ...],
) -> MethodResult:
    name, setup, settings = one.name, scan.setup, stage.settings
    at_rest, how = name == methods.REFERENCE, settings.evaluation.registered
    again = None
    if how == "reconstructed" and not at_rest:
        again = corrected_volume.reconstructed_at(
            one, scan.seen.projections, settings.reconstruction, prepared.grid, stage.device
        )
    metrics = prepared.scores(one.load(), register=how != "none", reconstructed_at=again)
    if at_rest:
        metrics = replace(metrics, registered=how)  # it lies where it is compared
        # its leg rests: nothing is left
        left = residual_motion.of_motion(None, tuple(s.at_rest() for s in seen), setup.geometry)
    elif one.warped_by is not None:
        left = residual_motion.of_warp(one.warped_by, seen, setup.geometry)
    else:
        left = residual_motion.of_motion(one.motion, seen, setup.geometry)
    overall = None if at_rest else residual_motion.overall_mm(left)
    return MethodResult(name, metrics, overall, stage.folder.seconds(f"volume-{name}"), left)


def structures(setup: ScanSetup, grid: VolumeGrid) -> tuple[Structure, ...]:
    """Points on the bones of the scanned knee and on its skin, and their true paths.

    They lie within the field of view and the grid.
    """
    start, vertices = setup.poses.world_from_segment[0], setup.scanned_leg()
    half = 0.5 * np.array(grid.shape_zyx[::-1]) * grid.spacing_xyz
    found = []
    there = {part.name: k for k, part in enumerate(setup.phantom.phantom.parts)}
    for name, part in _SURFACES:
        k = there.get(setup.named(part))
        if k is None:  # an imaged leg need not have them all
            continue
        away = vertices[k] - np.array(grid.center)
        pixels, _ = setup.geometry.project(vertices[k])
        shown = ((pixels > 0) & (pixels < np.array(setup.geometry.shape_vu[::-1]) - 1)).all((0, 2))
        inside = np.flatnonzero(
            (np.abs(away) < half).all(-1)
            & (np.hypot(away[:, 0], away[:, 2]) < setup.c_arm.field_of_view)
            & shown
        )
        if len(inside) < 3:
            continue
        chosen = vertices[k][
            inside[np.linspace(0, len(inside) - 1, min(_POINTS, len(inside))).astype(int)]
        ]
        segment = setup.phantom.segments[k]
        paths = setup.phantom.paths(
            chosen,
            segment,
            start=start,
            poses=setup.poses.world_from_segment,
            segment_names=setup.poses.segment_names,
        )
        found.append(Structure(name, not segment.startswith("soft"), paths))
    return tuple(found)
