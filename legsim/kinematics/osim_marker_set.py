"""OpenSim's marker sets in files of their own: a model's markers with these put in.

As OpenSim's Model::updateMarkerSet: a marker of the set takes the place of the model's of exactly
that name, others are added. The places hold on the model as its file has it, before any scaling.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from legsim.core.errors import LegsimError, file_error
from legsim.kinematics import osim_file, osim_xml
from legsim.kinematics.osim_file import OsimMarker, OsimModel

_FIX = "give OpenSim's marker set (.xml), a MarkerSet with its markers"


def with_set(model: OsimModel, path: str | Path) -> tuple[OsimModel, tuple[str, ...]]:
    """The model with the markers of a file, and what became of them.

    Markers on bodies that the model lacks are left out, and named.

    Raises:
        LegsimError: the file is no marker set or damaged, names two places alike, or has no marker
            on any of the model's bodies.
    """
    path = Path(path)
    given, homeless = _read(path, model)
    if not given:
        raise file_error(
            path,
            f"none of its markers is on a body of the model: {', '.join(homeless)}; the model has "
            f"{', '.join(model.bodies)}",
            "give the marker set of this model",
        )
    replaced = [marker.name for marker in model.markers if marker.name in given]
    kept = tuple(marker for marker in model.markers if marker.name not in given)
    notes = [f"{len(given)} markers of the marker set {path.name}"]
    if kept or replaced:
        notes[0] += (
            f"; of the model's own, {len(set(replaced))} of the same names give way and "
            f"{len({m.name for m in kept})} stay"
        )
    if homeless:
        notes.append(
            f"warning: markers of {path.name} on bodies that the model lacks are left out: "
            f"{', '.join(homeless)}"
        )
    return replace(model, markers=(*kept, *given.values())), tuple(notes)


def _read(path: Path, model: OsimModel) -> tuple[dict[str, OsimMarker], list[str]]:
    """The markers on the model's bodies by name, and the others, each with its body."""
    root = osim_xml.document(path, bare=("MarkerSet",))
    holder = root if root.tag == "MarkerSet" else root.find("MarkerSet")
    if holder is None:
        inside = ", ".join(dict.fromkeys(e.tag for e in root)) or "nothing"
        raise file_error(path, f"holds {inside}, not a MarkerSet", _FIX)
    elements = holder.findall("objects/Marker")
    if not elements:
        other = f"; its markers are in the file {holder.get('file')}" if holder.get("file") else ""
        raise file_error(path, f"its MarkerSet holds no marker{other}", _FIX)
    found: dict[str, OsimMarker] = {}
    homeless = []
    for element in elements:
        if not (element.get("name") or "").strip():
            raise file_error(path, "a marker has no name", "name it", place="MarkerSet")
        try:
            marker = osim_file.marker(element, model.frames)
        except LegsimError as error:
            raise LegsimError(f"{path}: {error}") from error
        if isinstance(marker, str):
            homeless.append(marker)
            continue
        same = found.setdefault(marker.name, marker)
        if same.body != marker.body or not np.allclose(same.location, marker.location):
            raise file_error(
                path,
                f"two markers are named {marker.name}, on {same.body} and {marker.body}",
                "rename or remove one",
                place="MarkerSet",
            )
    return found, homeless
