"""A user's OpenSim model in a person's size, as the text of an .osim file that OpenSim opens to the
same joint centers.

The user's file is kept, with its names and credits; joints, mass properties, markers and meshes are
scaled as OpenSim scales them. What belongs to muscles and contacts is left out: their lengths and
forces need OpenSim's own scale tool, to which :func:`scale_set` gives the factors.
"""

from collections.abc import Mapping
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from legsim.core.values import FloatArray
from legsim.kinematics import osim_file, osim_xml
from legsim.kinematics._leg_scaling import scaled_inertia
from legsim.kinematics.osim_file import Joint, OsimMarker, OsimModel

_LEFT_OUT = ("ForceSet", "ControllerSet", "ProbeSet", "ContactGeometrySet", "WrapObjectSet")

_SOCKETS = 30501
"""version since which a marker's body is a socket"""

_COUPLER = "CoordinateCouplerConstraint"

_PRODUCTS = (("xy", 0, 1), ("xz", 0, 2), ("yz", 1, 2))


def text(model: OsimModel) -> str:
    """The file of a model that was scaled since it was read, with the markers where it has them.

    Raises:
        LegsimError: the file cannot be read any more.
    """
    root, factors = osim_xml.document(model.path), model.factors
    element = root.find("Model")
    assert element is not None
    for tag in _LEFT_OUT:
        for found in element.iter(tag):
            found[:] = [SubElement(Element("empty"), "objects")]
    for constraints in element.findall("ConstraintSet/objects"):
        constraints[:] = [c for c in constraints if c.tag == _COUPLER]
    joints = {joint.name: joint for joint in model.joints}
    for found in (
        *element.findall("JointSet/objects/*"),
        *element.findall("BodySet/objects/Body/Joint/*"),
    ):
        joint = joints[found.get("name", "")]
        _put_joint(found, joint, factors.get(joint.parent, np.ones(3)))
    for body in element.findall("BodySet/objects/Body"):
        if body.get("name") in factors:
            _scale_body(body, factors[body.get("name", "")])
    _put_markers(element, model)
    return '<?xml version="1.0" encoding="UTF-8" ?>\n' + ElementTree.tostring(root, "unicode")


def scale_set(factors: Mapping[str, FloatArray]) -> str:
    """The factors as OpenSim's ScaleSet (.xml), for its scale tool and for ``--scale-file``."""
    scales = "".join(
        f"<Scale><scales>{_row(f)}</scales><segment>{name}</segment><apply>true</apply></Scale>\n"
        for name, f in factors.items()
    )
    return (
        '<?xml version="1.0" encoding="UTF-8" ?>\n<OpenSimDocument Version="40000">\n'
        f'<ScaleSet name="person"><objects>\n{scales}</objects><groups /></ScaleSet>\n'
        "</OpenSimDocument>\n"
    )


def _put_joint(element: Element, joint: Joint, parent: FloatArray) -> None:
    ends = (
        ("parent", joint.parent, joint.parent_from_p),
        ("child", joint.child, joint.child_from_c),
    )
    if element.find("parent_body") is None:
        for old in element.findall("frames"):
            element.remove(old)
        frames = SubElement(element, "frames")
        for end, body, at in ends:
            frame = SubElement(frames, "PhysicalOffsetFrame", {"name": f"scaled_{end}"})
            _set(frame, "socket_parent", "/ground" if body == "ground" else f"/bodyset/{body}")
            _place(frame, "translation", "orientation", at)
            _connect(element, f"{end}_frame", f"scaled_{end}")
    else:
        _place(element, "location_in_parent", "orientation_in_parent", joint.parent_from_p)
        own = "_in_child" if element.find("location_in_child") is not None else ""
        _place(element, f"location{own}", f"orientation{own}", joint.child_from_c)
    for axis in (*element.findall("SpatialTransform/TransformAxis"),
                 *element.findall("TransformAxisSet/objects/TransformAxis")):  # fmt: skip
        if not osim_xml.flag(axis, "is_rotation") and not axis.get("name", "").startswith(
            "rotation"
        ):
            _stretch(axis, parent)


def _connect(joint: Element, socket: str, frame: str) -> None:
    """Connects a joint's end to a frame of its own, in OpenSim 4's way and its previews'."""
    for connector in joint.findall("connectors/*"):
        if connector.get("name") == socket:
            _set(connector, "connectee_name", frame)
            return
    old = joint.find(f"socket_{socket}_connectee_name")
    _set(joint, f"socket_{socket}" if old is None else f"socket_{socket}_connectee_name", frame)


def _stretch(axis: Element, factors: FloatArray) -> None:
    """Multiplies a translation that is no free coordinate by the parent's factors along it."""
    holder = axis.find("function")
    holder = axis if holder is None else holder
    inner = next((e for e in holder if e.tag not in osim_file.AXIS_TAGS), None)
    if inner is None or osim_file.is_free(inner):
        return
    direction = np.array([float(word) for word in (axis.findtext("axis") or "").split()])
    length = float(np.linalg.norm(direction))
    if length == 0:
        return
    by = float(np.abs(direction / length) @ factors)
    multiplier = Element("MultiplierFunction", {"name": inner.get("name", "function")})
    SubElement(multiplier, "function").append(inner)
    _set(multiplier, "scale", repr(by))
    holder[list(holder).index(inner)] = multiplier


def _scale_body(body: Element, factors: FloatArray) -> None:
    mass = float(body.findtext("mass") or 0.0)
    center = _numbers(body, "mass_center", 3) * factors
    bulk = float(np.prod(factors))
    _set(body, "mass", repr(mass * bulk))
    _set(body, "mass_center", _row(center))
    old = body.find("inertia_xx") is not None
    if old:
        moments = np.array([float(body.findtext(f"inertia_{a}") or 0.0) for a in _names()])
    else:
        moments = _numbers(body, "inertia", 6)
    if mass > 0:
        moments[:3] = scaled_inertia(mass, moments[:3], factors) * bulk
        moments[3:] *= [bulk * factors[a] * factors[b] for _, a, b in _PRODUCTS]
    if old:
        for name, value in zip(_names(), moments, strict=True):
            _set(body, f"inertia_{name}", repr(float(value)))
    else:
        _set(body, "inertia", _row(moments))
    for mesh in (*body.iter("Mesh"), *body.findall("VisibleObject")):
        size = _numbers(mesh, "scale_factors", 3, missing=1.0)
        _set(mesh, "scale_factors", _row(size * factors))
    for frame in body.findall("components/PhysicalOffsetFrame"):
        _set(frame, "translation", _row(_numbers(frame, "translation", 3) * factors))


def _put_markers(element: Element, model: OsimModel) -> None:
    """Moves the file's markers to where the model has them, and adds those of a marker set."""
    markers = {marker.name: marker for marker in model.markers}
    there = set()
    holder = element.find("MarkerSet/objects")
    if holder is None:
        old = element.find("MarkerSet")
        holder = SubElement(SubElement(element, "MarkerSet") if old is None else old, "objects")
    for found in holder.findall("Marker"):
        name = found.get("name", "")
        if name in markers:  # also the second of one name
            _put_marker(found, markers[name])
            there.add(name)
    for name, marker in markers.items():
        if name in there:
            continue
        added = SubElement(holder, "Marker", {"name": name})
        if model.version < _SOCKETS:
            SubElement(added, "body")
        _put_marker(added, marker)


def _put_marker(element: Element, marker: OsimMarker) -> None:
    if element.find("body") is not None:
        _set(element, "body", marker.body)
    else:
        on = "/ground" if marker.body == "ground" else f"/bodyset/{marker.body}"
        connectors = element.findall("connectors/*")
        for connector in connectors:
            if connector.get("name") == "parent_frame":
                _set(connector, "connectee_name", marker.body)
        if not connectors:
            old = element.find("socket_parent_frame_connectee_name")
            _set(element, "socket_parent_frame" + ("" if old is None else "_connectee_name"), on)
    _set(element, "location", _row(marker.location))


def _place(element: Element, location: str, orientation: str, at: FloatArray) -> None:
    r = at[:3, :3]
    middle = float(np.arcsin(np.clip(r[0, 2], -1.0, 1.0)))
    angles = [float(np.arctan2(-r[1, 2], r[2, 2])), middle, float(np.arctan2(-r[0, 1], r[0, 0]))]
    _set(element, location, _row(at[:3, 3]))
    _set(element, orientation, _row(angles))


def _names() -> tuple[str, ...]:
    return "xx", "yy", "zz", *(name for name, _, _ in _PRODUCTS)


def _numbers(element: Element, tag: str, count: int, *, missing: float = 0.0) -> FloatArray:
    words = (element.findtext(tag) or "").split()
    return np.array([float(w) for w in words]) if words else np.full(count, missing)


def _set(element: Element, tag: str, value: str) -> None:
    child = element.find(tag)
    child = SubElement(element, tag) if child is None else child
    child.text = value


def _row(values: FloatArray | list[float]) -> str:
    return " ".join(repr(float(v)) for v in values)
