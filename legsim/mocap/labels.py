"""Which label of a recording plays which role on the body, and how labels are found in spite of
prefixes and spelling.
"""

import re
import unicodedata
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from itertools import combinations

from legsim.core.errors import LegsimError

PAPER_ROLES = (
    "sacrum",
    *(
        f"{part}_{side}"
        for part in ("asis", "epicondyle_lateral", "malleolus_lateral")
        for side in "rl"
    ),
)
"""The seven markers that suffice for the lower body: sacrum, front of the pelvis, outer knees and
ankles.
"""

SEGMENT_OF_PART = {
    **dict.fromkeys(("sacrum", "asis", "psis", "iliac_crest"), "pelvis"),
    **dict.fromkeys(
        ("greater_trochanter", "epicondyle_lateral", "epicondyle_medial", "patella_superior"),
        "femur",
    ),
    **dict.fromkeys(
        ("malleolus_lateral", "malleolus_medial", "tibial_tuberosity", "fibula_head"), "tibia"
    ),
    **dict.fromkeys(
        (
            "heel",
            "meta1",
            "meta5",
            "midfoot_superior",
            "midfoot_lateral",
            "toe_lateral",
            "toe_medial",
        ),
        "calcn",
    ),
    "toe": "calcn",
}
"""Part of the body that a role names, and the segment (OpenSim body) that carries it."""

_BETWEEN = "_.:- "
"""what stands between a marker's name and that of somebody or something else"""

_NUMBERED = re.compile(r"\A\d+\s*[-.)]\s*(?=[^\W\d])")
"""before all labels of a list that is counted, as "3 - R_Knee\""""

_WORDS = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+|[^\W\d_a-zA-Z]+")
"""of a label, as "R", "Knee" and "Lat" of RKneeLat; letters of another alphabet are one too"""

_SAME_WORDS = {
    word: short
    for short, words in {
        "r": "right rt rechts dx destra destro droite droit derecha derecho",
        "l": "left lt links sx sinistra sinistro gauche izquierda izquierdo",
        "lat": "lateral lateralis laterale out outer outside external externe externo externa ext "
        "esterno esterna aussen aussere ausserer",
        "med": "medial medialis mediale in inner inside internal interne interno interna int "
        "innen innere innerer",
        "asis": "sias eias",
        "psis": "sips eips",
        "epi": "epicondyle epicond",
        "condyle": "cond con",
        "femoral": "fem femur",
        "mal": "mall malleolus malleole malleolo maleolo",
        "knee": "knie genou ginocchio rodilla",
        "ankle": "ank knochel knoechel cheville caviglia tobillo",
        "heel": "hee calc calcaneus ferse talon tallone",
    }.items()
    for word in words.split()
}
"""words that mean one, in the languages that laboratories label in, without accents"""

_JOINT = re.compile(
    r"j?(?:r|l|right|left)?(hip|knee|ankle)(?:r|l|right|left)?(?:jc|cent(?:er|re))?"
)

_NO_LANDMARKS = (
    "hips, knees and ankles alone are taken for the joint centers of a pose estimator or a body "
    "model, no landmarks; give the markers that OpenCap and Pose2Sim add to them (r.ASIS_study, "
    "...), joint angles (.mot), or markers on the pelvis with a marker map (TOML)"
)

_CLUSTER = re.compile(r"(thigh|shank|foot)_(\d|upper|front|rear)")

_CLUSTER_SEGMENT = {"thigh": "femur", "shank": "tibia", "foot": "calcn"}


@dataclass(frozen=True, slots=True)
class MarkerMap:
    """Roles on the body and the labels that play them in one marker set."""

    name: str
    roles: tuple[str, ...]
    alternatives: tuple[tuple[tuple[str, ...], ...], ...]
    """for each role, in order of preference: labels whose mean plays it"""
    segments: tuple[str, ...] = ()
    """of each role, for roles of a user's own model; empty: :func:`segment_of` knows them"""
    by_words: bool = False
    """whether labels are also found by their words, in any order and language"""

    def __post_init__(self) -> None:
        if len(self.roles) != len(self.alternatives):
            raise LegsimError(
                f"marker map {self.name!r}: {len(self.roles)} roles need as many entries; got "
                f"{len(self.alternatives)}"
            )
        doubles = sorted({role for role in self.roles if self.roles.count(role) > 1})
        if doubles:
            raise LegsimError(
                f"marker map {self.name!r}: role {doubles[0]} is there twice; keep one"
            )
        for role in self.roles:
            self.segment(role)

    @classmethod
    def one_to_one(
        cls, name: str, roles: Sequence[str], labels: Sequence[str], segments: Sequence[str] = ()
    ) -> "MarkerMap":
        """The plain case: each role is played by one label."""
        return cls(name, tuple(roles), tuple(((label,),) for label in labels), tuple(segments))

    def segment(self, role: str) -> str:
        """Body of the leg model that carries a role.

        Raises:
            LegsimError: no such role is known.
        """
        return self.segments[self.roles.index(role)] if self.segments else segment_of(role)

    def found_in(self, marker_names: Sequence[str]) -> dict[str, tuple[str, ...]]:
        """Role to the recording's own labels whose mean plays it, for the roles that the recording
        covers.
        """
        finder = _Finder(marker_names, by_words=self.by_words)
        found = {}
        for role, alternatives in zip(self.roles, self.alternatives, strict=True):
            for labels in alternatives:
                names = tuple(finder.find(label) for label in labels)
                if all(names):
                    found[role] = names
                    break
        return found

    def without(self, roles: Collection[str]) -> "MarkerMap":
        """The same map with some of the roles left out."""
        keep = [k for k, role in enumerate(self.roles) if role not in roles]
        return MarkerMap(
            self.name,
            tuple(self.roles[k] for k in keep),
            tuple(self.alternatives[k] for k in keep),
            tuple(self.segments[k] for k in keep) if self.segments else (),
            self.by_words,
        )

    def missing_in(
        self, marker_names: Sequence[str], required: Sequence[str] = PAPER_ROLES
    ) -> tuple[str, ...]:
        """Required roles that the recording does not cover; two posterior spines do for the
        sacrum, whose place is the middle of them.
        """
        found = {*self.found_in(marker_names)}
        if {"psis_r", "psis_l"} <= found:
            found.add("sacrum")
        return tuple(role for role in required if role not in found)

    def means_in(self, marker_names: Sequence[str]) -> tuple[str, ...]:
        """Roles that are means of markers which play roles of their own on the same segment, so
        that they add nothing, as a sacrum between the two posterior spines.
        """
        found = self.found_in(marker_names)
        alone = {
            (labels[0], self.segment(role)) for role, labels in found.items() if len(labels) == 1
        }
        return tuple(
            role
            for role, labels in found.items()
            if len(labels) > 1 and {(label, self.segment(role)) for label in labels} <= alone
        )


def find_labels(names: Sequence[str], marker_names: Sequence[str]) -> dict[str, str]:
    """Name to the recording's own label, for those names that the recording has."""
    finder = _Finder(marker_names)
    found = {name: finder.find(name) for name in names}
    return {name: label for name, label in found.items() if label}


def same_label(one: str, other: str) -> bool:
    """Whether two labels differ at most in case, punctuation and a subject's prefix."""
    return _plain(one.rpartition(":")[2]) == _plain(other.rpartition(":")[2])


def without_shared_ends(names: Sequence[str]) -> list[str]:
    """Names without what all of several begin or end with, up to a blank, a point or the like: a
    subject ("S01_RASI"), a count or a quantity ("RASI.pos"). Points without a name ("*17") stay,
    and so does what would have none left.
    """
    named = [name for name in names if not name.startswith("*")]
    if len(set(named)) < 2:
        return list(names)
    prefix, suffix = _begin(named), _begin([name[::-1] for name in named])[::-1]
    start = max((k + 1 for k, c in enumerate(prefix) if c in _BETWEEN), default=0)
    end = min((k for k, c in enumerate(suffix) if c in _BETWEEN), default=len(suffix))
    cut = {name: name[start : len(name) - len(suffix) + end] for name in named}
    return [cut.get(name) or name for name in names]


def _begin(names: Sequence[str]) -> str:
    """What all names begin with: where the first and the last in order do not part, none does."""
    first, last = min(names), max(names)
    shared = zip(first, last, strict=False)
    return first[: next((k for k, (a, b) in enumerate(shared) if a != b), len(first))]


def segment_of(role: str) -> str:
    """Body of the leg model that carries a role, such as ``tibia_r``.

    Raises:
        LegsimError: no such role is known; the message lists them.
    """
    part, _, side = role.rpartition("_")
    if role == "sacrum":
        return "pelvis"
    if side in ("r", "l"):
        cluster = _CLUSTER.fullmatch(part)
        if cluster:
            return f"{_CLUSTER_SEGMENT[cluster[1]]}_{side}"
        if part in SEGMENT_OF_PART and part != "sacrum":
            segment = SEGMENT_OF_PART[part]
            return segment if segment == "pelvis" else f"{segment}_{side}"
    known = ", ".join(f"{name}_r" for name in SEGMENT_OF_PART if name != "sacrum")
    raise LegsimError(
        f"no role is named {role!r}; there are sacrum, {known}, thigh_1_r, shank_1_r, foot_1_r "
        "and so on, with _l on the left"
    )


def guess(
    maps: Sequence[MarkerMap], marker_names: Sequence[str], *, required: Sequence[str] = PAPER_ROLES
) -> MarkerMap:
    """The map that covers the required roles and, among those that do, most roles in all; the first
    of equals.

    Raises:
        LegsimError: none covers the required roles; the message names the nearest, what it lacks,
            and the labels there are.
    """
    scores = [
        (
            -len(m.missing_in(marker_names, required)),
            len(m.found_in(marker_names)),
            -len(m.roles),
            -k,
        )
        for k, m in enumerate(maps)
    ]
    best = maps[max(range(len(maps)), key=lambda k: scores[k])]
    people = _people(maps, marker_names, required)
    if len(people) > 1:
        raise LegsimError(
            f"the labels tell of {len(people)} people "
            f"({', '.join(name or 'without a prefix' for name in people)}): export one of them, "
            "or give a marker map (TOML) "
            f"with whole labels, as in sacrum = {next(filter(None, people)) + ':SACR'!r}"
        )
    if not best.found_in(marker_names) and _are_joint_centers(marker_names):
        raise LegsimError(f"no landmarks among {_listed(marker_names)}: {_NO_LANDMARKS}")
    if not best.found_in(marker_names):
        raise LegsimError(
            f"no marker set knows any of the markers {_listed(marker_names)}; give a marker map "
            f"(TOML) with {', '.join(required)}"
        )
    check_covered(best, marker_names, required)
    return best


def _people(
    maps: Sequence[MarkerMap], marker_names: Sequence[str], required: Sequence[str]
) -> list[str]:
    """Prefixes of labels (``Name:LABEL``, or none) under each of which some map finds most of what
    is required, so that each is a person, if not a whole one.
    """
    owned: dict[str, list[str]] = {}
    for name in marker_names:
        owned.setdefault(name.rpartition(":")[0], []).append(name)
    if len(owned) < 2 or not required:
        return []
    few = len(required) // 2
    return [
        p
        for p, names in owned.items()
        if any(len(m.missing_in(names, required)) <= few for m in maps)
    ]


def check_covered(
    marker_map: MarkerMap, marker_names: Sequence[str], required: Sequence[str] = PAPER_ROLES
) -> None:
    """Refuses a recording that lacks required roles.

    Raises:
        LegsimError: names the roles that are missing and the labels there are.
    """
    missing = marker_map.missing_in(marker_names, required)
    if missing:
        nearest = f"marker set {marker_map.name!r} finds no marker for " + ", ".join(missing)
        twice = sorted({name.rpartition("#")[0] for name in marker_names if "#" in name})
        if twice:
            nearest += f" (several markers are called {', '.join(twice[:5])}: none is taken)"
        if _are_joint_centers(marker_names) and any(role.startswith("asis") for role in missing):
            raise LegsimError(f"{nearest} among {_listed(marker_names)}: {_NO_LANDMARKS}")
        shown_elsewhere = (
            ", or name the static trial that shows them, as in --set motion.scaling_file=static.trc"
            if len(missing) < len(required)
            else ""
        )
        raise LegsimError(
            f"{nearest} among {_listed(marker_names)}; give a marker map (TOML) with [roles] and "
            f"the labels that play them{shown_elsewhere}"
        )


def _are_joint_centers(marker_names: Sequence[str]) -> bool:
    """Whether labels are called after hips, knees and ankles, as by pose estimators (BODY_25,
    HALPE, COCO, BlazePose) and as MVN's joints (jRightKnee).
    """
    found = (_JOINT.fullmatch(_plain(name.rpartition(":")[2])) for name in marker_names)
    return {"hip", "knee", "ankle"} <= {match[1] for match in found if match}


def check_distinct(marker_map: MarkerMap, found: dict[str, tuple[str, ...]]) -> None:
    """Refuses a map that takes one marker for two places on the body.

    Two roles may share a marker only where one of them is a mean that the other is a part of, on
    the same segment, as a sacrum between the two posterior spines.

    Args:
        marker_map: the map, for the message.
        found: role to the recording's labels that play it, as :meth:`MarkerMap.found_in` gives it.

    Raises:
        LegsimError: names the label and the roles.
    """
    named = f"marker map {marker_map.name!r}"
    for role, labels in found.items():
        for label in labels:
            if labels.count(label) > 1:
                raise LegsimError(
                    f"{named}: {role} is the middle of {label} and {label}, one marker; name two"
                )
    for (first, one), (second, other) in combinations(found.items(), 2):
        shared = sorted(set(one) & set(other))
        if shared and (set(one) == set(other) or segment_of(first) != segment_of(second)):
            raise LegsimError(
                f"{named}: {' and '.join(shared)} plays both {first} and {second}; give each role "
                "a marker of its own"
            )


def _listed(names: Sequence[str], limit: int = 100) -> str:
    shown = ", ".join(name for name in names[:limit])
    return f"{shown} and {len(names) - limit} more" if len(names) > limit else shown


class _Finder:
    """Finds labels in one recording: as they are, without the subject's prefix, whatever the case
    and punctuation, then, if asked, whatever the order and language of their words.
    """

    def __init__(self, marker_names: Sequence[str], *, by_words: bool = False) -> None:
        named = [name for name in marker_names if not name.startswith("*")]
        own = dict(zip(named, without_shared_ends(named), strict=True))
        bare = {name: name.rpartition(":")[2] for name in named}
        texts = [bare, own]
        if all(_NUMBERED.match(text) for text in bare.values()):
            texts.append({name: _NUMBERED.sub("", text) for name, text in bare.items()})
        self._stages: list[tuple[Callable[[str], str], dict[str, str]]] = [
            (str, _unique({name: name for name in named})),
            *((str, _unique(text)) for text in texts),
        ]
        for key in (_plain, _words) if by_words else (_plain,):
            self._stages += [
                (key, _unique({name: key(t) for name, t in text.items()})) for text in texts
            ]

    def find(self, label: str) -> str:
        """The recording's own label, empty where there is none or more than one."""
        return next((stage[key(label)] for key, stage in self._stages if key(label) in stage), "")


def _plain(label: str) -> str:
    return re.sub(r"[\W_]", "", _unaccented(label).lower())


def _unaccented(label: str) -> str:
    """The same text with o for ö, e for é and ss for ß."""
    parts = unicodedata.normalize("NFKD", label.replace("ß", "ss"))
    return "".join(c for c in parts if not unicodedata.combining(c))


def _words(label: str) -> str:
    """The words of a label in order of the alphabet, each in its shortest form.

    Empty where they leave open what is meant: one word says no more than :func:`_plain`; a number
    belongs to the word before it (SH1_R is at the shoulder, R_SH_1 on the shank); an epicondyle
    that is not the knee's or the femur's is the elbow's as well.
    """
    found: list[str] = [word.lower() for word in _WORDS.findall(_unaccented(label))]
    words = sorted(_SAME_WORDS.get(word, word) for word in found)
    elbow = "epi" in words and not {"knee", "femoral"} & {*words}
    if len(words) < 2 or elbow or any(word.isdigit() for word in words):
        return ""
    return " ".join(words)


def _unique(key_of: dict[str, str]) -> dict[str, str]:
    """Key to name, for the keys that only one name has; an empty one is none."""
    keys = list(key_of.values())
    return {key: name for name, key in key_of.items() if key and keys.count(key) == 1}
