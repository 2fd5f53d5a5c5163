"""OpenSim's tasks of inverse kinematics: an IKTaskSet, by itself or in the set-up of its tool."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

from legsim.core.errors import LegsimError, file_error
from legsim.core.files import is_file
from legsim.kinematics import _osim_functions as functions
from legsim.kinematics import osim_xml
from legsim.kinematics.ik_options import CoordinateTask

_SETUPS = ("InverseKinematicsTool", "IKTool")

_ROOTS = ("IKTaskSet", *_SETUPS)

_FIX = "give an IKTaskSet, or the set-up of OpenSim's inverse kinematics with its tasks"


@dataclass(frozen=True, slots=True)
class IkTaskSet:
    """The tasks of a file that apply."""

    file: str
    markers: Mapping[str, float]
    """weight by the marker's name"""
    coordinates: tuple[CoordinateTask, ...]
    notes: tuple[str, ...]


def files_of(path: str | Path) -> tuple[Path, ...]:
    """The files that :func:`read` reads: the one given, and the task set that a set-up names.

    Raises:
        LegsimError: as of :func:`read`, where no task set is found.
    """
    path = Path(path)
    _, holder = _task_set(path)
    return (path,) if holder == path else (path, holder)


def read(path: str | Path) -> IkTaskSet:
    """Reads marker and coordinate tasks; those with ``apply`` false are left out.

    What a file leaves out has OpenSim's default: ``apply`` true, weight 0, the default value.

    Raises:
        LegsimError: no task set, a task without name or given twice, a weight below 0, or a value
            from a file of coordinates.
    """
    path = Path(path)
    tasks, holder = _task_set(path)
    markers: dict[str, float] = {}
    coordinates: dict[str, CoordinateTask] = {}
    for element in tasks.findall("objects/*"):
        name, weight = _name_and_weight(element, holder)
        if name in (markers if element.tag == "IKMarkerTask" else coordinates):
            raise file_error(holder, f"{name} has two tasks", "keep one")
        if not osim_xml.flag(element, "apply", missing=True):
            continue
        if element.tag == "IKMarkerTask":
            markers[name] = weight
        elif element.tag == "IKCoordinateTask":
            coordinates[name] = CoordinateTask(name, weight, _value(element, name, holder))
        else:
            raise file_error(
                holder, f"holds <{element.tag}>", "keep IKMarkerTask and IKCoordinateTask"
            )
    if not markers and not coordinates:
        raise file_error(holder, "holds no task that applies", _FIX)
    tool = osim_xml.document(path, bare=_ROOTS)
    whole = tool.tag in _SETUPS or any(tool.find(setup) is not None for setup in _SETUPS)
    notes = (f"of {path.name} only the tasks are used, no model, recording or time range",)
    return IkTaskSet(path.name, markers, tuple(coordinates.values()), notes if whole else ())


def _task_set(path: Path) -> tuple[Element, Path]:
    """The task set, and the file that it is in."""
    root = osim_xml.document(path, bare=_ROOTS)
    holders = [root, *(element for element in root if element.tag in _SETUPS)]
    found = [tasks for holder in holders for tasks in holder.findall("IKTaskSet")]
    found += [root] if root.tag == "IKTaskSet" else []
    if len(found) != 1:
        inside = ", ".join(dict.fromkeys(e.tag for e in root)) or "nothing"
        said = f"{len(found)} IKTaskSets" if found else f"no IKTaskSet of that tool, but {inside}"
        raise file_error(path, f"holds {said}", _FIX)
    other = (found[0].get("file") or "").strip()
    if not other:
        return found[0], path
    there = path.parent / other
    if not is_file(there):
        raise file_error(path, f"its task set {other} is not there", f"put it at {there}")
    inner = osim_xml.document(there, bare=("IKTaskSet",))
    tasks = inner if inner.tag == "IKTaskSet" else inner.find("IKTaskSet")
    if tasks is None:
        raise file_error(there, "holds no IKTaskSet", _FIX)
    return tasks, there


def _name_and_weight(element: Element, path: Path) -> tuple[str, float]:
    name = (element.get("name") or "").strip()
    if not name:
        raise file_error(path, f"an {element.tag} has no name", "name its marker or coordinate")
    weight = _number(element, "weight", name, path)
    if weight < 0:
        raise file_error(path, f"the weight of {name} is {weight:g}", "give 0 or more")
    return name, weight


def _value(element: Element, name: str, path: Path) -> float | None:
    """The value in OpenSim's units, rad or m; None for the model's default."""
    kind = (element.findtext("value_type") or "default_value").strip()
    if kind == "from_file" or osim_xml.flag(element, "from_file"):
        raise file_error(
            path,
            f"the task of {name} takes its value from a file of coordinates",
            "give default_value or manual_value",
        )
    if kind not in ("default_value", "manual_value"):
        raise file_error(
            path, f"the value_type of {name} is {kind!r}", "give default_value or manual_value"
        )
    return None if kind == "default_value" else _number(element, "value", name, path)


def _number(element: Element, tag: str, name: str, path: Path) -> float:
    """One number of a task; 0 where it is missing, as in OpenSim."""
    try:
        numbers = functions.numbers(element, tag, f"task of {name}")
    except LegsimError as error:
        raise LegsimError(f"{path}: {error}") from error
    if len(numbers) > 1:
        raise file_error(path, f"<{tag}> of {name} holds {len(numbers)} numbers", "give one")
    return float(numbers[0]) if len(numbers) else 0.0
