"""Small valid files of runs and studies: their settings, and what they leave."""

import hashlib
import json
from pathlib import Path


def settings(path: Path) -> None:
    """Every setting of a run."""
    from legsim import config

    path.write_text(config.dump(config.RunConfig()), "utf-8")


def scan_toml(path: Path) -> None:
    """A measured scan and the files that it names."""
    from tests.examples import measured

    path.write_text(measured.write(path.parent / "scan").read_text())


def results(path: Path) -> None:
    """A study's results as they are written."""
    from legsim.study import results as study_results

    made = study_results.StudyResults(
        "a",
        "A",
        (),
        (),
        (("version", "1"),),
        ("one failed",),
        (study_results.StageCost("motion", 1, 2.0, None),),
    )
    study_results.save(path, made)
    tree = json.loads(path.read_text())
    tree["ladder"] = [
        {
            "subject": "s",
            "posture": "p",
            "repetition": 0,
            "translation_mm": 1.0,
            "rotation_deg": 2.0,
            "noise": {"convention": "SI", "f_a": 1.0, "f_g": None},
        }
    ]
    path.write_text(json.dumps(tree))


def manifest(path: Path) -> None:
    """A run folder's manifest."""
    from legsim.run.folder import RunFolder

    with RunFolder(path.parent / "run", {}) as folder:

        def write() -> tuple[str]:
            (folder.path / "a.txt").write_text("a")
            return ("a.txt",)

        folder.cached("one", "k", write)
    path.write_bytes((path.parent / "run/manifest.json").read_bytes())


def stored(path: Path) -> None:
    """What the store of finished stages says of one file, "a"."""
    digest = hashlib.sha256(b"a").hexdigest()
    about = {"a.txt": {"sha256": digest, "bytes": 1}}
    path.write_text(json.dumps({"key": "k", "seconds": 0.1, "peak_mib": 3, "files": about}))


def scores(path: Path) -> None:
    """What a study has kept."""
    from legsim.study import kept

    kept.entries(path, "k", lambda: [{"a": 1.0, "b": None}])


METHOD = """import json
from pathlib import Path

import numpy as np
from legsim import Correction

from . import weights


def correct(scan):
    table = json.loads(Path(__file__).with_name("table.json").read_text())
    return Correction(scan.projections, None, notes=[table["a"] + (1 if np.pi > 3 else 2)])
"""
