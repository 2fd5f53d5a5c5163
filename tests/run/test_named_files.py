"""Keys change with the content of every file that settings name."""

import shutil
from pathlib import Path

import pytest

from legsim import config
from legsim.core.errors import LegsimError
from legsim.imu.catalogue import load_sensor
from legsim.run import named_files

SENSORS = Path(load_sensor.__code__.co_filename).parents[2] / "models/sensors"


def settings(*overrides: str) -> config.RunConfig:
    return config.load_settings(
        preset="demo", overrides=("motion.file=subject01/squat_30.trc", *overrides)
    )


def strings(section: type[config.ConfigSection], *where: str) -> list[tuple[str, ...]]:
    """Places of all settings that are plain text."""
    found = []
    for name, field in section.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(
            field.annotation, config.ConfigSection
        ):
            found += strings(field.annotation, *where, name)
        elif field.annotation is str:
            found.append((*where, name))
    return found


def test_every_setting_that_is_text_is_a_file_or_the_name_of_a_sensor():
    """A new one is a file that keys and studies must know of, or is added here."""
    text = {place for place in strings(config.RunConfig) if place[0] != "imu" or len(place) > 2}
    assert text - set(config.FILES) == {("methods", "sensor")}
    assert set(config.FILES) <= text


def test_the_content_of_files_is_in_the_key_and_their_names_are_not(tmp_path: Path):
    beam, sensor, phantom = (tmp_path / n for n in ("beam.csv", "mine.toml", "PHANTOM.toml"))
    beam.write_text("energy_kev,weight\n40,1\n80,1\n")
    shutil.copy(SENSORS / "bmi160.toml", sensor)
    part = '[[part]]\nname = "skin"\nfile = "skin.stl"\nunit = "mm"\nmaterial = "muscle"\n'
    phantom.write_text(part)
    mesh = tmp_path / "skin.stl"
    mesh.write_text("solid one")

    def key(folder: Path = tmp_path) -> tuple[object, ...]:
        names = (f"scan.spectrum.file={folder / beam.name}", "scan.spectrum.kind=file")
        names = (*names, f"imu.noise.kind={folder / sensor.name}")
        return named_files.fingerprint(settings(*names, f"phantom.file={folder / phantom.name}"))

    keys = [key()]
    for path, old, new in (
        (beam, "80,1", "80,2"),
        (sensor, "turn_on_bias_mg = { value = 40", "turn_on_bias_mg = { value = 41"),
        (phantom, "muscle", "adipose"),
        (mesh, "one", "two"),
    ):
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new))
        keys.append(key())
    assert all(a != b for k, a in enumerate(keys) for b in keys[:k])
    shutil.copytree(tmp_path, tmp_path / "elsewhere")
    assert key(tmp_path / "elsewhere") == keys[-1]


def test_a_file_that_is_not_there_is_reported(tmp_path: Path):
    with pytest.raises(LegsimError, match=r"PHANTOM\.toml"):
        named_files.fingerprint(settings(f"phantom.file={tmp_path / 'PHANTOM.toml'}"))
