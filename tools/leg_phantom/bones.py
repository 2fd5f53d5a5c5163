"""Outer surfaces of the right leg's bones, with the cartilage on them, in segment frames (m; x
forward, y up, z lateral).

Dimensions follow the sources named in models/leg_phantom/README.md. The joint faces are not drawn
but follow from the joint: the condyles are the envelope of the tibial plateau as it moves with the
knee angle, and the trochlear groove is what the patella sweeps.
"""

from functools import cache

import numpy as np

from legsim.phantom.skinning import smooth_step
from tools.leg_phantom.fields import (
    Array,
    Field,
    Outline,
    cone,
    ellipsoid,
    loft,
    rounded_slab,
    smooth_intersection,
    smooth_union,
)
from tools.leg_phantom.motion import femur_from_patella, plateau_contact

PLATEAU = -0.032
"""y in the tibia frame of the cartilage faces of the plateau"""
CONDYLE_CENTER, CONDYLE_HALF_WIDTH = 0.0245, 0.0155
PATELLA_GAP = 0.0004
"""m that stay free between patella and groove, so that meshes of finite fineness do not cross"""

_POSTERIOR_TOP = [
    (-0.0230, -0.391),
    (-0.0172, -0.3825),
    (-0.008, -0.378),
    (0.005, -0.374),
    (0.020, -0.368),
]
_LATERAL_FRONT = [
    (0.032, -0.365),
    (0.0375, -0.377),
    (0.0390, -0.391),
    (0.0370, -0.404),
    (0.0300, -0.416),
    (0.0180, -0.4234),
    (0.005, -0.4267),
]
_MEDIAL_FRONT = [
    (0.031, -0.366),
    (0.0350, -0.377),
    (0.0358, -0.391),
    (0.0335, -0.404),
    (0.0265, -0.416),
    (0.0160, -0.4238),
    (0.005, -0.4267),
]
# the anterior half, from the flange down to the roof of the notch (Blumensaat's line)
_BRIDGE = [
    (0.030, -0.363),
    (0.0355, -0.377),
    (0.0365, -0.391),
    (0.0335, -0.404),
    (0.026, -0.414),
    (0.014, -0.4205),
    (0.006, -0.4205),
    (0.000, -0.4135),
    (-0.010, -0.4015),
    (-0.0205, -0.389),
    (-0.020, -0.378),
    (0.000, -0.366),
]


@cache
def _condyle_outline(front: tuple[tuple[float, float], ...]) -> Outline:
    contact = [tuple(p) for p in plateau_contact(np.radians(np.arange(0.0, 111.0, 5.0)), PLATEAU)]
    return Outline.through([*contact, *_POSTERIOR_TOP, *front])


@cache
def _bridge_outline() -> Outline:
    return Outline.through(_BRIDGE)


def condyles(x: Array, y: Array, z: Array) -> Array:
    """Both condyles up to their cartilage faces, before the groove is cut: what the plateau
    meets.
    """
    narrower = 0.0050 * smooth_step(
        (np.asarray(x) + 0.012) / 0.052
    )  # seen from below, the front is narrower than the back
    behind = smooth_step((0.005 - np.asarray(x)) / 0.025)
    center, half = CONDYLE_CENTER - narrower, CONDYLE_HALF_WIDTH - narrower
    lateral = rounded_slab(
        _condyle_outline(tuple(_LATERAL_FRONT))(x, y),
        np.abs(z - center) - half,
        0.0105 + 0.0035 * behind,
    )
    medial = rounded_slab(
        _condyle_outline(tuple(_MEDIAL_FRONT))(x, y),
        np.abs(z + center) - half,
        0.0105 + 0.0035 * behind,
    )
    return np.minimum(lateral, medial)


def femur_uncut(x: Array, y: Array, z: Array) -> Array:
    """Femur with cartilage, trochlea not yet grooved."""
    bridge = rounded_slab(_bridge_outline()(x, y), np.abs(z) - 0.026, 0.006)
    distal = smooth_union(condyles(x, y, z), bridge, 0.004)
    for bump in (
        ellipsoid((-0.007, -0.391, -0.0385), (0.013, 0.014, 0.0065)),
        ellipsoid((-0.008, -0.393, 0.0385), (0.012, 0.012, 0.006)),
    ):
        distal = smooth_union(distal, bump(x, y, z), 0.004)
    return smooth_union(distal, proximal_femur(x, y, z), 0.006)


@cache
def _femur_shaft() -> Field:
    return loft(
        [
            (-0.018, -0.009, 0.049, 0.012, 0.013),
            (-0.035, -0.009, 0.047, 0.015, 0.0165),
            (-0.060, -0.008, 0.044, 0.0160, 0.0165),
            (-0.090, -0.004, 0.0405, 0.0145, 0.0148),
            (-0.140, 0.002, 0.035, 0.0138, 0.0138),
            (-0.200, 0.006, 0.027, 0.0136, 0.0136),
            (-0.260, 0.0065, 0.019, 0.0142, 0.0140),
            (-0.300, 0.0065, 0.0135, 0.0152, 0.0158),
            (-0.330, 0.0075, 0.009, 0.0180, 0.0205),
            (-0.350, 0.0080, 0.006, 0.0215, 0.0270),
            (-0.370, 0.0065, 0.003, 0.0250, 0.0330),
            (-0.383, 0.0040, 0.001, 0.0255, 0.0360),
            (-0.392, 0.0020, 0.000, 0.0230, 0.0340),
        ]
    )


def proximal_femur(x: Array, y: Array, z: Array) -> Array:
    """Head, neck, trochanters and shaft down to the metaphysis."""
    head = ellipsoid((0, 0, 0), (0.0235, 0.0235, 0.0235))(x, y, z)
    neck = cone((-0.001, -0.004, 0.006), (-0.009, -0.034, 0.044), 0.0155, 0.0175)(x, y, z)
    body = smooth_union(_femur_shaft()(x, y, z), neck, 0.012)
    body = smooth_union(
        body, ellipsoid((-0.014, -0.008, 0.058), (0.019, 0.026, 0.015))(x, y, z), 0.012
    )
    body = smooth_union(
        body, ellipsoid((-0.021, -0.066, 0.031), (0.010, 0.014, 0.010))(x, y, z), 0.010
    )
    # the rough line along the back of the shaft
    body = smooth_union(
        body, cone((-0.014, -0.10, 0.039), (-0.006, -0.26, 0.019), 0.004, 0.004)(x, y, z), 0.008
    )
    return smooth_union(body, head, 0.006)


@cache
def _patella_outline() -> Outline:
    return Outline.through(
        [
            (0.000, -0.001),
            (0.009, 0.004),
            (0.0175, 0.014),
            (0.0220, 0.027),
            (0.0185, 0.0375),
            (0.009, 0.0430),
            (-0.001, 0.0437),
            (-0.011, 0.0420),
            (-0.0195, 0.0365),
            (-0.0215, 0.027),
            (-0.0165, 0.014),
            (-0.009, 0.004),
        ]
    )


def patella_articular(y: Array, z: Array) -> Array:
    """1 where the back of the patella carries cartilage, falling to 0 toward its rim and its lower
    pole.
    """
    rim = smooth_step((-_patella_outline()(z, y) - 0.0015) / 0.003)
    return rim * smooth_step((np.asarray(y) - 0.0095) / 0.005)


def patella_back(y: Array, z: Array) -> Array:
    """x (patella frame) of the posterior cartilage face: a ridge between a wide lateral and a
    steeper medial facet.
    """
    facets = np.where(z > 0, 0.34, 0.42) * (np.sqrt(z**2 + 0.002**2) - 0.002)
    return (
        -0.0100
        + facets
        + 9.0 * (y - 0.026) ** 2
        + 0.006 * smooth_step((0.012 - np.asarray(y)) / 0.010)
    )


def patella(x: Array, y: Array, z: Array) -> Array:
    """Patella with its cartilage."""
    front = x - (0.0128 - 9.0 * z**2 - 9.0 * (y - 0.025) ** 2)
    back = (patella_back(y, z) - x) / 1.06
    return smooth_intersection(
        rounded_slab(np.asarray(_patella_outline()(z, y)), np.asarray(front), 0.005),
        np.asarray(back),
        0.002,
    )


def patella_bone(x: Array, y: Array, z: Array) -> Array:
    """Patella without its cartilage, which is up to 3 mm thick."""
    front = x - (0.0128 - 9.0 * z**2 - 9.0 * (y - 0.025) ** 2)
    back = (patella_back(y, z) + 0.0030 * patella_articular(y, z) - x) / 1.06
    return smooth_intersection(
        rounded_slab(np.asarray(_patella_outline()(z, y)), np.asarray(front), 0.005),
        np.asarray(back),
        0.002,
    )


def swept_by_patella(x: Array, y: Array, z: Array) -> Array:
    """Least distance to the patella over all knee angles, in the femur frame: negative where it
    ever is.
    """
    nearest = np.full(np.broadcast_shapes(x.shape, y.shape, z.shape), np.inf)
    for matrix in femur_from_patella(np.radians(np.arange(0.0, 116.0, 4.0))):
        dx, dy = x - matrix[0, 3], y - matrix[1, 3]
        px, py = matrix[0, 0] * dx + matrix[1, 0] * dy, matrix[0, 1] * dx + matrix[1, 1] * dy
        np.minimum(nearest, patella(px, py, z - matrix[2, 3]), out=nearest)
    return nearest


def femur(x: Array, y: Array, z: Array) -> Array:
    """Femur with its cartilage."""
    return smooth_intersection(
        femur_uncut(x, y, z), PATELLA_GAP - swept_by_patella(x, y, z), 0.0015
    )


def femur_cartilage_thickness(x: Array, y: Array, z: Array) -> Array:
    """m of cartilage at a place of the femur's face: condyles and trochlea, tapering to their
    borders, also to the negative.
    """
    around = np.arctan2(
        np.asarray(x) + 0.0045, -(np.asarray(y) + 0.3958)
    )  # 0 down, positive forward
    behind = smooth_step((np.radians(122) + around) / np.radians(20))
    above = smooth_step((np.radians(114) - around) / np.radians(16))
    near = smooth_step((0.046 - np.hypot(x + 0.004, y + 0.3958)) / 0.003)
    beside_notch = smooth_step((np.abs(z) - 0.0085) / 0.006)
    trochlea = smooth_step((around - np.radians(8)) / np.radians(24))
    outer = smooth_step((0.0385 - 0.004 * trochlea - np.abs(z)) / 0.007)
    return (
        0.0026 * behind * above * near * (beside_notch + trochlea - beside_notch * trochlea) * outer
        - 0.0003
    )


@cache
def _tibia_shaft() -> Field:
    return loft(
        [
            (-0.042, -0.005, 0.000, 0.0205, 0.0330),
            (-0.048, -0.0045, 0.000, 0.0240, 0.0345),
            (-0.056, -0.0035, -0.0005, 0.0245, 0.0328),
            (-0.070, -0.001, -0.001, 0.0232, 0.0280, 0.03),
            (-0.090, 0.001, -0.002, 0.0202, 0.0215, 0.08),
            (-0.120, 0.002, -0.003, 0.0170, 0.0162, 0.12),
            (-0.180, 0.002, -0.004, 0.0142, 0.0128, 0.14),
            (-0.260, 0.001, -0.003, 0.0125, 0.0115, 0.12),
            (-0.330, 0.000, -0.002, 0.0125, 0.0118, 0.06),
            (-0.380, -0.001, 0.000, 0.0145, 0.0150),
            (-0.408, -0.001, -0.001, 0.0175, 0.0200),
            (-0.4215, -0.001, -0.001, 0.0180, 0.0210),
        ]
    )


@cache
def plateau_outline() -> Outline:
    """Rim of the tibial plateau seen from above, (x, z): the medial side deeper, a notch behind."""
    return Outline.through(
        [
            (0.0195, 0.000),
            (0.0195, 0.012),
            (0.0140, 0.026),
            (0.0020, 0.0355),
            (-0.0120, 0.0345),
            (-0.0240, 0.0240),
            (-0.0265, 0.0130),
            (-0.0215, 0.0010),
            (-0.0275, -0.0110),
            (-0.0300, -0.0220),
            (-0.0200, -0.0345),
            (-0.0040, -0.0375),
            (0.0120, -0.0310),
            (0.0195, -0.0150),
        ]
    )


def tibia_bone(x: Array, y: Array, z: Array) -> Array:
    """Tibia without cartilage, before it is cleared of the path of the condyles."""
    head = rounded_slab(np.asarray(plateau_outline()(x, z)), np.abs(y + 0.0415) - 0.0070, 0.0030)
    body = smooth_union(_tibia_shaft()(x, y, z), head, 0.008)
    body = smooth_union(
        body, ellipsoid((0.0215, -0.066, 0.003), (0.0095, 0.018, 0.011))(x, y, z), 0.010
    )
    for spine in (
        ellipsoid((-0.004, -0.0345, -0.0055), (0.009, 0.0095, 0.0036)),
        ellipsoid((-0.006, -0.0345, 0.0055), (0.008, 0.0080, 0.0036)),
    ):
        body = smooth_union(body, spine(x, y, z), 0.003)
    malleolus = ellipsoid((0.001, -0.434, -0.0235), (0.0125, 0.0165, 0.0065))(x, y, z)
    return smooth_union(body, malleolus, 0.008)


@cache
def _fibula_shaft() -> Field:
    return loft(
        [
            (-0.052, -0.021, 0.0355, 0.0075, 0.0070),
            (-0.068, -0.022, 0.0360, 0.0058, 0.0055),
            (-0.100, -0.021, 0.0340, 0.0060, 0.0058, 0.08),
            (-0.200, -0.018, 0.0300, 0.0068, 0.0062, 0.12),
            (-0.300, -0.014, 0.0275, 0.0064, 0.0060, 0.10),
            (-0.380, -0.0105, 0.0275, 0.0070, 0.0062),
            (-0.415, -0.008, 0.0290, 0.0095, 0.0065),
            (-0.440, -0.008, 0.0300, 0.0085, 0.0060),
        ]
    )


def fibula(x: Array, y: Array, z: Array) -> Array:
    """Fibula with head, neck and lateral malleolus, in the tibia frame."""
    head = ellipsoid((-0.0205, -0.049, 0.0335), (0.0105, 0.0125, 0.0090))(x, y, z)
    malleolus = ellipsoid((-0.008, -0.436, 0.0300), (0.0115, 0.0185, 0.0072))(x, y, z)
    return smooth_union(smooth_union(_fibula_shaft()(x, y, z), head, 0.006), malleolus, 0.006)


def talus(x: Array, y: Array, z: Array) -> Array:
    """Talus in its frame: trochlea under the ankle joint, neck and head."""
    body = ellipsoid((-0.002, -0.010, 0.001), (0.022, 0.0165, 0.0165))(x, y, z)
    return smooth_union(
        body, cone((0.008, -0.014, -0.002), (0.032, -0.021, -0.008), 0.013, 0.012)(x, y, z), 0.008
    )


def calcaneus(x: Array, y: Array, z: Array) -> Array:
    """Heel bone in the frame of calcn."""
    body = cone((0.006, 0.014, -0.003), (0.052, 0.016, -0.004), 0.0165, 0.0135)(x, y, z)
    body = smooth_union(
        body, cone((0.052, 0.014, -0.003), (0.074, 0.014, 0.002), 0.0125, 0.0105)(x, y, z), 0.006
    )
    return smooth_union(
        body, ellipsoid((0.004, 0.008, -0.003), (0.014, 0.016, 0.015))(x, y, z), 0.008
    )


def midfoot(x: Array, y: Array, z: Array) -> Array:
    """Tarsal bones and metatarsals in the frame of calcn, in one piece: enough to shade the
    foot.
    """
    inner = cone((0.092, 0.003, -0.014), (0.170, -0.012, -0.024), 0.010, 0.007)(x, y, z)
    middle = cone((0.088, 0.007, -0.004), (0.172, -0.012, -0.004), 0.011, 0.006)(x, y, z)
    outer = cone((0.084, 0.004, 0.010), (0.155, -0.013, 0.022), 0.010, 0.006)(x, y, z)
    return smooth_union(smooth_union(inner, middle, 0.006), outer, 0.006)
