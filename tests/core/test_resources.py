"""Shipped files are found, and a missing one is named."""

import pytest

from legsim.core import resources
from legsim.core.errors import LegsimError


def test_the_model_is_found():
    assert resources.model_file("lower_body/lower_body.xml").read_text("utf-8").startswith("<!--")


def test_files_inside_an_installed_package_come_first(tmp_path, monkeypatch):
    package = tmp_path / "site" / "legsim"
    for folder in (package / "data", package.parent):
        (folder / "motions").mkdir(parents=True)
        (folder / "motions" / "walk.trc").write_text("")
    monkeypatch.setattr(resources, "_PACKAGE", package)
    assert resources.motion_file("walk.trc") == package / "data" / "motions" / "walk.trc"


@pytest.mark.parametrize("name", [".", "subject01", ""])
def test_a_folder_is_no_recording(name):
    with pytest.raises(LegsimError, match="is not part of this legsim installation"):
        resources.motion_file(name)


def test_a_missing_file_is_named_with_what_is_there():
    with pytest.raises(
        LegsimError,
        match=(
            r"models/leg\.xml is not part of this legsim installation; known: "
            r".*lower_body.*reinstall"
        ),
    ):
        resources.model_file("leg.xml")


def test_a_name_that_no_file_can_have_is_missing():
    with pytest.raises(LegsimError, match="is not part of this legsim installation"):
        resources.model_file(300 * "a")
