"""RTK's geometry XML: its parameters, its own reading and writing, and what malformed files
report.
"""

import importlib.util
import json
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from legsim.core.errors import LegsimError
from legsim.geometry import files
from legsim.geometry.cone_beam import ConeBeamGeometry
from tests.geometry.test_files import circular, corrected


@settings(max_examples=60, deadline=None)
@given(
    st.tuples(
        *[st.floats(-180, 180)] * 2,
        st.floats(-90, 90),
        *[st.floats(-200, 200)] * 4,
        st.floats(300, 2000),
        st.floats(300, 3000),
    )
)
def test_any_of_rtks_parameters_survive(tmp_path_factory, values):
    gantry, in_plane, out_of_plane, sx, sy, ox, oy, sid, sdd = values
    names = (
        "GantryAngle",
        "InPlaneAngle",
        "OutOfPlaneAngle",
        "SourceOffsetX",
        "SourceOffsetY",
        "ProjectionOffsetX",
        "ProjectionOffsetY",
    )
    numbers = (gantry, in_plane, out_of_plane, sx, sy, ox, oy)
    fields = "".join(f"<{n}>{x!r}</{n}>" for n, x in zip(names, numbers, strict=True))
    distances = f"<SourceToIsocenterDistance>{sid!r}</SourceToIsocenterDistance><SourceToDetectorDistance>{sdd!r}</SourceToDetectorDistance>"
    path = tmp_path_factory.mktemp("rtk") / "g.xml"
    path.write_text(
        "<RTKThreeDCircularGeometry "
        f'version="3"><Projection>{fields}{distances}</Projection></RTKThreeDCircularGeometry>'
    )
    first = files.load_geometry(path, columns=62, rows=48, pixel_mm=0.5)
    files.save_geometry(path, first)
    second = files.load_geometry(path)
    np.testing.assert_allclose(
        second.matrices, first.matrices, atol=1e-9 * np.abs(first.matrices).max()
    )


def test_rtk_parameters_before_the_projections_hold_for_all(tmp_path):
    files.save_geometry(tmp_path / "g.xml", circular(2))
    path = tmp_path / "short.xml"
    path.write_text(
        '<?xml version="1.0"?>\n<!DOCTYPE RTKGEOMETRY>\n<RTKThreeDCircularGeometry version="3">'
        "<SourceToIsocenterDistance>780</SourceToIsocenterDistance><SourceToDetectorDistance>1198</SourceToDetectorDistance>"
        "<Projection><GantryAngle>0</GantryAngle></Projection><Projection><GantryAngle>71.3</GantryAngle></Projection>"
        "</RTKThreeDCircularGeometry>"
    )
    loaded = files.load_geometry(path, columns=62, rows=48, pixel_mm=0.616)
    np.testing.assert_allclose(loaded.matrices, circular(2).matrices, atol=1e-10)


def test_rtk_matrix_alone_is_enough_and_a_contradiction_is_reported(tmp_path):
    matrix = "<Matrix>-1198 0 0 0 0 -1198 0 0 0 0 1 -780</Matrix>"
    wrap = (
        "<RTKThreeDCircularGeometry "
        'version="3"><Projection>{}</Projection></RTKThreeDCircularGeometry>'
    )
    (tmp_path / "g.xml").write_text(wrap.format(matrix))
    loaded = files.load_geometry(tmp_path / "g.xml", columns=62, rows=48, pixel_mm=0.616)
    np.testing.assert_allclose(loaded.matrices, circular(1).matrices, atol=1e-10)
    distances = "<SourceToIsocenterDistance>781</SourceToIsocenterDistance><SourceToDetectorDistance>1198</SourceToDetectorDistance>"
    (tmp_path / "h.xml").write_text(wrap.format(distances + matrix))
    with pytest.raises(LegsimError, match=r"h\.xml \(projection 0\): its <Matrix> contradicts"):
        files.load_geometry(tmp_path / "h.xml", columns=62, rows=48, pixel_mm=0.616)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("<a>", "is not XML"),
        ("<a/>", r"begins with <a version=None>"),
        (
            '<RTKThreeDCircularGeometry version="3"></RTKThreeDCircularGeometry>',
            "holds no <Projection>",
        ),
        (
            "<RTKThreeDCircularGeometry "
            'version="3"><Projection><GantryAngle>x</GantryAngle></Projection></RTKThreeDCircularGeometry>',
            r"\(projection 0\): <GantryAngle> holds 'x'",
        ),
        (
            "<RTKThreeDCircularGeometry "
            'version="3"><Projection><GantryAngle>1</GantryAngle></Projection></RTKThreeDCircularGeometry>',
            "source distances are missing",
        ),
        (
            "<RTKThreeDCircularGeometry "
            'version="3"><Projection><Gantry>1</Gantry></Projection></RTKThreeDCircularGeometry>',
            "unknown element <Gantry>",
        ),
        (
            "<RTKThreeDCircularGeometry "
            'version="3"><RadiusCylindricalDetector>9</RadiusCylindricalDetector></RTKThreeDCircularGeometry>',
            "the detector is cylindrical",
        ),
        (
            '<RTKThreeDCircularGeometry version="1"><Projection/></RTKThreeDCircularGeometry>',
            "begins with .* version='1'",
        ),
        (
            "<RTKThreeDCircularGeometry "
            'version="3"><Projection><SourceToIsocenterDistance>9</SourceToIsocenterDistance></Projection>'
            "</RTKThreeDCircularGeometry>",
            "RTK's parallel beam",
        ),
        (
            '<RTKThreeDCircularGeometry version="3"><!-- legsim {bad '
            "--></RTKThreeDCircularGeometry>",
            r"\(comment\): legsim's comment is not JSON",
        ),
        (
            '<RTKThreeDCircularGeometry version="3"><!-- legsim {"rows": "x", "columns": 2, '
            '"pixel_mm": 1, "times_s": [0]} -->'
            "</RTKThreeDCircularGeometry>",
            r"\(rows\): 'x' is not a count",
        ),
        (
            '<RTKThreeDCircularGeometry version="3"><!-- legsim {"rows": 2, "columns": 2, '
            '"pixel_mm": "1", "times_s": [0]} -->'
            "</RTKThreeDCircularGeometry>",
            r"\(pixel_mm\): '1' is not a positive number",
        ),
    ],
)
def test_malformed_xml_is_refused_with_its_place(tmp_path, content, message):
    (tmp_path / "g.xml").write_text(content)
    with pytest.raises(LegsimError, match=message):
        files.load_geometry(tmp_path / "g.xml", columns=2, rows=2, pixel_mm=1.0)


@pytest.mark.parametrize(
    ("camera", "message"),
    [
        (np.diag([-1.0, 1, 1]), "is mirrored"),
        (np.eye(3) + 0.1 * np.eye(3, k=1), "skewed"),
    ],
)
def test_what_rtk_cannot_express_is_refused_and_leaves_no_file(tmp_path, camera, message):
    geometry = circular()
    odd = ConeBeamGeometry(geometry.times, camera @ geometry.matrices, geometry.shape_vu)
    with pytest.raises(LegsimError, match=message):
        files.save_geometry(tmp_path / "g.xml", odd)
    assert not list(tmp_path.iterdir())
    files.save_geometry(tmp_path / "g.json", odd)
    np.testing.assert_allclose(
        files.load_geometry(tmp_path / "g.json").matrices, odd.matrices, rtol=1e-14
    )


RTK_SCRIPT = """
import json, sys
from itk import RTK
path, written, parameters = sys.argv[1], sys.argv[2], json.loads(sys.argv[3])
geometry = RTK.ThreeDCircularProjectionGeometry.New()
for numbers in parameters:
    geometry.AddProjection(*numbers)
RTK.write_geometry(geometry, written)
def matrices(g, views):
    return [[[g.GetMatrix(k)(i, j) for j in range(4)] for i in range(3)] for k in range(views)]
print(json.dumps([matrices(RTK.read_geometry(path), len(parameters)), matrices(geometry, len(parameters))]))
"""


@pytest.mark.peer
def test_rtk_reads_what_we_write_and_we_read_what_rtk_writes(tmp_path, agree):
    """RTK runs in a process of its own: its libraries and pyopencl's do not get along in one."""
    if importlib.util.find_spec("itk") is None:
        pytest.skip("RTK is not installed (pip install itk-rtk)")
    rng = np.random.default_rng(4)
    spans = [
        (500, 900),
        (1000, 1500),
        (0, 360),
        (-30, 30),
        (-30, 30),
        (-60, 60),
        (-60, 60),
        (-30, 30),
        (-30, 30),
    ]
    parameters = [[rng.uniform(*span) for span in spans] for _ in range(5)]
    ours = corrected()
    files.save_geometry(tmp_path / "ours.xml", ours)
    arguments = [str(tmp_path / "ours.xml"), str(tmp_path / "theirs.xml"), json.dumps(parameters)]
    done = subprocess.run(
        [sys.executable, "-c", RTK_SCRIPT, *arguments],
        capture_output=True,
        text=True,
        check=True,
        timeout=300,
    )
    read_from_ours, theirs = (np.array(m) for m in json.loads(done.stdout.splitlines()[-1]))

    points_mm = 1e3 * (ours.rotation_center() + rng.uniform(-0.1, 0.1, (50, 3)))
    detector = np.einsum("vij,pj->vpi", read_from_ours, np.column_stack([points_mm, np.ones(50)]))
    middle = (np.array(ours.shape_vu[::-1]) - 1) / 2
    pixels = detector[..., :2] / detector[..., 2:] / 0.616 + middle
    away = np.abs(pixels - ours.project(points_mm / 1e3)[0]).max()
    agree("points by a geometry that was written", "RTK", away, 1e-6, "pixel")

    loaded = files.load_geometry(tmp_path / "theirs.xml", columns=1, rows=1, pixel_mm=1.0)
    expected = -theirs * np.array([1, 1, 1, 1e-3])
    away = np.abs(loaded.matrices - expected).max() / np.abs(expected).max()
    agree("matrices of a geometry that was read", "RTK", away, 1e-9, "1")
