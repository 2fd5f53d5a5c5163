"""CONRAD's beans: matrices and detector out of a configuration, and what is refused."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.geometry import files
from tests.geometry.test_files import circular

PROJECTION = "edu.stanford.rsl.conrad.geometry.Projection"


def configuration(matrices, length=None, detector=True):
    """A configuration as Java writes it, with the trajectory as its geometry."""
    views = "".join(
        f'<void index="{k}"><object class="{PROJECTION}"><void property="PMatrixSerialization">'
        f"<string>{text}</string></void></object></void>"
        for k, text in enumerate(matrices)
    )
    size = "".join(
        f'<void property="{name}"><{kind}>{value}</{kind}></void>'
        for name, kind, value in (
            ("detectorWidth", "int", 62),
            ("detectorHeight", "int", 48),
            ("pixelDimensionX", "double", 0.616),
            ("pixelDimensionY", "double", 0.616),
        )
    )
    return (
        '<?xml version="1.0" encoding="UTF-8"?><java version="1.8.0_60" '
        'class="java.beans.XMLDecoder"><object class="edu.stanford.rsl.conrad.utils.Configuration">'
        '<void property="geometry"><object class="edu.stanford.rsl.conrad.geometry.trajectories.Trajectory">'
        f'{size if detector else ""}<void property="projectionMatrices"><array class="{PROJECTION}" '
        f'length="{len(matrices) if length is None else length}">{views}</array></void></object></void>'
        "</object></java>"
    )


def texts():
    return [
        "[" + "; ".join(f"[{' '.join(map(repr, row))}]" for row in m) + "]"
        for m in (circular().matrices * [1, 1, 1, 1e3]).tolist()
    ]


def test_a_configuration_gives_matrices_and_detector(tmp_path):
    (tmp_path / "c.xml").write_text(configuration(texts()))
    found = files.read_geometry(tmp_path / "c.xml")
    assert (found.format, found.geometry.shape_vu) == ("conrad", (48, 62))
    assert found.geometry.pixel_pitch == pytest.approx(0.616e-3)
    np.testing.assert_allclose(found.geometry.matrices, circular().matrices, rtol=1e-12)


def test_the_detector_is_the_trajectorys_not_that_of_a_source_beside_it(tmp_path):
    source = (
        '<void property="detector"><object class="edu.stanford.rsl.conrad.physics.detector.'
        'XRayDetector"><void property="detectorWidth"><int>1240</int></void>'
        '<void property="pixelDimensionX"><double>0.308</double></void></object></void>'
    )
    first = '<void property="geometry">'
    (tmp_path / "c.xml").write_text(configuration(texts()).replace(first, source + first))
    found = files.read_geometry(tmp_path / "c.xml").geometry
    assert (found.shape_vu, found.pixel_pitch) == ((48, 62), pytest.approx(0.616e-3))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (configuration([]), "holds 0 lists of projection matrices"),
        (configuration(texts(), 7), r"\(projection 5\): 7 matrices are announced, 5 are there"),
        (configuration(["[[1 2 3]; [4 5 6]]"]), r"\(projection 0\): '\[\[1 2 3\]; .* is no matrix"),
        (configuration(texts(), detector=False), "does not say how large the detector is"),
    ],
)
def test_what_is_not_there_is_refused(tmp_path, content, message):
    (tmp_path / "c.xml").write_text(content)
    with pytest.raises(LegsimError, match=message):
        files.read_geometry(tmp_path / "c.xml")


def test_an_endless_count_of_matrices_is_refused_at_once(tmp_path):
    (tmp_path / "c.xml").write_text(configuration(texts(), 10**20))
    with pytest.raises(LegsimError, match=r"\(projection 5\): 1000.* are announced, 5 are there"):
        files.read_geometry(tmp_path / "c.xml")
