"""Options offer what the package knows."""

from legsim import config
from legsim.cli.options import Preset


def test_presets_are_those_of_the_settings():
    assert {preset.value for preset in Preset} == set(config.PRESETS)
