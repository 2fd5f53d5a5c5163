"""Files of other kinds are refused with what they are and what to give instead; text is not."""

import gzip
import io
import zipfile

import pytest

from legsim.core import other_kinds
from legsim.core.errors import LegsimError

TEXT = "PathFileType\t4\t(X/Y/Z)\tPK walk.trc\n" + 300 * "1\t0.01\t0.5\n"


def zipped(name: str) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr(name, TEXT)
    return stream.getvalue()


LFS = "is a pointer of Git LFS, without the content; fetch it by git lfs pull"


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (gzip.compress(TEXT.encode(), mtime=0), r"is packed \(gzip\); unpack it"),
        (zipped("walk.trc"), r"is a packed archive \(zip\); unpack it"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a2\nsize 12345\n", LFS),
        (zipped("xl/workbook.xml"), "is a spreadsheet; save its table as text or CSV"),
        (b"MATLAB 5.0 MAT-file", "is MATLAB's; save"),
        (b"\x89HDF\r\n\x1a\n", "is HDF5; save"),
        (b"Kaydara FBX Binary  \0", r"animation \(FBX\); export the markers as C3D or TRC"),
        (b"HIERARCHY\nROOT Hips\n", "without markers; export the markers"),
        (b'\xef\xbb\xbf<?xml version="1.0"?>\n<mvnx version="4">', "is MVN's XML; export"),
        (TEXT.encode("utf-16-le"), "in UTF-16 without the mark that says so; save it as UTF-8"),
        (TEXT.encode("utf-16-be"), "in UTF-16 without the mark that says so; save it as UTF-8"),
    ],
)
def test_a_file_of_another_kind_is_refused_by_its_name(content, said):
    with pytest.raises(LegsimError, match=rf"walk.trc: .*{said}"):
        other_kinds.refuse("walk.trc", content)


def test_a_program_s_own_file_is_told_by_its_ending():
    with pytest.raises(LegsimError, match="is of the kind that Motive keeps for itself; export"):
        other_kinds.refuse("a/Take 1.TAK", b"anything\0")
    other_kinds.refuse("walk.trb", TEXT.encode())


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "latin-1", "utf-16"])
def test_text_is_passed(encoding):
    other_kinds.refuse("walk.trc", TEXT.encode(encoding))
    other_kinds.refuse("mvn.csv", ("a note on <mvnx\n" + TEXT).encode(encoding))
    other_kinds.refuse("short", b"")
    other_kinds.refuse("numbers.raw", bytes(100))
