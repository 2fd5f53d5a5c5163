"""The settings of a study: which recordings, which methods, which noise; read strictly from
STUDY.toml.
"""

from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from legsim import config
from legsim.config import ConfigSection, RunConfig
from legsim.core.errors import LegsimError, file_error
from legsim.core.files import is_file, load_toml
from legsim.imu.calibration import CalibrationKind
from legsim.imu.noise import Convention
from legsim.study.results import NoiseLevel

Exponent = float | Literal["none"]
"""of a factor of noise; "none" for no noise"""

_SHIPPED = Path(__file__).parent / "shipped"


class NoiseRuns(ConfigSection):
    """Reconstructions from noisy signals, beside those from clean ones."""

    levels: tuple[tuple[Exponent, Exponent], ...] = Field(min_length=1)
    """[f_a, f_g]: the sensor's RMS is divided by 10^f_a and 10^f_g"""
    convention: Convention
    methods: tuple[str, ...] = Field(default=("rigid",), min_length=1)
    repetitions: int = Field(default=1, ge=1)

    def noise(self) -> tuple[NoiseLevel, ...]:
        """The levels as values."""
        return tuple(
            NoiseLevel(self.convention, exponent(f_a), exponent(f_g)) for f_a, f_g in self.levels
        )


class Ladder(ConfigSection):
    """Estimates of motion from noisy signals against the noise-free estimate; nothing is
    reconstructed.
    """

    subjects: tuple[str, ...] = ()
    """empty: the study's"""
    postures: tuple[str, ...] = ()
    """empty: the study's"""
    sensor: str = "shank_l"
    f_a: tuple[Exponent, ...] = Field(default=(0.0, 1.0, 2.0, 3.0, 4.0, 5.0, "none"), min_length=1)
    f_g: tuple[Exponent, ...] = Field(default=(0.0, 1.0, 2.0, 3.0, 4.0, 5.0, "none"), min_length=1)
    conventions: tuple[Convention, ...] = Field(default=("SI", "per-sample"), min_length=1)
    repetitions: int = Field(default=5, ge=1)
    sensors: tuple[str, ...] = ()
    """sensors of the catalogue, or TOML files of sensors, beside the ladder"""
    calibrations: tuple[CalibrationKind, ...] = Field(
        default=("none", "rest", "six-positions"), min_length=1
    )
    """before the scan; of ``sensors``"""


Aid = Literal[
    "uncorrected", "dead-reckoning", "standing", "beads-1", "beads-2", "beads-4", "fiducials"
]
"""what helps a sensor: nothing followed, nothing but the sensor, a person who stands, and that with
beads on the skin or points in the sensor"""


class Aiding(ConfigSection):
    """Sensors with what aids them, against the true motion of the bone that carries them."""

    sensors: tuple[str, ...] = Field(default=("bmi160", "none"), min_length=1)
    """of the catalogue, or TOML files of sensors; "none" is free of errors"""
    aids: tuple[Aid, ...] = Field(
        default=("uncorrected", "dead-reckoning", "standing", "beads-1", "beads-2", "fiducials"),
        min_length=1,
    )
    """estimates of motion from exact shadows with noise; nothing is reconstructed"""
    repetitions: int = Field(default=3, ge=1)
    volume_sensors: tuple[str, ...] = ()
    """sensors with which volumes are reconstructed too"""
    volume_methods: tuple[str, ...] = ()
    volume_repetitions: int = Field(default=1, ge=1)


def exponent(written: Exponent) -> float | None:
    """None for no noise."""
    return None if written == "none" else written


class StudyConfig(ConfigSection):
    """Subjects x postures x methods, and what noise does to them."""

    name: str = Field(pattern=r"^[A-Za-z0-9_.-]+$")
    title: str
    preset: Literal["demo", "half", "paper"] = "half"
    subjects: tuple[str, ...] = Field(min_length=1)
    postures: tuple[str, ...] = Field(min_length=1)
    recording: str = "{subject}/{posture}.trc"
    """path of a recording, relative to the STUDY.toml, or its name among those that come with
    legsim
    """
    recordings: tuple[str, ...] = ()
    """further recordings, one scan each: FOLDER/NAME.trc is posture NAME of subject FOLDER"""
    methods: tuple[str, ...] = ()
    """compared on clean signals in every scan; none for a study of the ladder alone"""
    settings: dict[str, Any] = Field(default_factory=dict)
    """sections of a run's configuration, laid over the preset"""
    noise: tuple[NoiseRuns, ...] = ()
    ladder: Ladder | None = None
    aiding: Aiding | None = None

    def scans(self) -> tuple[tuple[str, str], ...]:
        """Subject and posture of every scan."""
        own = [(subject, posture) for subject in self.subjects for posture in self.postures]
        return (*own, *map(_who, self.recordings))

    def recording_of(self, subject: str, posture: str) -> str:
        """The recording of one scan."""
        further = (r for r in self.recordings if _who(r) == (subject, posture))
        return next(further, self.recording.format(subject=subject, posture=posture))


def _who(recording: str) -> tuple[str, str]:
    """Subject and posture of a further recording, by its folder and name."""
    path = Path(recording)
    return path.parent.name or path.stem, path.stem


def load(
    path: str,
    *,
    preset: str | None = None,
    overrides: tuple[str, ...] = (),
    recordings: tuple[str, ...] = (),
) -> tuple[StudyConfig, Path]:
    """The study in a TOML file, or the shipped one of that name, and the folder that its paths are
    relative to.

    Args:
        preset: instead of the file's.
        overrides: ``section.key=value`` of the runs' configuration, laid over the file's settings.
        recordings: further ones, relative to where the command runs.

    Raises:
        LegsimError: no such study, or a key or value that is not allowed.
    """
    file = _find(path)
    tree = load_toml(file)
    if preset is not None:
        tree["preset"] = preset
    if recordings:
        further = [str(Path(recording).resolve()) for recording in recordings]
        tree["recordings"] = [*tree.get("recordings", ()), *further]
    for override in overrides:
        tree["settings"] = config.merged(
            tree.get("settings", {}), config.parse_override(override, config.RunConfig)
        )
    study = config.validated(StudyConfig, tree, file)
    _check_asked(study, file)
    _check_settings(study, file)
    _check_recording(study, file)
    _check_levels(study, file)
    return _anchored(study, file.parent), file.parent


def _check_asked(study: StudyConfig, file: Path) -> None:
    """Refuses a study of nothing, or of things that need others."""
    if not (study.methods or study.ladder or study.aiding):
        raise file_error(
            file, "asks for nothing", 'name methods = ["rigid", ...], a [ladder] or [aiding]'
        )
    if study.aiding and bool(study.aiding.volume_sensors) != bool(study.aiding.volume_methods):
        raise file_error(
            file,
            "asks for volumes of sensors without methods, or of methods without sensors",
            "give both aiding.volume_sensors and aiding.volume_methods, or neither",
        )
    if study.noise and not study.methods:
        raise file_error(
            file,
            "asks for noisy reconstructions but for no clean ones to compare with",
            'name methods = ["rigid"]',
        )


def _check_recording(study: StudyConfig, file: Path) -> None:
    try:
        study.recording.format(subject="", posture="")
    except (LookupError, ValueError) as error:
        cure = "it may hold {subject} and {posture}, and no other braces"
        raise file_error(
            file, f"recording = {study.recording!r} cannot be filled in ({error!r})", cure
        ) from None


def _check_levels(study: StudyConfig, file: Path) -> None:
    levels = [level for n in study.noise for level in n.noise()]
    twice = next((level for level in levels if levels.count(level) > 1), None)
    if twice is not None:
        raise file_error(
            file,
            f"[[noise]] has {twice.label} twice",
            "name each level once, with all methods that it is tried on",
        )


def _anchored(study: StudyConfig, base: Path) -> StudyConfig:
    """The same study with its own files by their whole paths, so that it can be read from
    anywhere.
    """
    tree = study.model_dump()
    further = ((), ()) if study.ladder is None else (study.ladder.subjects, study.ladder.postures)
    scans = [(s, p) for s in (*study.subjects, *further[0]) for p in (*study.postures, *further[1])]
    found = all(is_file(base / study.recording.format(subject=s, posture=p)) for s, p in scans)
    if found and not Path(study.recording).is_absolute():
        tree["recording"] = f"{base}/".replace("{", "{{").replace("}", "}}") + study.recording
    for holder in (tree, *tree["noise"]):
        holder["methods"] = tuple(
            _beside(base, m, m.rpartition(":")[0]) if ".py:" in m else m for m in holder["methods"]
        )
    for section, key in (
        ("ladder", "sensors"),
        ("aiding", "sensors"),
        ("aiding", "volume_sensors"),
    ):
        if tree[section] is not None:
            named = tree[section][key]
            tree[section][key] = tuple(
                _beside(base, s, s if s.endswith(".toml") else "") for s in named
            )
    tree["recordings"] = tuple(_beside(base, r, r) for r in tree["recordings"])
    for *section, key in config.FILES:
        inside = tree["settings"]
        for name in section:
            inside = inside.get(name, {})
        if isinstance(inside.get(key), str):
            inside[key] = _beside(base, inside[key], inside[key])
    return StudyConfig.model_validate(tree)


def _beside(base: Path, written: str, file: str) -> str:
    return str(base / written) if file and is_file(base / file) else written


def _check_settings(study: StudyConfig, file: Path) -> None:
    """Refuses settings that no run can have, and those that every run has from the study itself."""
    config.from_trees(study.preset, study.settings, where=Path(f"{file} [settings]"))
    for section, key, instead in (("motion", "file", "recording"), ("methods", "run", "methods")):
        if key in study.settings.get(section, {}):
            raise file_error(
                file,
                f"settings.{section}.{key} is not used by a study",
                f"write {instead} = ... at the top of the file instead",
            )


def _find(path: str) -> Path:
    if is_file(path):
        return Path(path).resolve()
    if path in shipped():
        return _SHIPPED / f"{path}.toml"
    raise LegsimError(
        f"{path}: no such file; give a STUDY.toml, or the name of a study that comes with legsim: "
        f"{', '.join(shipped())}"
    )


def shipped() -> tuple[str, ...]:
    """Names of the studies that come with legsim."""
    return tuple(sorted(p.stem for p in _SHIPPED.glob("*.toml")))


def run_settings(
    study: StudyConfig,
    base: Path,
    subject: str,
    posture: str,
    noise: NoiseLevel | None,
    seed: int | None,
    sensor: str = "",
) -> RunConfig:
    """The configuration of one run.

    Args:
        base: folder that the study's paths are relative to.
        noise: None for clean sensors, and the methods that are compared on them.
        seed: of the noise; None keeps the settings'.
        sensor: of the catalogue, with the methods that its volumes are made by; empty keeps the
            settings'.
    """
    file = study.recording_of(subject, posture)
    named = base / file
    trees: list[dict[str, Any]] = [
        study.settings,
        {"motion": {"file": str(named) if is_file(named) else file}},
    ]
    methods = study.methods
    if noise is not None:
        methods = next(n.methods for n in study.noise if noise in n.noise())
        trees[0] = _of_kind("paper", trees[0])
        trees.append({"imu": {"noise": _noise_tree(noise)}})
    if sensor and study.aiding is not None:
        methods = study.aiding.volume_methods
        trees[0] = _of_kind(sensor, trees[0])
        trees.append({"imu": {"noise": {"kind": sensor}}})
    if seed is not None:
        trees.append({"seed": seed})
    trees.append({"methods": {"run": ["static", *methods]}})
    return config.from_trees(study.preset, *trees, where=Path(study.name))


def _of_kind(kind: str, tree: dict[str, Any]) -> dict[str, Any]:
    """Settings without the keys of [imu.noise] that say nothing of this kind of noise."""
    noise = tree.get("imu", {}).get("noise", {})
    kept = {key: value for key, value in noise.items() if key in config.noise_keys(kind)}
    return {**tree, "imu": {**tree.get("imu", {}), "noise": kept}}


def _noise_tree(noise: NoiseLevel) -> dict[str, Any]:
    written = {"f_a": noise.f_a, "f_g": noise.f_g}
    return {
        "kind": "paper",
        "convention": noise.convention,
        **{k: "none" if v is None else v for k, v in written.items()},
    }
