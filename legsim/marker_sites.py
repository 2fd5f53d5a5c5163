"""The shipped table of marker places on the unscaled leg model, by role (models/lower_body/markers.toml)."""

import tomllib

import numpy as np

from legsim import resources
from legsim.anatomy import MarkerSites


def load() -> MarkerSites:
    """All known sites on the unscaled model: ``sacrum`` and, for each side, ``asis_r``, ``epicondyle_lateral_r``, ``heel_l`` and so on."""
    table = _table()
    entries = [(e["role"], e["segment"], e["position"], e["weight"]) for e in table["midline"]]
    for e in [*table["paired"], *_numbered(table)]:
        for side, sign in (("r", 1.0), ("l", -1.0)):
            segment = e["segment"] if e["segment"] == "pelvis" else f"{e['segment']}_{side}"
            entries.append((f"{e['role']}_{side}", segment, np.array(e["position"]) * (1.0, 1.0, sign), e["weight"]))
    names, segments, positions, weights = zip(*entries, strict=True)
    return MarkerSites(names, segments, np.array(positions), np.array(weights))


def calibrated_roles() -> frozenset[str]:
    """Roles whose place differs between laboratories and is taken from the recording (:func:`legsim.replay.calibrate`)."""
    table = _table()
    paired = [e["role"] for e in [*table["paired"], *_numbered(table)] if e.get("calibrated", False)]
    return frozenset(f"{role}_{side}" for role in paired for side in "rl")


def _numbered(table: dict) -> list[dict]:
    return [{**e, "role": f"{e['role']}_{k}", "calibrated": True} for e in table["clusters"] for k in range(10)]


def _table() -> dict:
    return tomllib.loads(resources.model_file("lower_body/markers.toml").read_text("utf-8"))
