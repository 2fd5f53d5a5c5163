"""What decides the numbers of a stage besides settings and files: its code and its libraries.

A stage's key holds the content of the modules that make its output and of all that they import
within legsim, with the OpenCL kernels, templates and models that these name, and the versions of
the libraries that compute in them. Imports are read from the source, also those inside functions.
"""

import hashlib
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from pathlib import Path

from legsim.core.errors import file_error
from legsim.core.files import key_of, sha256

PACKAGE = Path(__file__).parents[1]

_LIBRARIES = {
    **{name: name for name in ("numpy", "scipy", "mujoco", "trimesh", "xraylib", "spekpy")},
    "skimage": "scikit-image",
    "SimpleITK": "SimpleITK",
    "pyopencl": "pyopencl",
}
"""imported name and distribution of the libraries whose version can change a number"""

_IMPORT = re.compile(
    r"^[ \t]*(?:from[ \t]+([.\w]+)[ \t]+import[ \t]*(\([^)]*\)|[^\n#]*)|import[ \t]+([^\n#]+))",
    re.M,
)
_LAZY = re.compile(r"""lazy_loader\.load\(\s*["']([\w.]+)["']""")
_BESIDE = {
    re.compile(r"""["'](\w+\.cl)["']"""): "opencl/kernels",
    re.compile(r"""["']([\w.]+\.j2)["']"""): "report/templates",
}
"""names of files in the source that are no modules, and their folder"""


@dataclass(frozen=True, slots=True)
class Code:
    """The modules that make the output of a stage."""

    followed: tuple[str, ...]
    """modules, or packages with all their modules, taken with all that they import"""
    alone: tuple[str, ...] = ()
    """modules taken without their imports: they pass values between those that are followed"""


STAGES = {
    "kinematics": Code(
        ("kinematics.from_recording", "kinematics.osim_export", "mocap.opensim", "mocap.trc"),
        ("run.stages", "run.files", "run.motion"),
    ),
    "imu": Code(("imu",), ("run.sensors", "run.files", "run.stages")),
    "projections": Code(
        (
            *("scan.acquisition", "scan.c_arm", "phantom.leg_phantom"),
            *("kinematics.joint_splines", "geometry.files", "geometry.image_files"),
        ),
        ("simulation.setup", "simulation.simulated_scan", "run.c_arm", "run.stages"),
    ),
    "tissue_swing": Code(("phantom.tissue_swing",), ("run.sensors",)),
    "fdk": Code(("reconstruction.fdk",)),
    "cgls": Code(("reconstruction.cgls",)),
    "tv": Code(("reconstruction.total_variation",)),
    "volume": Code(
        ("deformation.files", "geometry.image_files", "correction.method"),
        ("run.volumes", "run.reconstruction", "run.methods", "run.c_arm", "run.corrected"),
    ),
    "correction": Code(("correction", "imu", "simulation.simulated_scan"), ("run.stages",)),
    "scores": Code(
        ("evaluation", "deformation.files", "phantom.voxelize", "phantom.leg_phantom"),
        ("run.scores", "run.corrected", "simulation.setup"),
    ),
    "placed": Code(
        ("correction.image_warp", "deformation.models"), ("run.corrected", "run.reconstruction")
    ),
    "correct": Code(("run.correct",)),
    "presentation": Code(("run.pipeline",)),
    "replay": Code(("run.replay",)),
    "study": Code(("run.pipeline",), ("study.jobs",)),
    "aided": Code(
        (
            *("correction", "imu", "kinematics.from_recording", "scan.c_arm"),
            *("phantom.leg_phantom", "phantom.imaged_leg", "phantom.tissue_swing"),
            "evaluation.residual_motion",
        ),
        (
            *("study.aiding", "simulation.setup", "run.scores", "run.volumes", "run.stages"),
            *("run.c_arm", "run.sensors", "run.motion"),
        ),
    ),
    "ladder": Code(
        ("imu", "kinematics.from_recording", "scan.c_arm"),
        ("study.jobs", "run.c_arm", "run.sensors", "run.motion"),
    ),
}
"""Code of each stage, by the part of a key that it decides"""


@dataclass(frozen=True, slots=True)
class _Source:
    """What one file of the package says of itself."""

    digest: str
    imports: frozenset[str]
    """dotted names; ``from a import b`` counts as a.b; relative ones begin with dots"""
    beside: frozenset[str]
    """places of kernels and templates"""
    models: frozenset[str]
    """folders below models/ with which some string begins"""
    libraries: frozenset[str]
    """distributions that compute in it"""


def _source(path: Path, model: re.Pattern[str]) -> _Source:
    data = path.read_bytes()
    text = data.decode("utf-8")
    imports: set[str] = set(_LAZY.findall(text))
    for origin, names, plain in _IMPORT.findall(text):
        listed = [part.split()[0] for part in _listed(names or plain)]
        dotted = origin if origin.endswith(".") else f"{origin}."
        imports |= {f"{dotted}{name}" for name in listed} if origin else set(listed)
    tops = {name.partition(".")[0] for name in imports} & _LIBRARIES.keys()
    libraries = {_LIBRARIES[name] for name in tops}
    beside = [f"{place}/{name}" for kind, place in _BESIDE.items() for name in kind.findall(text)]
    found = (imports, beside, model.findall(text), libraries)
    return _Source(hashlib.sha256(data).hexdigest(), *map(frozenset, found))


def _listed(names: str) -> list[str]:
    plain = re.sub(r"#[^\n]*", "", names).strip("() \t\n")
    return [part.strip() for part in plain.split(",") if part.strip()]


@cache
def _hash(path: Path, _changed_ns: int, _size: int) -> str:
    return sha256(path)


def _stamp(path: Path | str) -> tuple[int, int]:
    status = os.stat(path)
    return status.st_mtime_ns, status.st_size


def _stamps(root: Path) -> dict[str, tuple[int, int]]:
    """When the files of the code below a folder were changed, and their sizes, by path in it."""
    found = {}
    for folder, _, inside in os.walk(root):
        for name in inside:
            if name.endswith((".py", ".pyi", ".cl", ".j2")):
                path = Path(folder, name)
                found[path.relative_to(root).as_posix()] = _stamp(path)
    return found


class CodeTree:
    """The files of one copy of legsim."""

    def __init__(self, package: Path = PACKAGE) -> None:
        """Notes what the files are now, which is what this process runs."""
        self.package = package
        self._loaded = _stamps(package)
        self._modules: dict[str, str] = {}
        for file in self._loaded:
            if file.endswith(".py"):
                name = file.removesuffix(".py").removesuffix("__init__").rstrip("/")
                self._modules[name.replace("/", ".")] = file
        self._sources: dict[str, _Source] = {}
        self._closures: dict[Code, frozenset[str]] = {}
        self._faces: dict[tuple[str, ...], dict[str, str]] = {}
        models = (package / "data" / "models", package.parent / "models")
        self._models = next((folder for folder in models if folder.is_dir()), None)
        inside = () if self._models is None else self._models.iterdir()
        folders = "|".join(sorted(re.escape(path.name) for path in inside if path.is_dir()))
        self._model = re.compile(rf"""["']({folders or "-"})(?=[/"'])""")

    def fingerprint(self, *codes: Code) -> str:
        """Hash of the code, which is the same wherever the same files are.

        Raises:
            LegsimError: a file was changed since this process loaded it: its results are not those
                of the file.
        """
        versions = {name: _version(name) for name in self.libraries(*codes)}
        return key_of(self.files(*codes), versions)

    def files(self, *codes: Code) -> dict[str, str]:
        """Hash of every module, kernel and model file, by its path in the package."""
        sources = {file: self._read(file) for file in self._closure(*codes)}
        beside = {place for one in sources.values() for place in one.beside}
        sources |= {place: self._read(place) for place in beside & self._loaded.keys()}
        for file in sources:
            self._check(file)
        found = {file: source.digest for file, source in sources.items()}
        for folder in {name for source in sources.values() for name in source.models}:
            for path in () if self._models is None else (self._models / folder).glob("*"):
                if path.is_file() and path.suffix != ".md":
                    found[f"models/{folder}/{path.name}"] = _hash(path, *_stamp(path))
        return found

    def libraries(self, *codes: Code) -> set[str]:
        """Distributions that compute in this code."""
        return set().union(*(self._read(file).libraries for file in self._closure(*codes)))

    def _closure(self, *codes: Code) -> frozenset[str]:
        """Files of the modules and of all that they import."""
        for code in codes:
            if code not in self._closures:
                waiting = [one for name in code.followed for one in self._with_inner(name)]
                found: set[str] = set()
                while waiting:
                    name = waiting.pop()
                    if name not in found:
                        found.add(name)
                        waiting += self._imported(name)
                names = found | set(code.alone)
                self._closures[code] = frozenset(self._modules[name] for name in names)
        return frozenset[str]().union(*(self._closures[code] for code in codes))

    def _with_inner(self, name: str) -> list[str]:
        return [one for one in self._modules if one == name or one.startswith(f"{name}.")]

    def _imported(self, name: str) -> Iterator[str]:
        file = self._modules[name]
        home = name.split(".") if file.endswith("__init__.py") else name.split(".")[:-1]
        for imported in self._read(file).imports:
            if imported.startswith("."):
                dots = len(imported) - len(imported.lstrip("."))
                base = home[: len(home) - dots + 1]
                yield from self.resolved(*base, *imported.lstrip(".").split("."))
            elif imported.split(".")[0] == "legsim":
                yield from self.resolved(*imported.split(".")[1:])

    def resolved(self, *parts: str) -> list[str]:
        """Modules that a dotted name below legsim stands for.

        A name of a package's face is the module that defines it; a package alone is all that its
        face names.
        """
        for count in range(len(parts), -1, -1):
            name = ".".join(parts[:count])
            if name not in self._modules:
                continue
            if not self._modules[name].endswith("__init__.py"):
                return [name]
            face = self._face(parts[:count])
            defining = {face.get(parts[count], "")} if count < len(parts) else set(face.values())
            return [name, *sorted(defining & self._modules.keys() - {name, ""})]
        return []

    def _face(self, package: tuple[str, ...]) -> dict[str, str]:
        """Names that a package's stub offers, and the modules that define them."""
        stub = "/".join([*package, "__init__.pyi"])
        if package not in self._faces:
            names = self._read(stub).imports if stub in self._loaded else ()
            found = {}
            for module, _, name in (name.lstrip(".").rpartition(".") for name in names):
                home = (*package, *module.split("."))
                # a name that comes from the face of a package below
                found[name] = self._face(home).get(name, ".".join(home)) if module else ""
            self._faces[package] = found
        return self._faces[package]

    def _read(self, file: str) -> _Source:
        if file not in self._sources:
            self._check(file)
            self._sources[file] = _source(self.package / file, self._model)
        return self._sources[file]

    def _check(self, file: str) -> None:
        path = os.path.join(self.package, file)
        if not os.path.exists(path) or _stamp(path) != self._loaded[file]:
            raise file_error(
                path,
                "was changed since this process loaded legsim, so that results would not be those "
                "of the file",
                "start it again; finished stages are kept",
            )


@cache
def _version(distribution: str) -> str:
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return "none"


_TREE = CodeTree()


def fingerprint(*stages: str) -> str:
    """Hash of the code of stages, names of :data:`STAGES`; errors as in the class."""
    return _TREE.fingerprint(*(STAGES[stage] for stage in stages))


def fingerprint_of(*names: str) -> str:
    """Hash of what dotted names that begin with "legsim" stand for, and of all that it imports."""
    found = [module for name in names for module in _TREE.resolved(*name.split(".")[1:])]
    return _TREE.fingerprint(Code(tuple(dict.fromkeys(found))))
