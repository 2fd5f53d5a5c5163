"""OpenCL runtimes made known to the loader: the environment's, NVIDIA's, the system's.

Runtimes from PyPI register themselves badly: Intel's ``.icd`` files hold a dummy path and nothing
points the loader at the environment's folder. Containers often have NVIDIA's driver without its
``.icd`` file. :func:`register` therefore writes a folder of correct ``.icd`` files and names it in
``OCL_ICD_VENDORS`` before the loader reads it, once, at the first platform query.
"""

import hashlib
import importlib.util
import os
import sys
import warnings
from functools import cache
from pathlib import Path

from legsim.core import files
from legsim.opencl.caches import own_folder

_SYSTEM = Path("/etc/OpenCL/vendors")

_MADE = "legsim-icd"
"""how the names of the folders begin that are made here"""

_NVIDIA = "libnvidia-opencl.so.1"

_NVIDIA_FOLDERS = (
    *("/usr/lib64", "/usr/lib", "/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu"),
    *("/usr/local/nvidia/lib64", "/usr/local/nvidia/lib", "/usr/local/cuda/compat"),
    *("/usr/lib/wsl/lib", "/run/opengl-driver/lib", "/.singularity.d/libs", "/lib64"),
)
"""where drivers are mounted in containers, besides LD_LIBRARY_PATH"""


@cache
def register() -> str:
    """Points the ICD loader at the runtimes that are here; returns the setting.

    A user's own setting stays. Where the system's own list is complete, it is left to the loader.
    """
    if "OCL_ICD_VENDORS" in os.environ:
        return os.environ["OCL_ICD_VENDORS"]
    entries = {f"env-{k}.icd": f"{path}\n" for k, path in enumerate(_in_environment())}
    system = sorted(_SYSTEM.glob("*.icd"))
    listed = {path.name: _text(path) for path in system}
    driver = _nvidia_driver()
    if driver is not None and not any("nvidia" in text for text in listed.values()):
        entries["nvidia.icd"] = f"{driver}\n"
    if not entries:
        return ""
    entries |= listed
    name = hashlib.sha256(str(sorted(entries.items())).encode()).hexdigest()[:12]
    folder = own_folder(f"{_MADE}-{name}")
    if folder is None:
        warnings.warn(
            "no folder for temporary files can be written, so that OpenCL runtimes inside the "
            "environment are not found; set TMPDIR to a folder that can",
            stacklevel=2,
        )
        return ""
    for entry, content in entries.items():
        if not (folder / entry).exists() or _text(folder / entry) != content:
            files.write_text(folder / entry, content)
    os.environ["OCL_ICD_VENDORS"] = str(folder)
    return str(folder)


def fault() -> str:
    """What is wrong with OCL_ICD_VENDORS, with the fix; empty where it is not set.

    To be asked where the loader lists no device that works.
    """
    named = os.environ.get("OCL_ICD_VENDORS")
    if named is None or Path(named).name.startswith(_MADE):
        return ""
    return f"OCL_ICD_VENDORS is {named!r}: {_wrong_with(named)}; unset it"


def installation(machine: str, system: str) -> str:
    """How to get an OpenCL runtime for a machine's CPU, as platform.machine() and sys.platform name
    it; PyPI has one for x86-64 alone.
    """
    if machine in ("x86_64", "AMD64") and system != "darwin":
        return "pip install intel-opencl-rt intel-cmplr-lib-rt"
    if system == "linux":
        return "apt install pocl-opencl-icd, or conda install -c conda-forge pocl"
    return "conda install -c conda-forge pocl"


def _wrong_with(named: str) -> str:
    place = Path(named)
    if not named or not place.exists():
        return "there is no such folder"
    entries = sorted(place.glob("*.icd")) if place.is_dir() else [place]
    if not entries:
        return "it holds no .icd file"
    libraries = [_text(path).strip() for path in entries]
    gone = [name for name in libraries if os.path.isabs(name) and not Path(name).exists()]
    if gone:
        return f"it names {gone[0]}, which is not there"
    return f"it names {', '.join(libraries)}, which offers no device"


def _in_environment() -> list[Path]:
    """Libraries of the runtimes that are installed in the environment: Intel's and PoCL's."""
    found = [
        Path(sys.prefix, "lib", "libintelocl.so"),
        Path(sys.prefix, "Library", "bin", "intelocl64.dll"),
    ]
    spec = importlib.util.find_spec("pyopencl")
    if spec is not None and spec.origin is not None:
        found += sorted(Path(spec.origin).parent.glob(".libs/libpocl*.so*"))
    return [path for path in found if path.exists()]


def _nvidia_driver() -> Path | None:
    """NVIDIA's OpenCL library, where a driver is here."""
    named = [p for p in os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep) if p]
    for folder in (*named, *_NVIDIA_FOLDERS):
        if Path(folder, _NVIDIA).exists():
            return Path(folder, _NVIDIA)
    return None


def _text(path: Path) -> str:
    try:
        return path.read_text("utf-8", "replace")
    except OSError:
        return ""
