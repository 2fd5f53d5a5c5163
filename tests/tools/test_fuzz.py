"""The damage is seeded, does something, and what must not be is reported with its input."""

import os
import signal

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from tools import fuzz


def test_damage_is_seeded_and_changes_most_files():
    data = b"time_s,a,b\n0,1,2\n1,3,4\n"
    made = [fuzz.damaged(data, np.random.default_rng([1, k])) for k in range(300)]
    assert made == [fuzz.damaged(data, np.random.default_rng([1, k])) for k in range(300)]
    assert len(set(made)) > 250
    assert all(isinstance(fuzz.damaged(b"", np.random.default_rng(k)), bytes) for k in range(50))


@pytest.mark.parametrize("name", fuzz.READERS)
def test_every_reader_reads_or_refuses_damaged_files(name):
    pytest.importorskip("ezc3d") if name == "c3d" else None
    found, firsts = fuzz.fuzz(name, 15, seed=3)
    assert found.keys() <= {"read", "refused"}, firsts


def test_what_must_not_be_is_counted_and_kept(monkeypatch):
    def load(path):
        content = path.read_bytes()
        if len(content) < 40:
            os.kill(os.getpid(), signal.SIGKILL)
        if len(content) > 60:
            raise KeyError
        raise LegsimError("no")

    reader = fuzz.Reader(".x", lambda p: p.write_bytes(50 * b"a ") and None, load)
    monkeypatch.setitem(fuzz.READERS, "x", reader)
    monkeypatch.setattr(fuzz, "_check_valid", lambda *_: None)
    found, firsts = fuzz.fuzz("x", 200, seed=0)
    assert sum(found.values()) == 200
    assert {what.partition(" at ")[0] for what in found} == {
        "refused",
        "KeyError",
        "the process ended by signal 9",
    }
    assert set(firsts) == found.keys() - {"refused"}
