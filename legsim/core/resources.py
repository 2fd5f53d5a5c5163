"""Where the files that ship with legsim are: models/ and motions/.

They are in a checkout or inside the installed package.
"""

import os
from collections.abc import Callable
from pathlib import Path

from legsim.core.errors import LegsimError

_PACKAGE = Path(__file__).parents[1]


def model_file(name: str) -> Path:
    """Finds a file below models/, for instance ``lower_body/lower_body.xml``.

    Raises:
        LegsimError: the file did not come with this installation.
    """
    return _find("models", name)


def motion_file(name: str) -> Path:
    """Finds a file below motions/.

    Raises:
        LegsimError: the file did not come with this installation; the message lists the known ones.
    """
    return _find("motions", name, os.path.isfile)


def _find(folder: str, name: str, is_there: Callable[[Path], bool] = os.path.exists) -> Path:
    # a wheel has the folders inside the package; a checkout (also an editable one) next to it
    roots = [_PACKAGE / "data" / folder, _PACKAGE.parent / folder]
    for root in roots:
        if is_there(root / name):  # Path.exists raises where a name is too long
            return root / name
    there = sorted(
        str(p.relative_to(r))
        for r in roots
        if r.is_dir()
        for p in r.glob("*")
        if not p.name.startswith(".")
    )
    raise LegsimError(
        f"{folder}/{name} is not part of this legsim installation; known: "
        f"{', '.join(there) or 'none'}; reinstall legsim"
    )
