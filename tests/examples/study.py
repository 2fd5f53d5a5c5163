"""Results of a study as a report might get them: seven subjects in two squats, the noise ladder,
and a few noisy reconstructions.
"""

import io
from functools import cache

import numpy as np
from PIL import Image

from legsim.evaluation.registration import Registration, RegistrationError
from legsim.evaluation.residual_motion import Residual
from legsim.evaluation.similarity import RegionScores, Scores
from legsim.study.results import LadderScore, NoiseLevel, ScanScore, StageCost, StudyResults

METHODS = {
    "static": 0.0,
    "uncorrected": 0.12,
    "marker-based": 0.04,
    "rigid": 0.03,
    "nonrigid-2d": 0.02,
    "nonrigid-3d": 0.025,
    "oracle": 0.03,
    "oracle-nonrigid": 0.015,
}
EXPONENTS = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0, None)
RIGID_LEVELS = ((5.0, 5.0), (5.0, 4.0), (4.0, 5.0), (4.0, 4.0))


def score(
    rng: np.random.Generator,
    subject: str,
    posture: str,
    method: str,
    loss: float,
    noise: NoiseLevel | None = None,
) -> ScanScore:
    """Of a method that loses about so much similarity."""
    lost = loss * rng.uniform(0.7, 1.4)
    regions = tuple(
        RegionScores(
            name,
            1 - lost * k,
            0.5 * lost * k,
            12 + lost * k,
            100_000,
            0.9 - 0.5 * lost * k,
            0.05 + 0.2 * lost * k,
        )
        for name, k in (("leg", 1.0), ("shank", 0.95), ("thigh", 1.1))
    )
    found = (
        None
        if method == "static"
        else Registration(4 * lost, lost, bool(rng.integers(2)), 0.9, 0.95, "converged")
    )
    flat = method == "nonrigid-2d"
    left = tuple(
        Residual(
            name,
            None if flat else 8 * lost,
            None if flat or name == "skin" else 2 * lost,
            6 * lost,
            4 * lost,
        )
        for name in ("femur", "tibia", "patella", "skin")
    )
    stem = f"runs/{subject}-{posture}" + ("" if noise is None else f"-{noise.stem}")
    return ScanScore(
        subject,
        posture,
        method,
        noise,
        0,
        Scores(regions, found),
        left,
        float(rng.uniform(5, 90)),
        stem,
    )


@cache
def results() -> StudyResults:
    """All of it; the same every time."""
    rng = np.random.default_rng(7)
    scans = [(f"subject{k:02d}", f"squat_{angle}") for k in range(1, 8) for angle in (30, 60)]
    scores = [score(rng, *scan, method, loss) for scan in scans for method, loss in METHODS.items()]
    for convention, worse in (("SI", 1e-3), ("per-sample", 1.0)):
        for f_a, f_g in RIGID_LEVELS:
            loss = 0.03 + 0.05 * worse * (5 - f_a)
            scores += [
                score(rng, *scan, "rigid", loss, NoiseLevel(convention, f_a, f_g)) for scan in scans
            ]
    ladder = [
        LadderScore(
            "subject01",
            "squat_30",
            NoiseLevel(convention, f_a, f_g),
            draw,
            *deviation(rng, size, f_a, f_g),
        )
        for convention, size in (("SI", 1e-3), ("per-sample", 1.0))
        for f_a in EXPONENTS
        for f_g in EXPONENTS
        for draw in range(5)
    ]
    provenance = (
        ("command", "legsim study paper.toml --out study"),
        ("version", "0.1.0"),
        ("device", "cpu"),
    )
    costs = (StageCost("replay", 14, 2.5, 400.0), StageCost("volume-rigid", 126, 8.0, None))
    failures = ("subject09 squat_30: no file",)
    errors = tuple(RegistrationError(0.002 * k, 0.001 * k) for k in range(1, 15))
    return StudyResults(
        "paper",
        "Seven subjects & eight methods",
        tuple(scores),
        tuple(ladder),
        provenance,
        failures,
        costs,
        errors,
    )


def deviation(
    rng: np.random.Generator, size: float, f_a: float | None, f_g: float | None
) -> tuple[float, float]:
    """mm and degrees, much as double integration makes them; 1 for ``size`` is the published
    one.
    """
    force, turn = (0.0 if f is None else 10.0**-f for f in (f_a, f_g))
    drawn = rng.uniform(0.7, 1.4)
    return size * drawn * float(np.hypot(8000 * force, 1200 * turn)), max(
        size * drawn * 1.4 * turn, 1e-5 * size * (force > 0)
    )


def picture() -> bytes:
    """Stands for a picture of slices: a wide PNG."""
    stream = io.BytesIO()
    Image.effect_mandelbrot((1600, 600), (-3, -2.5, 2, 2.5), 50).save(stream, "PNG")
    return stream.getvalue()
