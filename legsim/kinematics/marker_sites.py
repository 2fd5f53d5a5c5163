"""The shipped table of marker places on the unscaled leg model, by role
(models/lower_body/markers.toml).
"""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from legsim.core import resources
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, frozen
from legsim.kinematics.skeleton import SegmentScales, segment_index


@dataclass(frozen=True, slots=True, eq=False)
class MarkerSites:
    """Where markers sit on the segments of one model."""

    names: tuple[str, ...]
    segments: tuple[str, ...]
    """(m,) segment that carries each marker"""
    positions: FloatArray
    """(m, 3) m, in the frame of that segment"""
    weights: FloatArray
    """(m,) weight of the squared distance in the least squares of
    :mod:`legsim.kinematics.inverse_kinematics`
    """

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", tuple(self.names))
        object.__setattr__(self, "segments", tuple(self.segments))
        if len(set(self.names)) != len(self.names):
            raise LegsimError(f"names of marker sites must differ; got {', '.join(self.names)}")
        for segment in self.segments:
            segment_index(segment)
        object.__setattr__(
            self, "positions", frozen("MarkerSites.positions", self.positions, (len(self.names), 3))
        )
        object.__setattr__(
            self, "weights", frozen("MarkerSites.weights", self.weights, (len(self.names),))
        )
        if len(self.segments) != len(self.names):
            raise LegsimError(
                f"{len(self.names)} marker sites need as many segments; got {len(self.segments)}"
            )
        if not (self.weights >= 0).all():
            raise LegsimError(f"marker weights must not be negative; got {self.weights.tolist()}")

    def position(self, name: str) -> FloatArray:
        """Position (3,) of one site in its segment's frame."""
        return self.positions[self.index(name)]

    def index(self, name: str) -> int:
        """Row of one site."""
        if name not in self.names:
            raise LegsimError(f"no marker site named {name!r}; there are: {', '.join(self.names)}")
        return self.names.index(name)

    def only(self, names: Sequence[str]) -> "MarkerSites":
        """The named sites, in the order of ``names``."""
        rows = [self.index(name) for name in names]
        return MarkerSites(
            tuple(names),
            tuple(self.segments[k] for k in rows),
            self.positions[rows],
            self.weights[rows],
        )

    def weighted(self, weights: Mapping[str, float]) -> "MarkerSites":
        """The same sites with other weights for those that are named; further names are ignored."""
        own = zip(self.names, self.weights, strict=True)
        changed = np.array([weights.get(name, weight) for name, weight in own], float)
        return MarkerSites(self.names, self.segments, self.positions, changed)

    def by_name(self) -> dict[str, float]:
        """The weights by name."""
        return dict(zip(self.names, map(float, self.weights), strict=True))

    def scaled(self, scales: SegmentScales) -> "MarkerSites":
        """The same places on the scaled segments."""
        factors = scales.factors[[segment_index(s) for s in self.segments]].reshape(-1, 3)
        return MarkerSites(self.names, self.segments, self.positions * factors, self.weights)


def load() -> MarkerSites:
    """All known sites on the unscaled model: ``sacrum`` and, for each side, ``asis_r``,
    ``epicondyle_lateral_r``, ``heel_l`` and so on.
    """
    table = _table()
    entries = [(e["role"], e["segment"], e["position"], e["weight"]) for e in table["midline"]]
    for e in [*table["paired"], *_numbered(table)]:
        for side, sign in (("r", 1.0), ("l", -1.0)):
            segment = e["segment"] if e["segment"] == "pelvis" else f"{e['segment']}_{side}"
            entries.append(
                (
                    f"{e['role']}_{side}",
                    segment,
                    np.array(e["position"]) * (1.0, 1.0, sign),
                    e["weight"],
                )
            )
    names, segments, positions, weights = zip(*entries, strict=True)
    return MarkerSites(names, segments, np.array(positions), np.array(weights))


def calibrated_roles() -> frozenset[str]:
    """Roles whose place differs between laboratories and is taken from the recording
    (:func:`legsim.kinematics.inverse_kinematics.calibrate`).
    """
    table = _table()
    paired = [
        e["role"] for e in [*table["paired"], *_numbered(table)] if e.get("calibrated", False)
    ]
    return frozenset(f"{role}_{side}" for role in paired for side in "rl")


def _numbered(table: dict) -> list[dict]:
    return [
        {**e, "role": f"{e['role']}_{k}", "calibrated": True}
        for e in table["clusters"]
        for k in range(10)
    ]


def _table() -> dict:
    return tomllib.loads(resources.model_file("lower_body/markers.toml").read_text("utf-8"))
