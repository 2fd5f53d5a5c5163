"""An imaged leg that moves: the meshes of a PHANTOM.toml, registered to the leg model.

Landmarks of femur and tibia say how the model's leg stands in the image: where its knee is, how its
femur is turned, and how far its knee is flexed; the same landmarks of the model's own bones, cut
alike, say what they are in the model. Bones of the model's own shape are then laid on it with all
of their surface. From that pose on each bone moves as its segment does, so
bones keep their size and the joints their imaged fit; soft tissue is straightened by the soft map
and then follows it.
"""

import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from legsim.core import files as core_files
from legsim.core import transforms
from legsim.core.errors import LegsimError, file_error
from legsim.core.values import FloatArray
from legsim.kinematics.leg_model import COORDINATES, LegModel
from legsim.kinematics.skeleton import SEGMENTS, SegmentScales
from legsim.mocap.trajectories import JointTrajectories
from legsim.phantom import _bone_fit, files, landmarks, leg_phantom, materials
from legsim.phantom._leg_template import leg_axes, reference_pose
from legsim.phantom.files import PhantomFile
from legsim.phantom.landmarks import BoneSurface, middle_of_knee
from legsim.phantom.leg_phantom import LegPhantom
from legsim.phantom.meshes import Phantom

_FLEXION_DEG = (-15.0, 45.0)
"""knee angles of an imaged leg that its soft tissue can be straightened from"""

_LAID = {"femur", "tibia"}
"""bones that are laid on the model's with all of their surface"""

_SHAFTS = ("thigh", "shank")

_STUMP, _STUMP_DEG = 0.10, 10.0
"""m from the knee within which a shaft's middle shows its direction to degrees only

Widths of people's knees differ by some mm from the model's, and so does where their shafts begin.
"""

_KNEE_DEG = (-20.0, 120.0)
"""where the model's knee goes while its flexion is sought"""

_FLEXION_STEPS = 5
"""steps to the flexion; each leaves about a fiftieth of what was missing"""

_LENGTH_APART = 0.015
"""m by which thigh or shank may differ from the leg model's without a warning"""

_NOT_STRAIGHTENED = 0.5e-3
"""m between imaged tissue and where the soft map returns it, beyond which a warning reports it"""

_SAME_PLACE = 0.05e-3
"""m between a landmark of a file and the one found on its bones, if nobody moved it"""

_AT_ONCE = 100_000
"""points straightened in one go"""


class ImagedLegWarning(UserWarning):
    """What of an imaged leg does not fit the leg model."""


def load_imaged_leg(
    path: Path | str,
    *,
    scales: SegmentScales | None = None,
    energy_kev: float = materials.DEFAULT_ENERGY_KEV,
    swinging: bool = False,
) -> LegPhantom:
    """Loads the legs of a PHANTOM.toml in the leg model's reference pose.

    Landmarks in the file replace those found on its bones.

    Args:
        path: of a PHANTOM.toml whose parts have segments.
        scales: of the leg model that moves the leg; the anatomy keeps its own size.
        energy_kev: of the attenuations.
        swinging: as of :func:`legsim.phantom.leg_phantom.load_leg_phantom`.

    Raises:
        LegsimError: as :func:`legsim.phantom.files.read`; a part without a segment of the leg
            model; no landmarks; a knee flexed too far.
    """
    path = Path(path)
    read = files.read(path, energy_kev=energy_kev)
    scales = scales or SegmentScales.uniform()
    segments = _segments(path, read)
    sides = sorted({s[-1] for s in segments if s != "pelvis"})
    if not sides:
        raise file_error(path, "no part moves with a leg", 'give parts a segment, as "femur_l"')
    pose = image_pose(path, read, scales)
    reference = reference_pose(scales)
    blank = LegPhantom(
        read.phantom,
        segments,
        reference,
        (leg_axes(scales, "l"), leg_axes(scales, "r")),
        None,
        (),
    )
    local, parts = [], []
    for part, segment in zip(read.phantom.parts, segments, strict=True):
        carrier = f"femur_{segment[-1]}" if segment.startswith("soft") else segment
        k = SEGMENTS.index(carrier)
        if segment.startswith("soft"):
            points = _straightened(blank, part.name, part.vertices, pose, segment[-1])
        else:
            points = transforms.apply(transforms.inverse(pose[k]), part.vertices)
        local.append(points)
        parts.append(replace(part, vertices=transforms.apply(reference[k], points)))
    still = replace(blank, phantom=Phantom(tuple(parts)))
    if swinging:
        still = leg_phantom.with_mobile_tissue(still)
    return replace(still, _groups=leg_phantom.grouped(still, local))


def content_key(path: Path | str) -> str:
    """Hash of a PHANTOM.toml and of all its meshes.

    Raises:
        LegsimError: a file is missing.
    """
    named = files.named_meshes(Path(path))
    try:
        return core_files.key_of(*(core_files.sha256(name) for name in (Path(path), *named)))
    except OSError as error:
        raise file_error(
            error.filename or path, f"cannot be read ({error.strerror})", "check the path"
        ) from error


def image_pose(path: Path, read: PhantomFile, scales: SegmentScales) -> FloatArray:
    """Poses world_from_segment (13, 4, 4) of the model's legs as they stand in the image.

    Segments of a leg that is not there keep the reference pose.

    Raises:
        LegsimError: as :func:`load_imaged_leg`.
    """
    model = leg_phantom.load_leg_phantom(scales=scales)
    poses = np.array(model.reference_world_from_segment)
    moved = []
    for side in ("l", "r"):
        bones = _bones(read, side)
        if not bones and not any((s or "").endswith(f"_{side}") for s in read.segments):
            continue
        try:
            imaged, of_bones = _landmarks(read, bones, side)
            judged = of_bones and "femur" in bones
            leans = judged and landmarks.of_other_side(bones, imaged, side)
        except LegsimError as error:
            raise LegsimError(f"{path}: {error}") from error
        if leans:
            warnings.warn(
                f"{path}: the femur of side {side} leans as one of the other leg: check the sides",
                ImagedLegWarning,
                stacklevel=3,
            )
        # landmarks that somebody moved count as they are
        own = {name: bones[name] for name in _LAID & bones.keys()} if of_bones else {}
        placed, flexed = _registered(path, imaged, own, model, scales, side)
        for k, name in enumerate(SEGMENTS):
            if name.endswith(f"_{side}"):
                poses[k] = placed @ flexed[k]
        femur = SEGMENTS.index(f"femur_{side}")
        moved.append(poses[femur][:3, 3] - model.reference_world_from_segment[femur][:3, 3])
    if moved:
        poses[SEGMENTS.index("pelvis")] = transforms.translation(np.mean(moved, axis=0))
    return poses


def _segments(path: Path, read: PhantomFile) -> tuple[str, ...]:
    """Segment of each part, checked."""
    found = []
    for part, segment in zip(read.phantom.parts, read.segments, strict=True):
        if segment is None or segment not in (*SEGMENTS, "soft_l", "soft_r"):
            what = "has no segment" if segment is None else f"moves with {segment!r}"
            fix = f"known: soft_l, soft_r, {', '.join(SEGMENTS)}"
            raise file_error(path, f"{what}, so that no leg carries it", fix, place=part.name)
        found.append(segment)
    return tuple(found)


def _bones(read: PhantomFile, side: str) -> dict[str, BoneSurface]:
    """Outer surface of femur, tibia and patella: the largest bony part of each segment."""
    found: dict[str, BoneSurface] = {}
    for part, segment in zip(read.phantom.parts, read.segments, strict=True):
        for bone in ("femur", "tibia", "patella"):
            if segment != f"{bone}_{side}" or "bone" not in part.material:
                continue
            largest = found.get(bone)
            if (
                largest is None
                or np.ptp(part.vertices, 0).prod() > np.ptp(largest.vertices, 0).prod()
            ):
                found[bone] = BoneSurface(part.vertices, part.triangles)
    return found


def _landmarks(
    read: PhantomFile, bones: Mapping[str, BoneSurface], side: str
) -> tuple[dict[str, FloatArray], bool]:
    """Landmarks of one side, and whether all of them are those of its bones."""
    given = dict(read.landmarks.get(side, {}))
    enough = {"condyle_medial", "condyle_lateral"} <= given.keys()
    try:
        found = landmarks.find(bones, side)
    except LegsimError:
        if not (enough and given.keys() & {"hip", "thigh"}):
            raise
        found = {}
    of_bones = all(
        name in found and _length(found[name], point) < _SAME_PLACE for name, point in given.items()
    )
    for joint, shaft in (("hip", "thigh"), ("ankle", "shank")):
        if given.keys() & {joint, shaft}:
            found = {k: v for k, v in found.items() if k not in (joint, shaft)}
    merged = found | given
    if not merged.keys() & {"ankle", "shank"}:
        raise LegsimError(
            f"neither a tibia of side {side} nor a landmark ankle or shank is there: nothing says "
            "how far the knee is flexed"
        )
    return merged, of_bones


def _of_model(
    model: LegPhantom, imaged: Mapping[str, FloatArray], side: str
) -> dict[str, FloatArray]:
    """The same landmarks on the leg model's own bones, in world of its reference pose."""
    knee = middle_of_knee(imaged)
    return landmarks.find(
        _model_bones(model, side),
        side,
        thigh_reach=None if "hip" in imaged else _length(imaged["thigh"], knee),
        shank_reach=None if "ankle" in imaged else _length(imaged["shank"], knee),
    )


def _model_bones(model: LegPhantom, side: str) -> dict[str, BoneSurface]:
    """Outer surfaces of the model's femur and tibia in world of its reference pose."""
    found = {}
    for bone in ("femur", "tibia"):
        part = model.phantom.parts[model.part_index(f"{bone}_cortex_{side}")]
        found[bone] = BoneSurface(part.vertices, part.triangles)
    return found


def _length(a: FloatArray, b: FloatArray) -> float:
    return float(np.linalg.norm(a - b))


def _registered(
    path: Path,
    imaged: Mapping[str, FloatArray],
    bones: Mapping[str, BoneSurface],
    legs: LegPhantom,
    scales: SegmentScales,
    side: str,
) -> tuple[FloatArray, FloatArray]:
    """(image world from the model's world (4, 4), poses (13, 4, 4) of the model as the knee is
    flexed in the image).

    Landmarks say both; where ``bones`` has femur and tibia, and they are the model's own in shape,
    their surfaces say it more exactly.
    """
    model = _of_model(legs, imaged, side)

    def moved(flexion: float) -> dict[str, FloatArray]:
        return _bone_motions(legs, scales, side, flexion)

    frames = [landmarks.femur_frame(points, side) for points in (imaged, model)]
    placed, flexion = frames[0] @ transforms.inverse(frames[1]), 0.0
    wanted = _shank_angle(imaged, frames[0])
    for _ in range(_FLEXION_STEPS):
        # the knee does not turn about the middle of its condyles, nor by just this angle
        flexion += _shank_angle(model, frames[1], moved(flexion)["tibia"]) - wanted
    stumps = {n: _length(p, middle_of_knee(imaged)) for n, p in imaged.items() if n in _SHAFTS}
    if bones.keys() == _LAID:
        fitted = _bone_fit.fit(bones, _model_bones(legs, side), moved, placed, flexion)
        if fitted.same_shape:
            placed, flexion, stumps = fitted.placed, fitted.flexion, {}
    flexion = _plausible(path, flexion, stumps, side)
    _warn_of_lengths(path, imaged, model, side)
    return placed, _at_flexion(legs, scales, side, flexion)


def _plausible(path: Path, flexion: float, stumps: Mapping[str, float], side: str) -> float:
    """Flexion (rad) within what soft tissue can be straightened from.

    Args:
        path: of the phantom.
        flexion: rad, as found.
        stumps: lengths (m) of the shafts that gave it, where no joint beyond the knee did.
        side: "l" or "r".

    Raises:
        LegsimError: it is outside, by more than short stumps may be off.
    """
    low, high = np.radians(_FLEXION_DEG)
    short = {name: length for name, length in stumps.items() if length < _STUMP}
    slack = np.radians(_STUMP_DEG) if short else 0.0
    if not low - slack <= flexion <= high + slack:
        raise file_error(
            path,
            f"the knee of side {side} is flexed by {np.degrees(flexion):.0f} degrees",
            f"expected {_FLEXION_DEG[0]:g} to {_FLEXION_DEG[1]:g}: check the axes of the image and "
            "the landmarks",
        )
    taken = float(np.clip(flexion, low, high))
    if short:
        seen = " and ".join(f"{name} {1e3 * length:.0f} mm" for name, length in short.items())
        warnings.warn(
            f"{path}: of side {side} little is imaged beyond the knee ({seen}), so that its "
            f"flexion, taken as {np.degrees(taken):.0f} degrees, may be {_STUMP_DEG:g} degrees "
            "off; give thigh and shank in [landmarks] as points 100 mm or more from the knee, "
            "where you know the leg's axes",
            ImagedLegWarning,
            stacklevel=5,
        )
    return taken


def _warn_of_lengths(
    path: Path, imaged: Mapping[str, FloatArray], model: Mapping[str, FloatArray], side: str
) -> None:
    for joint, name in (("hip", "thigh"), ("ankle", "shank")):
        if joint in imaged and joint in model:
            own, models = (_length(p[joint], middle_of_knee(p)) for p in (imaged, model))
            if abs(own - models) > _LENGTH_APART:
                warnings.warn(
                    f"{path}: the {name} of side {side} is {1e3 * own:.0f} mm long, the leg "
                    f"model's {1e3 * models:.0f} mm; bones keep their size, so that the {joint} "
                    "does not turn about its own center",
                    ImagedLegWarning,
                    stacklevel=5,
                )


def _bone_motions(
    model: LegPhantom, scales: SegmentScales, side: str, flexion: float
) -> dict[str, FloatArray]:
    """Motions (4, 4) of femur and tibia from the model's reference pose as its knee is flexed."""
    flexed, still = _at_flexion(model, scales, side, flexion), model.reference_world_from_segment
    places = {bone: SEGMENTS.index(f"{bone}_{side}") for bone in ("femur", "tibia")}
    return {bone: flexed[k] @ transforms.inverse(still[k]) for bone, k in places.items()}


def _shank_angle(
    points: Mapping[str, FloatArray], frame: FloatArray, carried: FloatArray | None = None
) -> float:
    """Angle (rad) in the thigh's sagittal plane of the shank's lower end, carried by (4, 4)."""
    low = points["ankle"] if "ankle" in points else points["shank"]
    low = low if carried is None else transforms.apply(carried, low[None])[0]
    x, y, _ = frame[:3, :3].T @ (low - middle_of_knee(points))
    return float(np.arctan2(x, -y))


def _at_flexion(model: LegPhantom, scales: SegmentScales, side: str, flexion: float) -> FloatArray:
    """Poses (13, 4, 4) of the model with one knee flexed by rad, its thigh as in the reference."""
    flexion = float(np.clip(flexion, *np.radians(_KNEE_DEG)))
    values = np.zeros((1, len(COORDINATES)))
    values[0, COORDINATES.index(f"knee_angle_{side}")] = -flexion
    trajectories = JointTrajectories(np.zeros(1), COORDINATES, values)
    poses = LegModel.load(scales).segment_poses(trajectories).world_from_segment[0]
    femur = SEGMENTS.index(f"femur_{side}")
    return model.reference_world_from_segment[femur] @ transforms.inverse(poses[femur]) @ poses


def _straightened(
    legs: LegPhantom, name: str, points: FloatArray, pose: FloatArray, side: str
) -> FloatArray:
    """Points (p, 3) of the straight leg, in the femur's frame, of imaged soft tissue."""
    out = np.empty_like(points)
    for first in range(0, len(points), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        out[part] = legs.straightened(points[part], pose, SEGMENTS, side)
    returned = legs.from_straight(out, pose, SEGMENTS, side)
    far = np.linalg.norm(returned - points, axis=-1)
    if far.max() > _NOT_STRAIGHTENED:
        share = float((far > _NOT_STRAIGHTENED).mean())
        warnings.warn(
            f"{name}: {100 * share:.2g} % of its surface could not be straightened, and is up to "
            f"{1e3 * far.max():.1f} mm off: the soft map folds there",
            ImagedLegWarning,
            stacklevel=3,
        )
    return out
