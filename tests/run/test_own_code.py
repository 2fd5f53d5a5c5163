"""The files of a user's own method: an edit of any of them is seen, and nothing else is looked at."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from legsim.core.errors import LegsimError
from legsim.run import methods, own_code

OWN = """
import numpy as np
from helper_of_mine import half

def method(scan):
    from package_of_mine.inner import deep
    kernel = open("kernel.cl").read()
    return half(scan) + deep(scan)
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A method with a helper, a package, a kernel, and files that it does not take."""
    written = {
        "own.py": OWN,
        "helper_of_mine.py": "from further_of_mine import half",
        "further_of_mine.py": "def half(scan): return 1",
        "package_of_mine/__init__.py": "",
        "package_of_mine/inner.py": "from .innermost import deep\nfrom . import beside",
        "package_of_mine/innermost.py": "def deep(scan): return 10",
        "package_of_mine/beside.py": "",
        "kernel.cl": "kernel",
        "unused_of_mine.py": "1/0",
        "numbers.csv": "1,2",
    }
    for name, text in written.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


@pytest.mark.parametrize(
    "file",
    [
        *("own.py", "helper_of_mine.py", "further_of_mine.py", "kernel.cl"),
        *(f"package_of_mine/{name}.py" for name in ("__init__", "inner", "innermost", "beside")),
    ],
)
def test_an_edit_of_what_the_method_takes_changes_its_fingerprint(folder, file):
    name = f"{folder / 'own.py'}:method"
    before = methods.fingerprint(name)
    (folder / file).write_text((folder / file).read_text() + "\n# edited\n")
    assert methods.fingerprint(name) != before


@pytest.mark.parametrize("file", ["unused_of_mine.py", "numbers.csv", "new.py"])
def test_other_files_beside_it_do_not_change_it(folder, file):
    before = own_code.fingerprint(folder / "own.py")
    (folder / file).write_text("edited")
    assert own_code.fingerprint(folder / "own.py") == before


def test_the_fingerprint_is_the_same_in_another_folder(folder, tmp_path_factory):
    other = tmp_path_factory.mktemp("other") / "moved"
    before = own_code.fingerprint(folder / "own.py")
    folder.rename(other)
    assert own_code.fingerprint(other / "own.py") == before


def test_what_it_takes_of_legsim_is_in_it(folder, monkeypatch):
    (folder / "further_of_mine.py").write_text("from legsim.imu.strapdown import integrate")
    before = own_code.fingerprint(folder / "own.py")
    asked = []
    monkeypatch.setattr(own_code.code, "fingerprint_of", lambda *n: asked.append(n) or "edited")
    assert own_code.fingerprint(folder / "own.py") != before
    assert asked == [("legsim.imu.strapdown.integrate",)]


def test_circles_and_files_that_cannot_be_parsed_end(folder):
    (folder / "further_of_mine.py").write_text("import own\nimport helper_of_mine\ndef half(")
    assert own_code.fingerprint(folder / "own.py")
    for content in (b"\xff\0", b"a = " + 10_000 * b"-" + b"1", b"a = " + 200_000 * b"-" + b"1"):
        (folder / "further_of_mine.py").write_bytes(content)
        assert own_code.fingerprint(folder / "own.py")


def test_names_that_no_file_can_have_name_none(folder):
    before = own_code.fingerprint(folder / "unused_of_mine.py")
    (folder / "unused_of_mine.py").write_text(f"1/0\nimport {300 * 'a'}.b\nc = 'd/{190 * 'e'}'\n")
    assert own_code.fingerprint(folder / "unused_of_mine.py") != before


def test_a_look_at_the_code_warns_of_nothing(folder):
    (folder / "further_of_mine.py").write_text("a = '\\d' is '\\d'\n")
    assert own_code.fingerprint(folder / "own.py")


def test_a_helper_is_imported_from_beside_and_anew_after_an_edit(folder):
    loaded, path = dict(sys.modules), list(sys.path)
    (folder / "own.py").write_text(OWN.replace('open("kernel.cl").read()', "1"))
    assert own_method(folder)(None) == 11
    (folder / "further_of_mine.py").write_text("def half(scan): return 222")
    (folder / "package_of_mine/innermost.py").write_text("def deep(scan): return 5000")
    assert own_method(folder)(None) == 5222
    assert (sys.modules, sys.path) == (loaded, path), "the caller's imports are changed"


def test_methods_with_helpers_of_one_name_keep_their_own(folder, tmp_path_factory):
    """Also those that are imported when the method is called, and those that the caller has."""
    other = tmp_path_factory.mktemp("other")
    text = "def method(scan):\n    import helper_of_mine\n    return helper_of_mine.half(scan)"
    for place, answer in ((folder, 1), (other, 2)):
        (place / "own.py").write_text(text)
        (place / "helper_of_mine.py").write_text(f"def half(scan): return {answer}")
    first, second = own_method(folder), own_method(other)
    assert [method(None) for method in (first, second, first, second)] == [1, 2, 1, 2]


def test_a_helper_that_is_called_like_an_installed_package_is_refused(folder):
    (folder / "own.py").write_text("import rich\nmethod = print")
    (folder / "rich.py").write_text("")
    with pytest.raises(
        LegsimError, match=r"has 'rich' beside it, but .* gives .*; rename the file"
    ):
        own_method(folder)


def own_method(folder: Path) -> Callable[[Any], Any]:
    """The method itself, without the check of what it returns."""
    return methods._from_file(folder / "own.py", "method")
