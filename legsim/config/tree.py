"""TOML trees: read, overlaid, validated strictly as frozen sections."""

import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeVar, get_args

from pydantic import AfterValidator, BaseModel, ConfigDict, PositiveFloat, ValidationError

from legsim.core.errors import LegsimError


class ConfigSection(BaseModel):
    """A part of the configuration: frozen, and strict about its keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    has_overrides: ClassVar[bool] = False
    """whether --set reaches its keys by their names"""


def _rising(band: tuple[float, float]) -> tuple[float, float]:
    if not band[0] < band[1]:
        raise ValueError("a band goes from a lower to a higher frequency")
    return band


Band = Annotated[tuple[PositiveFloat, PositiveFloat], AfterValidator(_rising)]
"""Hz, from a lower to a higher frequency"""

_Model = TypeVar("_Model", bound=ConfigSection)


def validated(model: type[_Model], tree: dict[str, Any], where: Path | None) -> _Model:
    """Validates the tree as a configuration of type ``model``.

    Raises:
        LegsimError: a key or value that is not allowed; the line names file and key.
    """
    try:
        return model.model_validate(tree)
    except ValidationError as error:
        raise LegsimError(_explain(error, model, where)) from error


def of_options(model: type[_Model], given: Mapping[str, Any]) -> _Model:
    """Validates the options of a command line as a section.

    Raises:
        LegsimError: a value that is not allowed; the line names the option.
    """
    try:
        return model.model_validate(dict(given))
    except ValidationError as error:
        first = error.errors()[0]
        option = "--" + str(first["loc"][0]).replace("_", "-")
        problem = first["msg"][:1].lower() + first["msg"][1:]
        raise LegsimError(
            f"{option} {first['input']}: {problem}; give another value, or leave it out"
        ) from error


def parse_override(text: str, model: type[ConfigSection] | None = None) -> dict[str, Any]:
    """Parses ``section.key=value`` as a tree.

    The value is in TOML's notation, or bare text; where ``model`` takes a text there, ``1`` and
    ``2024-01-01`` are texts.
    """
    key, separator, value = text.partition("=")
    parts = key.strip().split(".")
    if not separator or not all(parts):
        raise LegsimError(f"--set {text}: expected section.key=value, as in --set scan.views=124")
    try:
        parsed: Any = tomllib.loads(f"v = {value.strip()}")["v"]
    except (tomllib.TOMLDecodeError, RecursionError):
        parsed = value.strip()
    if not isinstance(parsed, str) and model is not None and _takes_text(model, parts):
        parsed = value.strip()
    tree: Any = parsed
    for part in reversed(parts):
        tree = {part: tree}
    return tree


def _takes_text(model: type[ConfigSection], parts: list[str]) -> bool:
    """Whether the key of that path is a text and nothing else."""
    section = model
    for part in parts[:-1]:
        field = section.model_fields.get(part)
        section = None if field is None else next(_sections_in(field.annotation), None)
        if section is None:
            return False
    field = section.model_fields.get(parts[-1])
    return field is not None and field.annotation is str


def merged(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """Overlays ``base`` by ``over``, section by section."""
    result = dict(base)
    for key, value in over.items():
        nested = isinstance(value, dict) and isinstance(result.get(key), dict)
        result[key] = merged(result[key], value) if nested else value
    return result


def _explain(error: ValidationError, model: type[ConfigSection], path: Path | None) -> str:
    # a misspelled key comes with a missing one: the misspelling is what to report
    first = min(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    place = ".".join(str(part) for part in first["loc"])
    where = f"{path or 'configuration'} ({place})"
    if first["type"] == "extra_forbidden":
        return f"{where}: unknown key; {_valid_keys(model, first['loc'])}"
    more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
    override = f" or with --set {place}=..." if model.has_overrides else ""
    return (
        f"{where}: {first['msg']}, not {first['input']!r}{more}; fix the value in the "
        f"file{override}"
    )


def _valid_keys(model: type[ConfigSection], location: tuple[int | str, ...]) -> str:
    section = model
    for part in location[:-1]:
        if isinstance(part, str) and part in section.model_fields:
            section = next(_sections_in(section.model_fields[part].annotation), section)
    return f"valid here: {', '.join(section.model_fields)}"


def _sections_in(annotation: Any) -> Iterator[type[ConfigSection]]:
    """Sections that a field's type names, also inside a tuple or next to None."""
    if isinstance(annotation, type) and issubclass(annotation, ConfigSection):
        yield annotation
    for part in get_args(annotation):
        yield from _sections_in(part)
