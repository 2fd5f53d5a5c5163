"""Small OpenSim models as text, in the formats of OpenSim 4, 3 and 1."""

from dataclasses import dataclass, field
from pathlib import Path


@dataclass(frozen=True)
class J:
    """A joint: coordinates by name with (default, low, high, clamped, locked), axes of a
    CustomJoint as (name, coordinate, direction, function as XML).
    """

    name: str
    kind: str
    parent: str
    child: str
    at: str = "0 0 0"
    turned: str = "0 0 0"
    child_at: str = "0 0 0"
    child_turned: str = "0 0 0"
    coordinates: dict = field(default_factory=dict)
    axes: tuple = ()


LINEAR = "<LinearFunction name='function'><coefficients>1 0</coefficients></LinearFunction>"
FREE = (0.0, -10.0, 10.0, False, False)
PLACES = {
    "pelvis": ("0 0.02 0.12", "0 0.02 -0.12", "-0.16 0.03 0.04", "-0.15 0.02 -0.05"),
    "femur_r": ("0.05 -0.15 0.06", "0.02 -0.25 0.07", "0 -0.4 0.05"),
    "tibia_r": ("0.03 -0.1 0.04", "0 -0.2 0.05", "0 -0.39 0.05"),
    "talus_r": ("0.15 -0.03 0.03", "-0.05 -0.04 0", "0.1 -0.03 -0.04"),
}
PLACES |= {
    f"{body[:-1]}l": tuple(" ".join([*p.split()[:2], f"{-float(p.split()[2])}"]) for p in places)
    for body, places in PLACES.items()
    if body.endswith("_r")
}
MARKERS = "".join(
    f"<Marker name='{body}_M{k}'><socket_parent_frame>/bodyset/{body}</socket_parent_frame>"
    f"<location>{place}</location></Marker>"
    for body, places in PLACES.items()
    for k, place in enumerate(places)
)
"""Three to four on each body of two_legs()"""


def pelvis(kind="CustomJoint") -> J:
    names = [f"pelvis_{n}" for n in ("tilt", "list", "rotation", "tx", "ty", "tz")]
    directions = ("0 0 1", "1 0 0", "0 1 0", "1 0 0", "0 1 0", "0 0 1")
    slots = ("rotation1", "rotation2", "rotation3", "translation1", "translation2", "translation3")
    axes = tuple((s, n, d, LINEAR) for s, n, d in zip(slots, names, directions, strict=True))
    values = {n: (0.95 if n == "pelvis_ty" else 0.0, -10.0, 10.0, False, False) for n in names}
    return J("ground_pelvis", kind, "ground", "pelvis", coordinates=values, axes=axes)


def leg(side: str, *, hip: str = "BallJoint", foot: str = "talus") -> list[J]:
    z = 0.08 if side == "r" else -0.08
    hips = {f"hip_{n}_{side}": FREE for n in ("a", "b", "c")[: 3 if hip != "PinJoint" else 1]}
    return [
        J(f"hip_{side}", hip, "pelvis", f"femur_{side}", f"-0.07 -0.07 {z}", coordinates=hips),
        J(f"knee_{side}", "PinJoint", f"femur_{side}", f"tibia_{side}", "0 -0.41 0",
          coordinates={f"knee_angle_{side}": (0.0, -2.0, 0.2, True, False)}),
        J(f"ankle_{side}", "UniversalJoint", f"tibia_{side}", f"{foot}_{side}", "0 -0.4 0",
          coordinates={f"ankle_x_{side}": FREE, f"ankle_y_{side}": FREE}),
    ]  # fmt: skip


def two_legs(**options) -> list[J]:
    return [pelvis(), *leg("r", **options), *leg("l", **options)]


def _coordinate(name: str, entry: tuple) -> str:
    default, low, high, clamped, locked = entry
    return (
        f"<Coordinate name='{name}'><default_value>{default}</default_value>"
        f"<range>{low} {high}</range><clamped>{str(clamped).lower()}</clamped>"
        f"<locked>{str(locked).lower()}</locked><prescribed>false</prescribed></Coordinate>"
    )


def _spatial(joint: J) -> str:
    return "<SpatialTransform>" + "".join(
        f"<TransformAxis name='{slot}'><coordinates>{name}</coordinates><axis>{axis}</axis>"
        f"{function}</TransformAxis>"
        for slot, name, axis, function in joint.axes
    ) + "</SpatialTransform>"  # fmt: skip


def _set(tag: str, items: str) -> str:
    return f"<{tag}><objects>{items}</objects><groups/></{tag}>"


def version_4(joints: list[J], *, markers: str = "", constraints: str = "") -> str:
    bodies = "".join(f"<Body name='{j.child}'><mass>1</mass></Body>" for j in joints)
    parts = []
    for j in joints:
        at = "/ground" if j.parent == "ground" else f"/bodyset/{j.parent}"
        coordinates = "".join(_coordinate(n, e) for n, e in j.coordinates.items())
        parts.append(
            f"<{j.kind} name='{j.name}'><socket_parent_frame>p_offset</socket_parent_frame>"
            "<socket_child_frame>c_offset</socket_child_frame>"
            f"<coordinates>{coordinates}</coordinates><frames>"
            f"<PhysicalOffsetFrame name='p_offset'><socket_parent>{at}</socket_parent>"
            f"<translation>{j.at}</translation><orientation>{j.turned}</orientation>"
            "</PhysicalOffsetFrame>"
            f"<PhysicalOffsetFrame name='c_offset'><socket_parent>/bodyset/{j.child}"
            f"</socket_parent><translation>{j.child_at}</translation><orientation>"
            f"{j.child_turned}</orientation></PhysicalOffsetFrame></frames>"
            f"{_spatial(j) if j.axes and j.kind == 'CustomJoint' else ''}</{j.kind}>"
        )
    return (
        "<?xml version='1.0'?><OpenSimDocument Version='40000'><Model name='small'>"
        + _set("BodySet", bodies)
        + _set("JointSet", "".join(parts))
        + _set("ConstraintSet", constraints)
        + _set("MarkerSet", markers)
        + "</Model></OpenSimDocument>"
    )


def version_3(joints: list[J], *, markers: str = "", constraints: str = "") -> str:
    bodies = "<Body name='ground'><mass>0</mass><Joint/></Body>"
    for j in joints:
        coordinates = "".join(_coordinate(n, e) for n, e in j.coordinates.items())
        bodies += (
            f"<Body name='{j.child}'><mass>1</mass><Joint><{j.kind} name='{j.name}'>"
            f"<parent_body>{j.parent}</parent_body><location_in_parent>{j.at}</location_in_parent>"
            f"<orientation_in_parent>{j.turned}</orientation_in_parent>"
            f"<location>{j.child_at}</location><orientation>{j.child_turned}</orientation>"
            f"{_set('CoordinateSet', coordinates)}<reverse>false</reverse>"
            f"{_spatial(j) if j.axes and j.kind == 'CustomJoint' else ''}</{j.kind}></Joint></Body>"
        )
    return (
        "<?xml version='1.0'?><OpenSimDocument Version='20303'><Model name='small'>"
        + _set("BodySet", bodies)
        + _set("ConstraintSet", constraints)
        + _set("MarkerSet", markers)
        + "</Model></OpenSimDocument>"
    )


def saved(folder: Path, text: str, name: str = "small.osim") -> Path:
    path = folder / name
    path.write_text(text)
    return path
