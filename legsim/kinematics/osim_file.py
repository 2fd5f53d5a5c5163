"""OpenSim models (.osim) as values: bodies, joints, coordinates, couplers and markers.

Reads the format of OpenSim 4 (joints in a JointSet, frames by sockets), of 3 (a joint inside its
child body) and of 1 and 2 (a TransformAxisSet). What legsim does not support is kept with the
reason, and refused by whoever needs it: an unknown joint of an arm does not matter to the legs.

Conventions of the format: a joint has a frame P fixed in its parent body and C fixed in its child,
each by a translation and body-fixed x-y-z angles; C in P has the rotation R(a1, f1) R(a2, f2)
R(a3, f3) and the translation f4 a4 + f5 a5 + f6 a6 along P's axes, axes of unit length (OpenSim's
API documentation, Joint and SpatialTransform).
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from legsim.core import transforms
from legsim.core.errors import LegsimError, file_error
from legsim.core.values import FloatArray, frozen
from legsim.kinematics import _osim_frames, osim_xml
from legsim.kinematics import _osim_functions as functions
from legsim.kinematics._osim_frames import Frames
from legsim.kinematics._osim_functions import Function
from legsim.kinematics.osim_xml import flag

_X, _Y, _Z = np.eye(3)

_PLAIN_JOINTS: dict[str, tuple[tuple[FloatArray, ...], tuple[FloatArray, ...]]] = {
    "WeldJoint": ((), ()),
    "PinJoint": ((_Z,), ()),
    "SliderJoint": ((), (_X,)),
    "UniversalJoint": ((_X, _Y), ()),
    "BallJoint": ((_X, _Y, _Z), ()),
    "GimbalJoint": ((_X, _Y, _Z), ()),
    "PlanarJoint": ((_Z,), (_X, _Y)),
    "FreeJoint": ((_X, _Y, _Z), (_X, _Y, _Z)),
}
"""Axes of rotation and of translation, a coordinate each in this order"""

SUPPORTED_JOINTS = ("CustomJoint", *_PLAIN_JOINTS)

AXIS_TAGS = ("coordinates", "coordinate", "axis", "is_rotation")
"""children of a TransformAxis beside its function"""

_SPATIAL = tuple(f"{kind}{k}" for kind in ("rotation", "translation") for k in (1, 2, 3))


@dataclass(frozen=True, slots=True)
class Coordinate:
    """One coordinate of a joint; rad or m."""

    name: str
    default: float
    low: float
    high: float
    clamped: bool
    locked: bool


@dataclass(frozen=True, slots=True, eq=False)
class JointAxis:
    """A turn about, or shift along, one axis of a joint."""

    direction: FloatArray
    """(3,) unit vector"""
    coordinate: str
    """empty where the function is constant"""
    function: Function


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """How a child body moves on its parent."""

    name: str
    kind: str
    parent: str
    """name of a body; ``ground`` is the world"""
    child: str
    parent_from_p: FloatArray
    """(4, 4)"""
    child_from_c: FloatArray
    """(4, 4)"""
    coordinates: tuple[Coordinate, ...] = ()
    rotations: tuple[JointAxis, ...] = ()
    translations: tuple[JointAxis, ...] = ()
    problem: str = ""
    """why legsim cannot move it; empty if it can"""


@dataclass(frozen=True, slots=True, eq=False)
class Coupler:
    """A constraint: the dependent coordinate is a function of the independent one."""

    name: str
    dependent: str
    independent: str
    function: Function
    problem: str = ""
    """why legsim cannot hold it; empty if it can"""


@dataclass(frozen=True, slots=True)
class OtherConstraint:
    """An enforced constraint of a kind that legsim does not know."""

    name: str
    kind: str
    mentions: frozenset[str]
    """last parts of all names that it holds, bodies and coordinates among them"""


@dataclass(frozen=True, slots=True, eq=False)
class OsimMarker:
    """A marker fixed in a body."""

    name: str
    body: str
    location: FloatArray
    """(3,) m"""


@dataclass(frozen=True, slots=True, eq=False)
class OsimModel:
    """What a model file says about kinematics."""

    path: Path
    name: str
    version: int
    bodies: tuple[str, ...]
    joints: tuple[Joint, ...]
    couplers: tuple[Coupler, ...]
    constraints: tuple[OtherConstraint, ...]
    markers: tuple[OsimMarker, ...]
    homeless: tuple[str, ...]
    """markers whose body the model lacks, which are left out, each with that body"""
    frames: Frames
    """where markers may sit: bodies, and frames fixed in them, with (4, 4) body_from_frame"""
    factors: Mapping[str, FloatArray] = field(default_factory=dict)
    """(3,) by which bodies have been scaled since the file was read, by their names"""

    def joint_of(self, body: str) -> Joint | None:
        """The joint that carries a body; None where there is none."""
        return next((joint for joint in self.joints if joint.child == body), None)


def read(path: Path | str) -> OsimModel:
    """Reads a model.

    Raises:
        LegsimError: the file is no OpenSim model, is damaged, or keeps a set in another file.
    """
    path = Path(path)
    root = osim_xml.document(path)
    model = root.find("Model")
    if model is None:
        raise file_error(
            path, f"holds {_children(root)}, not a Model", "give an OpenSim model (.osim)"
        )
    elsewhere = [e.tag for e in model if e.get("file")]
    if elsewhere:
        raise file_error(
            path,
            f"its {elsewhere[0]} is in another file",
            "open the model in OpenSim and save it, so that one file holds it all",
        )
    version = root.get("Version", "0")
    if not (version.isascii() and version.isdecimal()):
        raise file_error(
            path, f"its Version is {version[:20]!r}", "expected OpenSim's whole number, as 40000"
        )
    try:
        return _model(path, model, int(version[:10]))
    except LegsimError as error:
        raise LegsimError(f"{path}: {error}") from error


def is_free(function: Element) -> bool:
    """Whether an axis' function returns its coordinate: the axis is a free one."""
    return functions.is_identity(functions.read(function, "its axis"))


def marker(element: Element, frames: Frames) -> OsimMarker | str:
    """A marker of a file of any version; name and body where ``frames`` do not hold that body.

    Raises:
        LegsimError: its place is not three numbers.
    """
    name = element.get("name", "")
    said = element.findtext("body") or _osim_frames.socket(
        element, "parent_frame", "reference_frame"
    )
    frame = _osim_frames.find(frames, said)
    location = functions.numbers(element, "location", f"marker {name}")
    if len(location) != 3:
        raise LegsimError(f"marker {name}: <location> holds {len(location)} numbers, expected 3")
    if frame is None:
        return f"{name} (on {_osim_frames.last(said) or 'no body'})"
    local = transforms.apply(frame[1], location[None])[0]
    return OsimMarker(name, frame[0], frozen("marker location", local, (3,)))


def _model(path: Path, model: Element, version: int) -> OsimModel:
    bodies = [body for body in _objects(model, "BodySet") if body.tag == "Body"]
    names = tuple(body.get("name", "") for body in bodies if body.get("name") != "ground")
    placed = _osim_frames.of_model(model, bodies)
    inside = [(joint, body.get("name", "")) for body in bodies for joint in body.findall("Joint/*")]
    found = [
        *(_joint(element, "", placed) for element in _objects(model, "JointSet")),
        *(_joint(element, child, placed) for element, child in inside),
    ]
    couplers, others = _constraints(_objects(model, "ConstraintSet"))
    read = [marker(e, placed) for e in _objects(model, "MarkerSet") if e.tag == "Marker"]
    return OsimModel(
        path,
        model.get("name", path.stem),
        version,
        names,
        tuple(found),
        couplers,
        others,
        tuple(m for m in read if isinstance(m, OsimMarker)),
        tuple(m for m in read if isinstance(m, str)),
        placed,
    )


def _joint(element: Element, child_body: str, placed: Frames) -> Joint:
    """One joint; ``child_body`` owns it in files of OpenSim 3 and before."""
    name, kind = element.get("name", ""), element.tag
    parent, parent_from_p, child, child_from_c, problem = _ends(element, child_body, placed)
    ends = (name, kind, parent, child, parent_from_p, child_from_c)
    try:
        coordinates = tuple(_coordinate(c, name) for c in element.iter("Coordinate"))
    except LegsimError as error:
        return Joint(*ends, (), problem=str(error))
    if flag(element, "reverse"):
        problem = problem or "it is reversed (child moves parent), which is not supported"
    if kind not in SUPPORTED_JOINTS:
        problem = (
            f"the joint type {kind} is not supported; supported are {', '.join(SUPPORTED_JOINTS)}"
        )
    prescribed = [c.get("name", "") for c in element.iter("Coordinate") if flag(c, "prescribed")]
    if prescribed:
        problem = problem or (
            f"its coordinate {prescribed[0]} is prescribed over time; set prescribed to false"
        )
    if problem:
        return Joint(*ends, coordinates, problem=problem)
    try:
        rotations, translations = (
            _spatial_transform(element, name)
            if kind == "CustomJoint"
            else _plain_axes(kind, coordinates)
        )
    except LegsimError as error:
        return Joint(*ends, coordinates, problem=str(error))
    known = {c.name for c in coordinates}
    strangers = [
        axis.coordinate
        for axis in (*rotations, *translations)
        if axis.coordinate and axis.coordinate not in known
    ]
    problem = f"it follows {strangers[0]}, which is not its own" if strangers else ""
    return Joint(*ends, coordinates, rotations, translations, problem)


def _ends(
    element: Element, child_body: str, placed: Frames
) -> tuple[str, FloatArray, str, FloatArray, str]:
    """(parent, parent_from_p, child, child_from_c, problem) of a joint of any version."""
    parent = element.findtext("parent_body") or _osim_frames.socket(
        element, "parent_frame", "parent_body"
    )
    child = child_body or _osim_frames.socket(element, "child_frame", "child_body")
    local: dict[str, tuple[str, FloatArray]] = {}
    own = list(element.findall("frames/PhysicalOffsetFrame"))
    for _ in own:
        # a frame may hang on another one of the same joint that comes after it
        for frame in own:
            base = _osim_frames.last(_osim_frames.socket(frame, "parent"))
            on = local.get(base) or _osim_frames.find(placed, _osim_frames.socket(frame, "parent"))
            if on is not None:
                at = _osim_frames.placed(frame, "translation", "orientation")
                local[frame.get("name", "")] = on[0], on[1] @ at
    ends, problem = [], ""
    for said, tags in (
        (parent, ("location_in_parent", "orientation_in_parent")),
        (child, ("location", "orientation")),
    ):
        own_frame = None if "bodyset" in said.split("/") else local.get(_osim_frames.last(said))
        frame = own_frame or _osim_frames.find(placed, said)
        if frame is None:
            problem = f"no body or frame is named {said.strip()!r}"
            frame = (_osim_frames.last(said), np.eye(4))
        if tags[0] == "location" and element.find("location_in_child") is not None:
            tags = ("location_in_child", "orientation_in_child")
        ends += [frame[0], frozen("frame", frame[1] @ _osim_frames.placed(element, *tags), (4, 4))]
    return *ends, problem


def _plain_axes(
    kind: str, coordinates: tuple[Coordinate, ...]
) -> tuple[tuple[JointAxis, ...], tuple[JointAxis, ...]]:
    turns, shifts = _PLAIN_JOINTS[kind]
    if len(coordinates) != len(turns) + len(shifts):
        raise LegsimError(
            f"a {kind} has {len(turns) + len(shifts)} coordinates; this one {len(coordinates)}"
        )
    axes = tuple(
        JointAxis(frozen("axis", axis, (3,)), coordinate.name, functions.IDENTITY)
        for axis, coordinate in zip((*turns, *shifts), coordinates, strict=True)
    )
    return axes[: len(turns)], axes[len(turns) :]


def _spatial_transform(
    element: Element, joint: str
) -> tuple[tuple[JointAxis, ...], tuple[JointAxis, ...]]:
    """The six axes of a CustomJoint, those that stay at zero left out."""
    old = element.find("TransformAxisSet")
    if old is not None:
        if (np.abs(functions.numbers(element, "scale_factors", "its scale") - 1) > 1e-9).any():
            raise LegsimError(
                "it holds scale factors of its own, as of OpenSim 1; open the model in OpenSim "
                "3.3 and save it"
            )
        named = _numbered(old)
    else:
        axes = element.findall("SpatialTransform/TransformAxis")
        named = [(axis.get("name", ""), axis) for axis in axes]
    wrong = [name for name, _ in named if name not in _SPATIAL]
    if wrong:
        raise LegsimError(f"its TransformAxis {wrong[0]!r} is not among {', '.join(_SPATIAL)}")
    read = [(name, _axis(axis, f"axis {name}")) for name, axis in named]
    turns, shifts = (
        tuple(
            axis
            for name, axis in sorted(read, key=lambda entry: entry[0])
            if name.startswith(kind) and not functions.is_zero(axis.function)
        )
        for kind in ("rotation", "translation")
    )
    return turns, shifts


def _numbered(old: Element) -> list[tuple[str, Element]]:
    """Axes of OpenSim 1's TransformAxisSet under today's names: in the order of the file."""
    counts, named = {"rotation": 0, "translation": 0}, []
    for axis in old.findall("objects/TransformAxis"):
        kind = "rotation" if flag(axis, "is_rotation") else "translation"
        counts[kind] += 1
        named.append((f"{kind}{counts[kind]}", axis))
    return named


def _axis(element: Element, place: str) -> JointAxis:
    said = f"{element.findtext('coordinates') or ''} {element.findtext('coordinate') or ''}"
    names = said.replace("Unassigned", "").split()
    if len(names) > 1:
        raise LegsimError(f"its {place} follows {len(names)} coordinates; one is supported")
    holder = element.find("function")
    inner = [e for e in element if e.tag not in AXIS_TAGS] if holder is None else list(holder)
    if len(inner) > 1:
        raise LegsimError(f"its {place} holds {len(inner)} functions, expected one")
    # as in OpenSim, an axis without a function is its coordinate
    alone = functions.IDENTITY if names else functions.ZERO
    function = functions.read(inner[0], f"its {place}") if inner else alone
    direction = functions.numbers(element, "axis", f"its {place}")
    length = float(np.linalg.norm(direction)) if len(direction) == 3 else 0.0
    if length == 0 and not functions.is_zero(function):
        raise LegsimError(f"its {place} has no direction: <axis> needs three numbers, not all 0")
    unit = direction / length if length else np.array([1.0, 0.0, 0.0])
    return JointAxis(frozen("axis", unit, (3,)), names[0] if names else "", function)


def _coordinate(element: Element, joint: str) -> Coordinate:
    name = element.get("name", "")
    place = f"joint {joint}, coordinate {name}"
    span = functions.numbers(element, "range", place, endless=True)
    if len(span) not in (0, 2):
        raise LegsimError(f"{place}: <range> holds {len(span)} numbers, expected two")
    if len(span) and span[0] > span[1]:
        raise LegsimError(f"{place}: <range> runs from {span[0]:g} to {span[1]:g}, backwards")
    default = functions.numbers(element, "default_value", place)
    low, high = span if len(span) else (-np.inf, np.inf)
    return Coordinate(
        name,
        float(default[0]) if len(default) else 0.0,
        float(low),
        float(high),
        flag(element, "clamped"),
        flag(element, "locked"),
    )


def _constraints(
    elements: Iterable[Element],
) -> tuple[tuple[Coupler, ...], tuple[OtherConstraint, ...]]:
    couplers, others = [], []
    for element in elements:
        off = flag(element, "isDisabled") or (
            element.find("isEnforced") is not None and not flag(element, "isEnforced")
        )
        if off:
            continue
        name, kind = element.get("name", ""), element.tag
        if kind == "CoordinateCouplerConstraint":
            couplers.append(_coupler(element, name))
        else:
            words = {
                _osim_frames.last(word) for e in element.iter() for word in (e.text or "").split()
            }
            others.append(OtherConstraint(name, kind, frozenset(words)))
    return tuple(couplers), tuple(others)


def _coupler(element: Element, name: str) -> Coupler:
    independent = (element.findtext("independent_coordinate_names") or "").split()
    dependent = (element.findtext("dependent_coordinate_name") or "").strip()
    holder, function, problem = element.find("coupled_coordinates_function"), functions.ZERO, ""
    try:
        inner = [] if holder is None else list(holder)
        if len(inner) != 1 or len(independent) != 1:
            raise LegsimError(
                f"it has {len(inner)} functions of {len(independent)} coordinates; one of one is "
                "supported"
            )
        scale = functions.numbers(element, "scale_factor", "it")
        function = functions.times(
            functions.read(inner[0], "its function"), float(scale[0]) if len(scale) else 1.0
        )
    except LegsimError as error:
        problem = str(error)
    return Coupler(name, dependent, independent[0] if independent else "", function, problem)


def _objects(model: Element, tag: str) -> list[Element]:
    holder = model.find(f"{tag}/objects")
    return [] if holder is None else list(holder)


def _children(root: Element) -> str:
    return ", ".join(child.tag for child in list(root)[:3]) or "nothing"
