"""Every score and every draw of noise of a study as CSV, in full precision."""

import shlex
from collections.abc import Sequence
from dataclasses import asdict, fields

from legsim.evaluation.similarity import RegionScores
from legsim.report import formats
from legsim.study.results import AidedScore, LadderScore, NoiseLevel, ScanScore, SensorScore

_RESIDUALS = ("mm", "degrees", "pixels", "pixels_after_similarity")

_NOISE_COLUMNS = ("convention", "f_a", "f_g")


def _noise_cells(noise: NoiseLevel | None) -> tuple[object, ...]:
    return (None, None, None) if noise is None else (noise.convention, noise.f_a, noise.f_g)


def scores_csv(scores: Sequence[ScanScore]) -> str:
    """One row per score and region: scan, method, noise, scaling and window, the region's scores,
    the registration, every residual, seconds, folder and command.

    Clean sensors have no convention; an exponent of a noisy one that is empty means that this
    sensor was clean.
    """
    metrics = [f.name for f in fields(RegionScores)]
    structures = tuple(dict.fromkeys(r.structure for score in scores for r in score.residuals))
    found = ("translation_mm", "rotation_deg", "applied", "correlation_before", "correlation_after")
    header = [
        "subject",
        "posture",
        "method",
        *_NOISE_COLUMNS,
        "sensor",
        "repetition",
        "scaling",
        "window",
        "registered",
        *metrics,
        *(f"registration_{name}" for name in found),
    ]
    header += [f"{structure}_{unit}" for structure in structures for unit in _RESIDUALS]
    rows = []
    for score in scores:
        registration, left = score.metrics.registration, {r.structure: r for r in score.residuals}
        rest = [None if registration is None else getattr(registration, name) for name in found]
        rest += [
            getattr(left.get(structure), unit, None)
            for structure in structures
            for unit in _RESIDUALS
        ]
        again = ["legsim", "run", f"{score.folder}/config.toml", "--out", "OTHER"]
        rest += [score.seconds, score.folder, shlex.join(again)]
        who = (
            score.subject,
            score.posture,
            score.method,
            *_noise_cells(score.noise),
            score.sensor,
            score.repetition,
            score.metrics.scaling,
            score.metrics.window,
            score.metrics.registered,
        )
        rows += [(*who, *asdict(region).values(), *rest) for region in score.metrics.regions]
    return formats.csv_text([*header, "seconds", "folder", "command"], rows)


def sensors_csv(sensors: Sequence[SensorScore]) -> str:
    """One row per draw of a sensor's errors."""
    header = [f.name for f in fields(SensorScore)]
    return formats.csv_text(header, [tuple(asdict(s).values()) for s in sensors])


def aided_csv(aided: Sequence[AidedScore]) -> str:
    """One row per draw of a sensor's errors and aid."""
    header = [f.name for f in fields(AidedScore)]
    return formats.csv_text(header, [tuple(asdict(s).values()) for s in aided])


def ladder_csv(ladder: Sequence[LadderScore]) -> str:
    """One row per draw of noise; an empty exponent means that this sensor was clean."""
    header = ("subject", "posture", *_NOISE_COLUMNS, "repetition", "translation_mm", "rotation_deg")
    rows = [
        (
            s.subject,
            s.posture,
            *_noise_cells(s.noise),
            s.repetition,
            s.translation_mm,
            s.rotation_deg,
        )
        for s in ladder
    ]
    return formats.csv_text(header, rows)
