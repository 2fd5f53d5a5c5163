import os
from pathlib import Path

from legsim.core import errors
from legsim.core.errors import file_error, printable


def test_the_line_names_file_place_problem_and_cure():
    assert (
        str(errors.file_error("a.trc", "no number", "fix it", place="line 3"))
        == "a.trc (line 3): no number; fix it"
    )
    assert str(errors.file_error("a.trc", "no number", "fix it")) == "a.trc: no number; fix it"


def test_a_name_that_is_no_utf8_becomes_text_that_can_be_encoded():
    name = os.fsdecode(b"bad\xff.trc")
    assert printable(name) == "bad\N{REPLACEMENT CHARACTER}.trc"
    str(file_error(name, "is bad", "rename it")).encode()
    assert printable(Path("Größe.trc")) == "Größe.trc"


def test_a_message_is_one_line_whatever_a_file_holds():
    odd = "a\nb\r\x0b\x1b[31m\u2028\x85c é ∞"
    line = str(errors.file_error("a.csv", f"{odd} is no number", "fix it"))
    assert len(line.splitlines()) == 1
    assert line.isprintable()
    assert line.startswith("a.csv: a b")
    assert "c é ∞ is no number" in line
