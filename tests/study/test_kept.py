"""Kept scores are those that were computed, or are computed again."""

import json

import pytest

from legsim.study import kept


def once():
    """Counts how often it is called."""
    calls = []

    def compute():
        calls.append(1)
        return [{"a": 1.5, "b": (1, 2), "c": float("nan")}]

    return calls, compute


def test_the_first_time_gives_what_the_next_ones_read(tmp_path):
    calls, compute = once()
    first = kept.entries(tmp_path / "scores/a.json", "key", compute)
    again = kept.entries(tmp_path / "scores/a.json", "key", compute)
    assert json.dumps(first) == json.dumps(again) == '[{"a": 1.5, "b": [1, 2], "c": NaN}]'
    assert len(calls) == 1


def test_another_key_computes_anew(tmp_path):
    path = tmp_path / "a.json"
    kept.entries(path, "key", lambda: [{"a": 1.5}])
    assert kept.entries(path, "other", lambda: [{"a": 2.5}]) == [{"a": 2.5}]
    assert kept.entries(path, "other", lambda: [{"a": 3.5}]) == [{"a": 2.5}]


@pytest.mark.parametrize(
    "damage",
    [
        lambda text: "",
        lambda text: text[:-9],
        lambda text: "[]",
        lambda text: '"key"',
        lambda text: text.replace("1.5", "1.25"),
        lambda text: text.replace('"entries"', '"entry"'),
        lambda text: text.replace('"sha256"', '"sha"'),
        lambda text: "[" * 100_000,
        lambda text: "\udcff",
    ],
)
def test_a_damaged_file_is_computed_anew(tmp_path, damage):
    path = tmp_path / "a.json"
    calls, compute = once()
    whole = kept.entries(path, "key", compute)
    text = path.read_text("utf-8")
    path.write_bytes(damage(text).encode("utf-8", "surrogateescape"))
    assert json.dumps(kept.entries(path, "key", compute)) == json.dumps(whole)
    assert len(calls) == 2
    assert path.read_text("utf-8") == text
