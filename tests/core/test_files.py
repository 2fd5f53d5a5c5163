import errno
import importlib
import os
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from legsim.core import files
from legsim.core.errors import LegsimError
from legsim.geometry.files import read_geometry
from legsim.geometry.label_images import load_label_image
from legsim.geometry.projection_images import RawLayout, read_images
from legsim.mocap import files as mocap_files
from legsim.phantom import label_lists, mesh_files


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_what_breaks_off_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, error: type[BaseException]
) -> None:
    files.write_text(tmp_path / "a.txt", "old")
    with pytest.raises(error), files.whole(tmp_path / "a.txt") as partial:
        assert (partial.parent, partial.suffix) == (tmp_path, ".txt")
        partial.write_text("half")
        raise error
    assert (tmp_path / "a.txt").read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_the_file_is_not_there_before_it_is_whole(tmp_path: Path) -> None:
    with files.whole(tmp_path / "a.bin") as partial:
        partial.write_bytes(b"all of it")
        assert not (tmp_path / "a.bin").exists()
    assert (tmp_path / "a.bin").read_bytes() == b"all of it"


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full here")
def test_a_full_disk_is_one_line_and_leaves_the_old_file(tmp_path: Path) -> None:
    files.write_text(tmp_path / "a.txt", "old")
    with (
        pytest.raises(LegsimError, match=r"a\.txt: the disk is full; free some space"),
        files.whole(tmp_path / "a.txt") as partial,
    ):
        partial.symlink_to("/dev/full")
        with partial.open("w") as stream:
            stream.write("new" * 10000)
    assert (tmp_path / "a.txt").read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


@pytest.mark.parametrize("place", ["missing/a.txt", "file/a.txt", "folder"])
def test_a_place_that_cannot_be_written_is_named(tmp_path: Path, place: str) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "folder").mkdir()
    with pytest.raises(LegsimError, match=rf"{place}: cannot be written \(.*folder exists"):
        files.write_text(tmp_path / place, "text")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "folder"]


def test_errors_about_other_files_stay_as_they_are(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="elsewhere"), files.whole(tmp_path / "a.txt"):
        (tmp_path / "elsewhere").read_text()


def test_text_is_utf8_with_the_lines_as_given(tmp_path: Path) -> None:
    files.write_text(tmp_path / "a.txt", "Hüfte\nKnie\r\n")
    assert (tmp_path / "a.txt").read_bytes() == "Hüfte\nKnie\r\n".encode()
    files.write_bytes(tmp_path / "a.txt", b"\r\n\0")
    assert (tmp_path / "a.txt").read_bytes() == b"\r\n\0"


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


@pytest.mark.parametrize("content", [b"\xef\xbb\xbf", b"\xff\xfe", b"\xfe\xff", b"\xef\xbb\xbf \n"])
def test_a_file_of_a_byte_order_mark_alone_is_empty(tmp_path, content):
    (tmp_path / "x").write_bytes(content)
    with pytest.raises(LegsimError, match="the file is empty"):
        files.read(tmp_path / "x", "CSV")


def test_what_is_being_read_is_not_written_over_under_any_name(tmp_path: Path) -> None:
    source, soft, hard = (tmp_path / name for name in ("a.txt", "soft.txt", "hard.txt"))
    source.write_text("mine")
    soft.symlink_to(source)
    hard.hardlink_to(source)
    with files.reading([tmp_path, tmp_path / "none"]):
        for path in (source, soft, hard, tmp_path / "." / "a.txt"):
            with pytest.raises(LegsimError, match=r"\.txt: is a file that is read here"):
                files.write_text(path, "other")
        files.write_text(tmp_path / "new.txt", "other")
    assert source.read_text() == "mine"
    files.write_text(source, "other")
    assert (source.read_text(), hard.read_text()) == ("other", "mine")


@pytest.mark.parametrize("change", [(b"(3,)", b"(3, "), (b"<f8", b"|O "), (b"(3,)", b"(9,)")])
def test_a_broken_npy_is_refused(tmp_path: Path, change) -> None:
    path = tmp_path / "a.npy"
    np.save(path, np.arange(3.0))
    np.testing.assert_array_equal(files.load_npy(path, "x"), np.arange(3))
    path.write_bytes(path.read_bytes().replace(*change))
    with pytest.raises(LegsimError, match=r"a\.npy: is not an \.npy file"):
        files.load_npy(path, "export it again")
    with pytest.raises(LegsimError, match="cannot be read"):
        files.load_npy(tmp_path, "export it again")


def test_toml_is_read_with_a_byte_order_mark_and_refused_in_one_line(tmp_path):
    path = tmp_path / "a.toml"
    path.write_bytes(b"\xef\xbb\xbfa = 1\n")
    assert files.load_toml(path) == {"a": 1}
    path.write_text("a = \n")
    with pytest.raises(LegsimError, match=r"a\.toml.* is not TOML .*; mend it"):
        files.load_toml(path, "mend it")
    path.write_bytes(b"a = '\xff'\n")
    with pytest.raises(LegsimError, match="is not TOML"):
        files.load_toml(path)
    with pytest.raises(LegsimError, match=r"no such file; give the path of a TOML file"):
        files.load_toml(tmp_path / "none.toml")
    with pytest.raises(LegsimError, match=r"cannot be read .*; give the path of a TOML file"):
        files.load_toml(tmp_path)
    path.write_text("a = " + 100_000 * "[")
    with pytest.raises(LegsimError, match=r"is not TOML .*recursion"):
        files.load_toml(path)


def test_a_name_that_no_file_can_have_is_no_file(tmp_path):
    (tmp_path / "a").touch()
    assert files.is_file(tmp_path / "a")
    assert not files.is_file(tmp_path)
    assert not files.is_file(tmp_path / (300 * "a"))
    assert not files.is_file("a\0b")


def test_a_name_that_no_file_can_have_is_refused_in_one_line():
    for read in (lambda p: files.read(p, "TRC"), files.content, files.load_toml):
        with pytest.raises(
            LegsimError, match=r"(cannot be read|no such file).*; (check|give) the path"
        ):
            read(Path("a\0b"))


def test_a_file_that_may_not_be_read_is_refused_in_one_line_by_every_reader(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(path: Path, *_: object, **__: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    readers: dict[str, Callable[[Path], object]] = {
        "a.txt": files.refuse_packed,
        "a.stl": lambda path: mesh_files.read(path, "a"),
        "a.vtp": lambda path: mesh_files.read(path, "a"),
        "a.json": read_geometry,
        "a.xml": read_geometry,
        "a.nrrd": load_label_image,
        "a.mha": load_label_image,
        "a.nii.gz": load_label_image,
        "a.ctbl": label_lists.read,
        "a.c3d": mocap_files.format_of,
        "a.tif": read_images,
        "a.dcm": read_images,
        "a.raw": lambda path: read_images(path, raw=RawLayout("<u2", 1, 1, 1)),
    }
    for name in readers:
        (tmp_path / name).write_bytes(b"x")
    monkeypatch.setattr(Path, "open", refused)
    for name, read in readers.items():
        with pytest.raises(LegsimError, match=rf"{name}.*: cannot be read \(Permission denied"):
            read(tmp_path / name)


@pytest.mark.parametrize("module", ["gzip", "bz2", "lzma"])
def test_a_packed_file_is_to_be_unpacked(tmp_path: Path, module: str) -> None:
    path = tmp_path / "a.toml"
    path.write_bytes(importlib.import_module(module).compress(b"a = 1"))
    for read in (files.content, files.load_toml, lambda p: files.read(p, "CSV")):
        with pytest.raises(LegsimError, match=r"a\.toml: is packed \(.*\); unpack it"):
            read(path)


def test_a_spreadsheet_is_to_be_exported(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.xlsx", "w") as archive:
        archive.writestr("xl/workbook.xml", "")
    with pytest.raises(LegsimError, match="is a spreadsheet; save its table as text"):
        files.read(tmp_path / "a.xlsx", "CSV")
