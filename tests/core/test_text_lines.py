"""Text files from any system give the same lines."""

import pytest

from legsim.core import files
from legsim.core.errors import LegsimError


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_every_line_end_gives_the_same_lines(tmp_path, end):
    path = tmp_path / "file.trc"
    path.write_bytes(f"a\tb{end}c{end}".encode())
    assert files.read(path, "TRC") == ["a\tb", "c", ""]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "latin-1", "utf-16"])
def test_umlauts_survive_in_every_encoding(tmp_path, encoding):
    path = tmp_path / "file.trc"
    path.write_bytes("Hüfte\n".encode(encoding))
    assert files.read(path, "TRC") == ["Hüfte", ""]


@pytest.mark.parametrize(
    ("content", "problem"), [(b"", "empty"), (b" \n", "empty"), (b"a\0b", "binary data")]
)
def test_what_is_no_text_is_refused(tmp_path, content, problem):
    path = tmp_path / "file.trc"
    path.write_bytes(content)
    with pytest.raises(LegsimError, match=problem):
        files.read(path, "TRC")


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(LegsimError, match=r"none\.trc: cannot be read \(No such file"):
        files.read(tmp_path / "none.trc", "TRC")
