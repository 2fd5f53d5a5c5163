"""Scale factors from OpenSim's files: a ScaleSet as the scale tool writes it, or the one inside its
set-up.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from legsim.core import transforms
from legsim.core.errors import LegsimError, file_error
from legsim.core.values import FloatArray, frozen
from legsim.kinematics import _osim_functions as functions
from legsim.kinematics import osim_xml
from legsim.kinematics.osim_file import Joint, JointAxis, OsimModel
from legsim.kinematics.skeleton import SEGMENTS, SegmentScales

_PLAUSIBLE = (0.4, 2.5)
"""of the generic model: beyond it a factor is a mistake"""


def read(path: Path | str) -> dict[str, FloatArray]:
    """Factors (3,) along x, y, z by the name of the body; what is not to be applied is left out.

    Raises:
        LegsimError: the file holds no scale that applies, one body twice, or a factor that is no
            person's.
    """
    path = Path(path)
    found: dict[str, FloatArray] = {}
    for element in osim_xml.document(path).iter("Scale"):
        body = (element.findtext("segment") or element.get("name") or "").strip()
        if not osim_xml.flag(element, "apply", missing=True):
            continue
        try:
            factors = functions.numbers(element, "scales", f"scale of {body}")
        except LegsimError as error:
            raise LegsimError(f"{path}: {error}") from error
        if len(factors) != 3 or not body:
            raise file_error(
                path, f"the scale of {body or 'an unnamed body'} has {len(factors)} factors",
                "give three, along x, y, z, and the segment",
            )  # fmt: skip
        if not (_PLAUSIBLE[0] <= factors.min() and factors.max() <= _PLAUSIBLE[1]):
            raise file_error(
                path,
                f"the factors of {body} are {', '.join(f'{f:g}' for f in factors)}",
                f"give factors over the generic model, {_PLAUSIBLE[0]:g} to {_PLAUSIBLE[1]:g}",
            )
        if body in found:
            raise file_error(path, f"{body} is scaled twice", "keep one of its scales")
        found[body] = frozen("factors", factors, (3,))
    if not found:
        raise file_error(
            path,
            "holds no scale that applies",
            "give the scale set that OpenSim's scale tool writes (output_scale_file), or scale a "
            "model there and give it as motion.model",
        )
    return found


def segment_scales(factors: Mapping[str, FloatArray]) -> tuple[SegmentScales, tuple[str, ...]]:
    """Scales of legsim's own leg from factors by gait2392's body names, and notes.

    The patella goes with the femur.

    Raises:
        LegsimError: no factor belongs to the legs.
    """
    given = [name for name in SEGMENTS if name in factors]
    if not given:
        raise LegsimError(
            f"scales {', '.join(factors)}, none of which is one of {', '.join(SEGMENTS)}"
        )
    rows = []
    for name in SEGMENTS:
        source = name if name in factors else name.replace("patella", "femur")
        rows.append(factors.get(source, np.ones(3)))
    missing = [n for n in SEGMENTS if n not in factors and not n.startswith("patella")]
    notes = (
        (f"the scale file leaves {', '.join(missing)} as in the generic model",) if missing else ()
    )
    return SegmentScales(np.array(rows)), notes


def scaled(model: OsimModel, factors: Mapping[str, FloatArray]) -> OsimModel:
    """The model scaled as OpenSim does it (checked against its Model::scale).

    A joint's frames move with their bodies' factors; its translations, where they are no free
    coordinates, are multiplied by the parent's factors along their axis, whatever the turn of the
    frame; markers move with their bodies.

    Raises:
        LegsimError: no factor belongs to a body of the model.
    """
    if not set(factors) & set(model.bodies):
        raise LegsimError(
            f"scales {', '.join(factors)}, none of which is a body of the model: "
            f"{', '.join(model.bodies)}"
        )
    one = np.ones(3)
    before = model.factors
    return replace(
        model,
        factors={
            body: frozen("factors", before.get(body, one) * factors.get(body, one), (3,))
            for body in model.bodies
            if body in before or body in factors
        },
        joints=tuple(_scaled_joint(joint, factors) for joint in model.joints),
        markers=tuple(
            replace(m, location=frozen("location", m.location * factors.get(m.body, one), (3,)))
            for m in model.markers
        ),
    )


def _scaled_joint(joint: Joint, factors: Mapping[str, FloatArray]) -> Joint:
    one = np.ones(3)
    parent, child = factors.get(joint.parent, one), factors.get(joint.child, one)
    return replace(
        joint,
        parent_from_p=_moved(joint.parent_from_p, parent),
        child_from_c=_moved(joint.child_from_c, child),
        translations=tuple(_scaled_axis(axis, parent) for axis in joint.translations),
    )


def _scaled_axis(axis: JointAxis, parent: FloatArray) -> JointAxis:
    if functions.is_identity(axis.function):
        return axis
    by = float(np.abs(axis.direction) @ parent)
    return replace(axis, function=functions.times(axis.function, by))


def _moved(frame: FloatArray, factors: FloatArray) -> FloatArray:
    return frozen("frame", transforms.rigid(frame[:3, :3], frame[:3, 3] * factors), (4, 4))
