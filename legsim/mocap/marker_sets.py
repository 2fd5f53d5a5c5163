"""Marker maps from TOML files: the marker sets that ship with legsim, and a user's own."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from legsim.core import files, resources
from legsim.core.errors import LegsimError, file_error
from legsim.mocap import labels as mocap_labels
from legsim.mocap.labels import PAPER_ROLES, MarkerMap

_FOLDER = "marker_sets"

_COMMON = "common_names"
"""the set that mixes all others; taken only where none of them covers a recording by itself"""


def load(name_or_path: str | Path) -> MarkerMap:
    """Reads the map of a shipped set by its name, or any by its path.

    The file holds one table ``[roles]``. A role is given one label, a list of labels whose mean
    plays it, or a list of such
    lists: alternatives, of which the first that a recording covers is taken.

    Raises:
        LegsimError: there is no such set or file, or it is not a marker map; the message lists the
            shipped ones.
    """
    path = Path(name_or_path)
    if path.suffix.lower() != ".toml":
        if str(name_or_path) not in names():
            raise LegsimError(
                f"no marker set is named {name_or_path!s}; there are: {', '.join(names())}, or "
                "give a TOML file"
            )
        path = resources.model_file(f"{_FOLDER}/{name_or_path}.toml")
    return _from_table(path, files.load_toml(path, "correct the file"))


def names() -> tuple[str, ...]:
    """The shipped sets' names, in alphabetical order."""
    return tuple(
        sorted(
            p.stem
            for p in resources.model_file(f"{_FOLDER}/paper_seven.toml").parent.glob("*.toml")
        )
    )


def guess(marker_names: Sequence[str], *, required: Sequence[str] = PAPER_ROLES) -> MarkerMap:
    """The shipped set that covers a recording's markers best, names of several sets mixed only
    where none is enough.

    Raises:
        LegsimError: none covers the required roles; the message names what is missing and the
            labels there are.
    """
    maps = [load(name) for name in names() if name != _COMMON]
    if any(not m.missing_in(marker_names, required) for m in maps):
        return mocap_labels.guess(maps, marker_names, required=required)
    return mocap_labels.guess([*maps, load(_COMMON)], marker_names, required=required)


def guess_beside(marker_names: Sequence[str], static_names: Sequence[str]) -> MarkerMap:
    """The set for a recording whose person is scaled from another one, a static trial as a rule:
    the static's own, which may mix names, unless the set that fits the recording by itself finds
    more of the markers that both show.

    Args:
        marker_names: of the recording, which may lack the landmarks that only scaling needs.
        static_names: of the trial that it is scaled from.

    Raises:
        LegsimError: no set covers the static trial, or none knows any marker of the recording.
    """
    static = guess(static_names)
    shown = set(static.found_in(static_names))
    own = guess(marker_names, required=())

    def shared(found: MarkerMap) -> int:
        return len(shown & set(found.found_in(marker_names)))

    return static if shared(static) > shared(own) else own


def _from_table(path: Path, table: dict[str, object]) -> MarkerMap:
    roles = table.get("roles")
    if not isinstance(roles, dict) or not roles or set(table) != {"roles"}:
        raise file_error(
            path,
            "does not hold the one table [roles]",
            'write [roles], then lines such as sacrum = "SACR"',
        )
    alternatives = tuple(_alternatives(path, role, entry) for role, entry in roles.items())
    try:
        return MarkerMap(path.stem, tuple(roles), alternatives, by_words=path.stem == _COMMON)
    except LegsimError as error:
        raise file_error(
            path, str(error), "correct the name of the role", place="[roles]"
        ) from error


def _alternatives(path: Path, role: str, entry: Any) -> tuple[tuple[str, ...], ...]:
    """Alternatives of labels to average, from one label, a list of labels, or a list of lists."""
    nested = isinstance(entry, list) and entry and all(isinstance(part, list) for part in entry)
    result = tuple(_labels(part) for part in entry) if nested else (_labels(entry),)
    if not all(result):
        raise file_error(
            path,
            f"role {role} is given {entry!r}",
            "give a label, a list of labels, or a list of lists of labels",
            place="[roles]",
        )
    return result


def _labels(entry: Any) -> tuple[str, ...]:
    """Labels to average, none where ``entry`` is neither a label nor a list of labels."""
    labels = entry if isinstance(entry, list) else [entry]
    return tuple(labels) if all(isinstance(label, str) and label for label in labels) else ()
