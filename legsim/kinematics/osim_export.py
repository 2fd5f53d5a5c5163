"""Legsim's own leg, as it was scaled, as an OpenSim model: it opens there to the same joint
centers.

The knee's and the patella's dependent joints become SimmSplines, as in gait2392 and Rajagopal2016,
where they come from; the patella follows the knee by a CoordinateCouplerConstraint.
"""

import re
from collections.abc import Mapping, Sequence
from xml.sax.saxutils import quoteattr

import numpy as np

from legsim.core.constants import GRAVITY_WORLD
from legsim.core.values import FloatArray
from legsim.kinematics.leg_model import LegBody, LegJoint, LegModel
from legsim.kinematics.marker_sites import MarkerSites
from legsim.mocap.labels import same_label

_ILLEGAL = r"[\\*+\s/]"
"""what OpenSim does not take in a marker's name"""

_HEAD = """<?xml version="1.0" encoding="UTF-8" ?>
<OpenSimDocument Version="40000">
<Model name={name}>
<credits>legsim's leg: gait2392 below the waist (S. Delp, P. Loan, M. Hoy, F. Zajac, E. Topp,
J. Rosen, D. Thelen, F. Anderson, A. Seth; CC BY 3.0), patella after Rajagopal2016.</credits>
<length_units>meters</length_units>
<force_units>N</force_units>
<gravity>{gravity}</gravity>
"""


def text(
    leg: LegModel,
    sites: MarkerSites | None,
    *,
    name: str,
    labels: Mapping[str, str] | None = None,
) -> str:
    """The model as the text of an .osim file, with the markers at ``sites``.

    Each bears the name of its site, and once more the recording's own label in ``labels``, so that
    the recording can be solved on the model.
    """
    bodies = leg.bodies()
    sections = (
        ("BodySet", [_body(body) for body in bodies]),
        ("JointSet", [_joint(body) for body in bodies]),
        ("ConstraintSet", [_coupler(body.name[-1]) for body in bodies if _follows(body)]),
        ("MarkerSet", [] if sites is None else _markers(sites, labels or {})),
    )
    written = "".join(
        f'<{tag} name="{tag.lower()}"><objects>\n{"".join(items)}</objects><groups /></{tag}>\n'
        for tag, items in sections
    )
    # what OpenSim takes in a name
    named = re.sub(r"[^\w.-]", "_", name)
    head = _HEAD.format(name=quoteattr(named), gravity=_row(GRAVITY_WORLD))
    return f"{head}{written}</Model>\n</OpenSimDocument>\n"


def _follows(body: LegBody) -> bool:
    """Whether all of a body's joints follow the knee: a patella's."""
    return bool(body.joints) and all(joint.spline is not None for joint in body.joints)


def _body(body: LegBody) -> str:
    return (
        f'<Body name="{body.name}"><mass>{body.mass!r}</mass>'
        f"<mass_center>{_row(body.mass_center)}</mass_center>"
        f"<inertia>{_row([*body.inertia, 0.0, 0.0, 0.0])}</inertia></Body>\n"
    )


def _joint(body: LegBody) -> str:
    kind = "CustomJoint" if body.joints else "WeldJoint"
    parent = "/ground" if body.parent == "world" else f"/bodyset/{body.parent}"
    name = f"{body.parent if body.parent != 'world' else 'ground'}_{body.name}"
    return (
        f'<{kind} name="{name}">\n'
        "<socket_parent_frame>parent_offset</socket_parent_frame>"
        "<socket_child_frame>child_offset</socket_child_frame>\n"
        f"{_coordinates(body)}<frames>"
        f"{_frame('parent_offset', parent, body.offset)}"
        f"{_frame('child_offset', f'/bodyset/{body.name}', np.zeros(3))}</frames>\n"
        f"{_spatial(body) if body.joints else ''}</{kind}>\n"
    )


def _frame(name: str, parent: str, at: FloatArray) -> str:
    return (
        f'<PhysicalOffsetFrame name="{name}"><socket_parent>{parent}</socket_parent>'
        f"<translation>{_row(at)}</translation><orientation>0 0 0</orientation>"
        "</PhysicalOffsetFrame>"
    )


def _coordinates(body: LegBody) -> str:
    # gait2392's order: turns before shifts
    free = sorted((j for j in body.joints if j.spline is None), key=lambda j: j.slides)
    lines = [
        _coordinate(j.name, j.default, j.low, j.high, clamped=body.parent != "world") for j in free
    ]
    if _follows(body):
        lines = [_coordinate(_beta(body.name[-1]), 0.0, -10.0, 10.0, clamped=False)]
    return f"<coordinates>\n{''.join(lines)}</coordinates>\n" if lines else ""


def _coordinate(name: str, default: float, low: float, high: float, *, clamped: bool) -> str:
    return (
        f'<Coordinate name="{name}"><default_value>{default!r}</default_value>'
        f"<range>{_row([low, high])}</range><clamped>{str(clamped).lower()}</clamped>"
        "<locked>false</locked></Coordinate>\n"
    )


def _spatial(body: LegBody) -> str:
    side = body.name[-1]
    followed = _beta(side) if _follows(body) else f"knee_angle_{side}"
    turns = _filled([j for j in body.joints if not j.slides])
    shifts = _along_axes([j for j in body.joints if j.slides])
    lines = [
        _axis(f"{kind}{k + 1}", axis, joint, followed)
        for kind, axes in (("rotation", turns), ("translation", shifts))
        for k, (axis, joint) in enumerate(axes)
    ]
    return f"<SpatialTransform>\n{''.join(lines)}</SpatialTransform>\n"


def _filled(joints: Sequence[LegJoint]) -> list[tuple[FloatArray, LegJoint | None]]:
    """Three axes that span space: those of the joints, then such as stay at zero."""
    axes: list[tuple[FloatArray, LegJoint | None]] = [(joint.axis, joint) for joint in joints]
    while len(axes) < 3:
        spanned = np.array([axis for axis, _ in axes]).reshape(-1, 3)
        free = np.linalg.svd(spanned)[2][len(spanned)] if len(spanned) else np.eye(3)[2]
        axes.append((free, None))
    return axes


def _along_axes(joints: Sequence[LegJoint]) -> list[tuple[FloatArray, LegJoint | None]]:
    """x, y and z with the joints that slide along them."""
    by_axis = {int(np.abs(joint.axis).argmax()): joint for joint in joints}
    return [(by_axis[k].axis if k in by_axis else np.eye(3)[k], by_axis.get(k)) for k in range(3)]


def _axis(slot: str, axis: FloatArray, joint: LegJoint | None, followed: str) -> str:
    name, function = "", '<Constant name="function"><value>0</value></Constant>'
    if joint is not None and joint.spline is None:
        name = joint.name
        function = (
            '<LinearFunction name="function"><coefficients>1 0</coefficients></LinearFunction>'
        )
    elif joint is not None and joint.spline is not None:
        name = followed
        function = (
            f'<SimmSpline name="function"><x>{_row(joint.spline.x)}</x>'
            f"<y>{_row(joint.spline.y)}</y></SimmSpline>"
        )
    return (
        f'<TransformAxis name="{slot}"><coordinates>{name}</coordinates>'
        f"<axis>{_row(axis)}</axis>{function}</TransformAxis>\n"
    )


def _coupler(side: str) -> str:
    return (
        f'<CoordinateCouplerConstraint name="patella_{side}"><isEnforced>true</isEnforced>'
        "<coupled_coordinates_function><LinearFunction><coefficients>1 0</coefficients>"
        "</LinearFunction></coupled_coordinates_function>"
        f"<independent_coordinate_names>knee_angle_{side}</independent_coordinate_names>"
        f"<dependent_coordinate_name>{_beta(side)}</dependent_coordinate_name>"
        "<scale_factor>1</scale_factor></CoordinateCouplerConstraint>\n"
    )


def _beta(side: str) -> str:
    """Rajagopal2016's name of the patella's coordinate."""
    return f"knee_angle_{side}_beta"


def _markers(sites: MarkerSites, labels: Mapping[str, str]) -> list[str]:
    shown = {role: re.sub(_ILLEGAL, "_", label) for role, label in labels.items()}
    # two labels of one spelling would be two places of one name
    spelled = list(shown.values())
    shown = {role: label for role, label in shown.items() if spelled.count(label) == 1}
    written = []
    for name, segment, place in zip(sites.names, sites.segments, sites.positions, strict=True):
        # a role that reads like some label would be taken for it
        own = [] if any(same_label(name, label) for label in shown.values()) else [name]
        written += [
            f"<Marker name={quoteattr(each)}>"
            f"<socket_parent_frame>/bodyset/{segment}</socket_parent_frame>"
            f"<location>{_row(place)}</location><fixed>false</fixed></Marker>\n"
            for each in [*([shown[name]] if name in shown else []), *own]
        ]
    return written


def _row(values: Sequence[float] | FloatArray) -> str:
    return " ".join(repr(float(v)) for v in values)
