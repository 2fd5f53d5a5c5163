"""Frames of an OpenSim model: its bodies, and offset frames fixed in them, found as sockets name
them.

Offset frames of two bodies may bear one name, so they are known by body and name; by the name alone
only where one frame has it.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from xml.etree.ElementTree import Element

import numpy as np

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.kinematics import _osim_functions as functions

Frames = Mapping[str, tuple[str, FloatArray]]
"""body and (4, 4) body_from_frame by ``name`` or ``owner/name``"""


def of_model(model: Element, bodies: Sequence[Element]) -> Frames:
    """The frames of a model: ground, bodies, and offset frames among the components of these and of
    the model.

    Raises:
        LegsimError: a place is not three numbers.
    """
    names = ["ground", *(body.get("name", "") for body in bodies)]
    found = {name: (name, np.eye(4)) for name in names}
    owners = [*model.findall("Ground"), *bodies, model]
    waiting = [
        (owner.get("name", ""), frame)
        for owner in owners
        for frame in owner.findall("components/PhysicalOffsetFrame")
    ]
    # a frame may hang on another one that comes after it
    for _ in waiting:
        for owner, frame in waiting:
            said = socket(frame, "parent").strip()
            sibling = None if said.startswith("/") else found.get(f"{owner}/{last(said)}")
            base = sibling or find(found, owner if said in ("", "..") else said)
            if base is not None:
                at = placed(frame, "translation", "orientation")
                found[f"{owner}/{frame.get('name', '')}"] = base[0], base[1] @ at
    count = Counter(last(key) for key in found)
    return found | {last(key): at for key, at in found.items() if count[last(key)] == 1}


def find(frames: Frames, said: str) -> tuple[str, FloatArray] | None:
    """The frame that a socket names, by a path or a bare name; None where there is none, or more
    than one.
    """
    owner, _, name = "/".join(said.strip().strip("/").split("/")[-2:]).rpartition("/")
    on_body = frames.get(f"{owner}/{name}")
    return on_body if on_body or owner in frames else frames.get(name)


def socket(element: Element, *names: str) -> str:
    """What a socket (OpenSim 4) or connector (its previews) connects to; empty where it says
    nothing.
    """
    for name in names:
        said = element.findtext(f"socket_{name}") or element.findtext(
            f"socket_{name}_connectee_name"
        )
        if said:
            return said
        for connector in element.findall("connectors/*"):
            if connector.get("name") == name:
                return connector.findtext("connectee_name") or ""
    return ""


def placed(element: Element, location: str, orientation: str) -> FloatArray:
    """(4, 4) of a translation and body-fixed x-y-z angles; the identity where they are missing.

    Raises:
        LegsimError: one of them is not three numbers.
    """
    place = element.get("name", element.tag)
    at, turn = (functions.numbers(element, tag, place) for tag in (location, orientation))
    if len(at) not in (0, 3) or len(turn) not in (0, 3):
        raise LegsimError(
            f"{place}: <{location}> and <{orientation}> hold {len(at)} and {len(turn)} numbers, "
            "expected 3"
        )
    rotation = np.eye(3)
    for axis, angle in zip(np.eye(3), turn, strict=False):
        rotation = rotation @ transforms.axis_rotation(axis, angle)
    return transforms.rigid(rotation, at if len(at) else np.zeros(3))


def last(name: str) -> str:
    """The last part of a path such as ``/bodyset/femur_r``."""
    return name.strip().rstrip("/").rpartition("/")[2]
