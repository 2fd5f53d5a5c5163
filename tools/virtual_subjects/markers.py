"""What the cameras see: seven skin markers on a moving body, with soft-tissue motion, camera noise
and drop-outs.

Skin slides over bone in proportion to joint flexion (a linear law, after Camomilla, Bonci and
Cappozzo 2017, J Biomech 62:68-76) and swings on the soft tissue below it as a damped oscillator
driven by the bone's acceleration. The sizes are those of taped markers on bony landmarks of lean
adults, at the low end of what is reported. Cameras add white noise, a slow wander and a fixed error
of calibration.

Knee and ankle markers sit where gait2392's marker set has them. Its pelvis markers lie 4 cm further
from the hips than people's do, so here they are put where people have them: spread by the
regressions of Harrington et al. (2007, J Biomech 40:595-602) around the hips, with what a person
deviates from them.
"""

from dataclasses import dataclass

import numpy as np
from scipy.signal import bilinear, lfilter

from legsim.core.values import FloatArray
from legsim.mocap.trajectories import MarkerTrajectories
from tools.virtual_subjects.body import Body, scale_of
from tools.virtual_subjects.controller import smooth_noise
from tools.virtual_subjects.plan import RATE, STANDING_DEG
from tools.virtual_subjects.simulation import Performance


@dataclass(frozen=True, slots=True)
class Marker:
    """One marker of the set, on the right or in the middle; ``slide_mm`` per 90 deg of the flexion
    that moves the skin.
    """

    label: str
    body: str
    place: tuple[float, float, float]
    """m in the generic body frame; of the pelvis only a sketch, see pelvis_places"""
    flexion: str
    """coordinate whose change from standing drags the skin"""
    slide_mm: tuple[float, float, float]
    """along x, y, z of the body"""


MARKERS = (
    Marker("SACR", "pelvis", (-0.16, 0.04, 0.0), "hip_flexion_r", (-1.0, -3.0, 0.0)),
    Marker("RASI", "pelvis", (0.02, 0.03, 0.128), "hip_flexion_r", (1.5, 3.0, 1.0)),
    Marker("LASI", "pelvis", (0.02, 0.03, -0.128), "hip_flexion_l", (1.5, 3.0, -1.0)),
    Marker("RKNE", "femur_r", (0.0, -0.404, 0.05), "knee_angle_r", (3.5, -3.0, -1.5)),
    Marker("LKNE", "femur_l", (0.0, -0.404, -0.05), "knee_angle_l", (3.5, -3.0, 1.5)),
    Marker("RANK", "tibia_r", (-0.005, -0.41, 0.053), "ankle_angle_r", (1.0, 2.0, 0.0)),
    Marker("LANK", "tibia_l", (-0.005, -0.41, -0.053), "ankle_angle_l", (1.0, 2.0, 0.0)),
)
LABELS = tuple(marker.label for marker in MARKERS)


@dataclass(frozen=True, slots=True)
class CameraParams:
    """Errors of the optical system; per axis and standard deviation where in mm."""

    placement_mm: float = 1.0
    """of the marker against its landmark"""
    hip_mm: float = 3.0
    """of a person's hips against the regression"""
    pelvis_depth: float = 0.62
    """from the spines to the sacrum over the width between the spines"""
    pelvis_depth_spread: float = 0.04
    slide_spread: float = 0.3
    """relative spread of the skin's slide between people and markers"""
    swing_hz: float = 9.0
    """resonance of marker and skin"""
    swing_damping: float = 0.25
    white_mm: float = 0.04
    wander_mm: float = 0.08
    wander_time: float = 1.0
    """s"""
    fixed_mm: float = 0.07
    gaps: int = 3
    """mean number of drop-outs a recording"""
    gap_frames: tuple[int, int] = (4, 40)


@dataclass(frozen=True, slots=True)
class Attachment:
    """How this person's markers were put on; the same in all trials."""

    places: FloatArray
    """(m, 3) m in the scaled body frames"""
    slides: FloatArray
    """(m, 3) m per radian"""


def attach(body: Body, params: CameraParams, rng: np.random.Generator) -> Attachment:
    """Puts the markers on a person who stands."""
    places = np.array([marker.place * scale_of(body.subject, marker.body) for marker in MARKERS])
    places[:3] = pelvis_places(body, params, rng)
    places = places + 1e-3 * params.placement_mm * rng.standard_normal(places.shape)
    slides = np.array([marker.slide_mm for marker in MARKERS]) * 1e-3 / (np.pi / 2)
    return Attachment(
        places, slides * (1 + params.slide_spread * rng.standard_normal((len(MARKERS), 1)))
    )


def pelvis_places(body: Body, params: CameraParams, rng: np.random.Generator) -> FloatArray:
    """(3, 3) m in the pelvis: sacrum, right and left spine around this person's hips; forwards as
    gait2392's pelvis markers define it.
    """
    hip = body.model.body("femur_r").pos
    sacrum, right, left = (np.array(marker.place) for marker in MARKERS[:3])
    forward = (right + left) / 2 - sacrum
    forward /= np.linalg.norm(forward)
    up = np.array([-forward[1], forward[0], 0.0])
    width = (hip[2] - 0.0073) / 0.33
    depth = width * params.pelvis_depth * (1 + params.pelvis_depth_spread * rng.standard_normal())
    back, down = np.array(
        [0.24 * depth + 0.0099, 0.30 * width + 0.0109]
    ) + 1e-3 * params.hip_mm * rng.standard_normal(2)
    front = hip * (1, 1, 0) + back * forward + down * up
    side = np.array([0.0, 0.0, width / 2])
    return np.stack([front - depth * forward, front + side, front - side])


def on_skin(
    body: Body, performance: Performance, attachment: Attachment, params: CameraParams
) -> FloatArray:
    """(n, m, 3) world: where the markers really are."""
    standing = body.posture(np.radians(STANDING_DEG))
    poses = body.poses(performance.q)
    markers = np.empty((len(performance.q), len(MARKERS), 3))
    for m, marker in enumerate(MARKERS):
        moved = np.abs(
            performance.q[:, body.index[marker.flexion]] - standing[body.index[marker.flexion]]
        )
        local = attachment.places[m] + moved[:, None] * attachment.slides[m]
        rotation, origin = poses[marker.body][:, :3, :3], poses[marker.body][:, :3, 3]
        markers[:, m] = _swing(np.einsum("nij,nj->ni", rotation, local) + origin, params)
    return markers


def _swing(bone: FloatArray, params: CameraParams) -> FloatArray:
    """The path (n, 3) of a mass on a damped spring whose foot moves along ``bone``: x'' = w^2 (bone
    - x) + 2 z w (bone' - x').
    """
    w, z = 2 * np.pi * params.swing_hz, params.swing_damping
    numerator, denominator = bilinear([2 * z * w, w * w], [1.0, 2 * z * w, w * w], RATE)
    return bone[0] + lfilter(numerator, denominator, bone - bone[0], axis=0)


def recorded(
    skin: FloatArray, params: CameraParams, rng: np.random.Generator
) -> MarkerTrajectories:
    """The markers (n, m, 3) as the cameras report them."""
    n, m, _ = skin.shape
    wander = smooth_noise(rng, n, m * 3, 1 / RATE, params.wander_time).reshape(n, m, 3)
    fixed = rng.standard_normal((1, m, 3))
    white = rng.standard_normal((n, m, 3))
    seen = skin + 1e-3 * (
        params.white_mm * white + params.wander_mm * wander + params.fixed_mm * fixed
    )
    for _ in range(1 + rng.poisson(params.gaps - 1)):
        length, which = rng.integers(*params.gap_frames, endpoint=True), rng.integers(m)
        start = rng.integers(RATE // 4, n - length - RATE // 4)
        seen[start : start + length, which] = np.nan
    return MarkerTrajectories(np.arange(n) / RATE, LABELS, seen)
