"""The damage is seeded, does something, and what must not be is reported with its input."""

import os
import signal
import warnings

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from tools.fuzz import corpus, engine, law, samples
from tools.fuzz.damage import damaged
from tools.fuzz.readers import READERS, Reader


def test_damage_is_seeded_and_changes_most_files():
    data, others = b"time_s,a,b\n0,1,2\n1,3,4\n", (b"time_s,c\n7,8\n",)
    made = [damaged(data, np.random.default_rng([1, k]), others) for k in range(300)]
    assert made == [damaged(data, np.random.default_rng([1, k]), others) for k in range(300)]
    assert len(set(made)) > 200
    assert all(isinstance(damaged(b"", np.random.default_rng(k)), bytes) for k in range(50))


@pytest.mark.parametrize("name", READERS)
def test_every_reader_reads_or_refuses_damaged_files(name):
    pytest.importorskip("pydicom") if "dicom" in name else None
    found, firsts = engine.fuzz(name, 15, seed=3)
    assert found.keys() <= {law.READ, law.REFUSED}, firsts


@pytest.mark.parametrize("name", READERS)
def test_every_reader_reads_or_refuses_the_kept_files(name, tmp_path):
    pytest.importorskip("pydicom") if "dicom" in name else None
    reader, path = READERS[name], engine.file_of(READERS[name], tmp_path)
    engine.samples(reader, path)
    with law.watched():
        for data in corpus.load(name):
            path.write_bytes(data)
            assert law.outcome(reader, path) in (law.READ, law.REFUSED)


def test_most_quick_readers_have_kept_files():
    assert {"trc", "c3d", "osim", "rtk_xml", "results"} <= {n for n in READERS if corpus.load(n)}


def test_kept_files_come_back_and_equal_ones_make_equal_archives(tmp_path):
    corpus.save("x", (b"bb", b"", b"a"), tmp_path)
    assert corpus.load("x", tmp_path) == (b"", b"a", b"bb")
    first = (tmp_path / "x.tar.xz").read_bytes()
    corpus.save("x", (b"a", b"bb", b""), tmp_path)
    assert (tmp_path / "x.tar.xz").read_bytes() == first
    assert corpus.load("y", tmp_path) == ()


def test_guided_damage_reaches_new_code_and_keeps_what_did(tmp_path):
    pytest.importorskip("atheris")
    with engine.in_memory() as folder:
        valid = engine.samples(READERS["view_times"], folder / "file.txt")
    found, firsts = engine.guided("view_times", 300, 1, seconds=60, kept=tmp_path)
    assert found.total() >= 300
    assert found.keys() <= {law.READ, law.REFUSED}, firsts
    assert (kept := corpus.load("view_times", tmp_path))
    assert not set(kept) & set(valid)


def load(path):
    """Does what a reader must not, by the length of the file."""
    content = path.read_bytes()
    if len(content) == 50:
        return 1.0
    if len(content) < 40:
        os.kill(os.getpid(), signal.SIGKILL)
    if len(content) < 50:
        return {"a": [np.array([1.0, np.inf])]}
    if len(content) > 60:
        raise KeyError
    if content.count(b"a") == 25:
        warnings.warn("overflow", RuntimeWarning, stacklevel=1)
    warnings.warn("a note", stacklevel=1)
    raise LegsimError("no")


def test_what_must_not_be_is_counted_and_kept(monkeypatch, tmp_path):
    monkeypatch.setitem(READERS, "x", Reader(".x", load, (samples.content(25 * b"a "),)))
    found, firsts = engine.fuzz("x", 400, seed=0)
    assert found.total() == 400
    assert {what.partition(" at ")[0] for what in found} == {
        *(law.READ, law.REFUSED, "KeyError", "RuntimeWarning", "inf in value"),
        "ended by signal 9",
    }
    assert set(firsts) == found.keys() - {law.READ, law.REFUSED}
    engine.keep(tmp_path, "x", firsts)
    assert len(list(tmp_path.glob("x-*.x"))) == len(firsts)


@pytest.mark.parametrize(
    ("value", "may_hold", "said"),
    [
        (np.array([1.0, np.nan]), "", "nan in value"),
        (np.array([1.0, np.nan]), "nan", ""),
        (np.array([1.0, np.nan, np.inf]), "nan", "inf in value"),
        ({"a": (1, "nan", float("inf"))}, "", "inf in value"),
        (samples.markers(), "", ""),
    ],
)
def test_numbers_that_are_not_finite_are_found_wherever_they_are(value, may_hold, said):
    assert law.unfit(value, may_hold) == said


def test_a_reader_that_does_not_end_is_ended(monkeypatch, tmp_path):
    def hang(_):
        while True:
            try:
                while True:
                    pass
            except Exception:
                pass

    monkeypatch.setattr(law, "LIMIT_S", 1)
    with law.watched():
        assert law.outcome(Reader(".x", hang, ()), tmp_path / "x").startswith("_TooLongError")
