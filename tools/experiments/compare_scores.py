"""Whether two studies, or two runs, have the same numbers to the last digit.

Usage: python -m tools.experiments.compare_scores BEFORE AFTER (folders of studies or of runs)

Times, memory and paths differ between any two runs and are left out.
"""

import csv
import json
import sys
from pathlib import Path
from typing import Any

APART = {"seconds", "peak_bytes", "run", "folder"}


def numbers(folder: Path) -> dict[str, Any]:
    """Everything that a study or a run leaves as a number, by its place."""
    found: dict[str, Any] = {}
    for path in sorted(folder.glob("*.csv")):
        for row, cells in enumerate(csv.DictReader(path.open(encoding="utf-8"))):
            found |= {f"{path.name}[{row}].{k}": v for k, v in cells.items() if k not in APART}
    metrics = folder / "metrics.json"
    if metrics.is_file():
        found |= flat("metrics", json.loads(metrics.read_text("utf-8")))
    return found


def flat(place: str, value: Any) -> dict[str, Any]:
    """Leaves of a JSON tree by their path."""
    if isinstance(value, dict):
        inner = [(f"{place}.{k}", v) for k, v in value.items() if k not in APART]
    elif isinstance(value, list):
        inner = [(f"{place}[{k}]", v) for k, v in enumerate(value)]
    else:
        return {place: value}
    return {k: v for path, part in inner for k, v in flat(path, part).items()}


def main() -> None:
    """Prints what differs; exit code 1 where anything does."""
    before, after = (numbers(Path(argument)) for argument in sys.argv[1:3])
    if not before:
        sys.exit(f"{sys.argv[1]}: holds no numbers; give the folder of a study or of a run")
    places = sorted(before.keys() | after.keys())
    differing = [p for p in places if before.get(p) != after.get(p)]
    for place in differing:
        print(f"{place}: {before.get(place)} before, {after.get(place)} after")
    print(f"{len(places) - len(differing)} of {len(places)} values are equal")
    sys.exit(1 if differing else 0)


if __name__ == "__main__":
    main()
