"""Small valid files of every kind that legsim reads, to be damaged."""

import json
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import tomli_w

import legsim as ls
from legsim.deformation.models import ControlPointMotion, FieldMotion, Motion
from legsim.deformation.polyrigid import PolyrigidMotion
from legsim.geometry import files as geometry_files
from legsim.geometry import image_files
from legsim.kinematics import from_recording
from legsim.mocap import files as mocap_files

Maker = Callable[[Path], object]
"""writes one valid file"""


def content(data: bytes | str) -> Maker:
    """Of these bytes or this text."""
    made = data.encode() if isinstance(data, str) else data
    return lambda path: path.write_bytes(made)


def copy(source: Path) -> Maker:
    """Of a file that there is."""
    return lambda path: path.write_bytes(source.read_bytes())


def markers(frames: int = 8) -> ls.MarkerTrajectories:
    """Seven markers of a recording."""
    whole = mocap_files.load_markers(from_recording.find_recording("subject01/squat_30.trc"))
    seven = whole.marker_names[:7]
    return ls.MarkerTrajectories(whole.times[:frames], seven, whole.positions_world[:frames, :7])


def coordinates() -> ls.JointTrajectories:
    """Every coordinate of the leg model."""
    from legsim.kinematics.leg_model import COORDINATES

    values = np.random.default_rng(1).normal(size=(8, len(COORDINATES))) / 10
    return ls.JointTrajectories(np.arange(8) / 60, COORDINATES, values)


def geometry() -> ls.ConeBeamGeometry:
    """Five views of 6 x 7 pixels."""
    return ls.ConeBeamGeometry.circular(
        times=np.arange(5) / 31,
        angles=np.arange(5) / 3,
        source_isocenter=0.785,
        source_detector=1.198,
        shape_vu=(6, 7),
        pixel_pitch=0.01,
    )


def volume() -> ls.Volume:
    """Noise on a cube."""
    grid = ls.VolumeGrid.cubic(5, 0.01, [0.0, 0.0, 0.0])
    drawn = np.random.default_rng(1).normal(size=grid.shape_zyx)
    return ls.Volume(grid, drawn.astype(np.float32))


def images() -> np.ndarray:
    """Line integrals of :func:`geometry`."""
    return np.random.default_rng(2).random((5, 6, 7)).astype(np.float32)


def recording(path: Path) -> None:
    """Markers or coordinates, as the ending says."""
    made = coordinates() if path.suffix in (".mot", ".sto") else markers()
    mocap_files.save_recording(path, made)


def trc_of_other_programs(change: Callable[[str], str]) -> Maker:
    """A TRC whose text another program would write so."""

    def make(path: Path) -> None:
        recording(path)
        path.write_bytes(change(path.read_text("utf-8")).encode("utf-16"))

    return make


def sparse(text: str) -> str:
    """Semicolons, and markers that are not seen."""
    lines = text.replace("\t", ";").splitlines()
    lines[-2] = ";".join([*lines[-2].split(";")[:5], *[""] * 18])
    return "\n".join(lines)


def c3d(processor: int, scale: float, **more: object) -> Maker:
    """A C3D of one of the format's processors; a positive scale stores whole numbers."""
    from tests.references.c3d import c3d_bytes

    def make(path: Path) -> None:
        made = markers()
        points = 1e3 * made.positions_world.copy()
        points[3, 2] = np.nan
        path.write_bytes(
            c3d_bytes(points, made.marker_names, processor=processor, scale=scale, **more)  # type: ignore[arg-type]
        )

    return make


def capture_table(program: str, **more: bool) -> Maker:
    """Three markers in a table of "motive", "nexus" or "qualisys", one of them not always seen."""
    from tests.examples import capture_tables

    def make(path: Path) -> None:
        places = 1e3 * markers().positions_world[:, :3]
        places[3, 1] = np.nan
        path.write_text(getattr(capture_tables, program)(places, **more), encoding="utf-8")

    return make


STATES = (
    "states\nversion=1\nnRows=3\nnColumns=5\ninDegrees=no\nendheader\n"
    "time\t/jointset/ground_pelvis/pelvis_tilt/value\t/jointset/knee_r/knee_angle_r/value\t"
    "/jointset/knee_r/knee_angle_r/speed\t/forceset/soleus_r/activation\n"
    "0\t0.1\t-0.3\t0\t0.02\n0.01\t0.1\t-0.31\t0\t0.02\n0.02\t0.11\t-0.32\t0\t0.02\n"
)

TASKS = """<OpenSimDocument Version="30000"><InverseKinematicsTool><IKTaskSet name="t"><objects>
<IKMarkerTask name="RASI"><apply>true</apply><weight>10</weight></IKMarkerTask>
<IKMarkerTask name="LASI"><apply>false</apply><weight>1</weight></IKMarkerTask>
<IKCoordinateTask name="knee_angle_r"><apply>true</apply><weight>0.5</weight>
<value_type>manual_value</value_type><value>-0.2</value></IKCoordinateTask>
</objects></IKTaskSet></InverseKinematicsTool></OpenSimDocument>
"""

SCALES = """<?xml version="1.0"?>
<OpenSimDocument Version="40000"><ScaleSet><objects>
<Scale><scales>1.1 1 0.9</scales><segment>femur_l</segment><apply>true</apply></Scale>
<Scale><scales>1 1.2 1</scales><segment>tibia_l</segment><apply>true</apply></Scale>
</objects></ScaleSet></OpenSimDocument>
"""

ROLES = '[roles]\nsacrum = ["a", "b"]\nasis_r = [["c"], ["d", "e"]]\npatella_superior_r = "k"\n'


def osim(version: int) -> Maker:
    """A model of two legs."""
    from tests.examples import osim as examples

    write = {4: examples.version_4, 3: examples.version_3}[version]
    return lambda path: path.write_text(write(examples.two_legs(), markers=examples.MARKERS))


def marker_set(path: Path) -> None:
    """OpenSim's markers of :func:`osim` in a file of their own."""
    from tests.examples import osim as examples

    path.write_text(f"<MarkerSet name='s'><objects>{examples.MARKERS}</objects></MarkerSet>")


def saved_geometry(format: str) -> Maker:
    """In one of the formats that legsim writes."""
    return lambda path: geometry_files.save_geometry(path, geometry(), format=format)


def matrix_table(path: Path) -> None:
    """Lines of a view's number and twelve numbers."""
    rows = geometry().matrices.reshape(-1, 12)
    np.savetxt(path, np.column_stack([np.arange(len(rows)), rows]), delimiter=",")


def bracketed(path: Path) -> None:
    """3x4 matrices in brackets."""
    rows = ["[" + "; ".join(" ".join(map(repr, row)) for row in m) + "]" for m in _matrices_mm()]
    path.write_text("# matrices\n" + "\n".join(rows) + "\n")


def _matrices_mm() -> list:
    return (geometry().matrices * [1, 1, 1, 1e3]).tolist()


def matlab(path: Path) -> None:
    """Matrices as MATLAB keeps them."""
    import scipy.io

    scipy.io.savemat(path, {"P": geometry().matrices.transpose(1, 2, 0)})


def tigre(path: Path) -> None:
    """TIGRE's object with values per view."""
    path.write_text(
        json.dumps(
            {
                "mode": "cone",
                "DSD": 1536.0,
                "DSO": [1000.0] * 4,
                "COR": 4.0,
                "nDetector": [6, 7],
                "dDetector": [10.0, 10.0],
                "offDetector": [0.0, 1.0],
                "rotDetector": [0.0, 0.0, 0.1],
                "angles": [0.0, 0.5, 1.0, 1.5],
            }
        )
    )


def saved_volume(path: Path) -> None:
    """In the format of the ending."""
    image_files.save_volume(path, volume())


def saved_projections(path: Path) -> None:
    """In the format of the ending."""
    image_files.save_projections(path, ls.Projections(geometry(), images()))


def volume_mhd(path: Path) -> None:
    """A header alone; the numbers are in a file beside it, of one name in every folder."""
    import SimpleITK as sitk

    sitk.WriteImage(sitk.GetImageFromArray(volume().attenuation), str(path))


def labels_on_grid(path: Path) -> None:
    """Whole numbers on the grid of :func:`volume`."""
    import SimpleITK as sitk

    grid = volume().grid
    image = sitk.GetImageFromArray((volume().attenuation > 0).astype(np.uint8))
    image.SetSpacing([1e3 * s for s in grid.spacing_xyz])
    image.SetOrigin((1e3 * grid.origin).tolist())
    sitk.WriteImage(image, str(path))


def itk_image(values: np.ndarray, **options: object) -> Maker:
    """An image that ITK writes."""
    import SimpleITK as sitk

    def make(path: Path) -> None:
        image = sitk.GetImageFromArray(values)
        image.SetSpacing([2.0] * values.ndim)
        sitk.WriteImage(image, str(path), **options)  # type: ignore[arg-type]

    return make


def labels() -> np.ndarray:
    """Two structures."""
    made = np.zeros((6, 7, 8), np.uint8)
    made[1:5, 1:6, 1:7], made[2:4, 2:5, 3:5] = 1, 2
    return made


LABEL_MAP = (
    '[[label]]\nnumber = 1\nname = "skin"\ntissue = "skin"\nsegment = "tibia_l"\nenvelope = true\n'
    '[[label]]\nnumber = 2\nname = "tibia"\ntissue = "bone"\nsegment = "tibia_l"\n'
    "[left_out]\nliver = 5\n"
)


def tiff(**options: object) -> Maker:
    """A stack of views."""
    import tifffile

    return lambda path: tifffile.imwrite(path, images(), **options)  # type: ignore[arg-type]


def flat(path: Path) -> None:
    """What a detector reads without an object."""
    import tifffile

    tifffile.imwrite(path, np.random.default_rng(5).integers(50_000, 60_000, (2, 6, 7), np.uint16))


def dicom(**elements: object) -> Maker:
    """A multi-frame image."""

    def make(path: Path) -> None:
        from tests.geometry.test_dicom import written

        values = np.random.default_rng(3).integers(0, 60000, (5, 6, 7)).astype(np.uint16)
        written(path, values, **elements)

    return make


def dicom_view(number: int) -> Maker:
    """A file of its own for one of three views."""

    def make(path: Path) -> None:
        from tests.geometry.test_dicom import written

        values = np.random.default_rng(number).integers(0, 60000, (1, 6, 7)).astype(np.uint16)
        written(path, values, InstanceNumber=number + 1, PositionerPrimaryAngle=2.0 * number)

    return make


ANGLES = {
    "ImagerPixelSpacing": [0.3, 0.4],
    "PositionerPrimaryAngle": -100.0,
    "PositionerPrimaryAngleIncrement": [0.0, 1.5, 3.0, 4.5, 6.0],
    "RescaleSlope": "0.0001",
}


FIDUCIALS = "view,point,u,v\n" + "".join(
    f"{k},{name},{10 + k}.5,{20 + j}\n"
    for k in range(2)
    for j, name in enumerate(("origin", "x", "y", "z"))
)

BEADS = "view,bead,u,v\n" + "".join(
    f"{k},{bead},{2 + bead}.5,{1 + k}\n"
    for k in range(5)
    for bead in range(2)
    if (k, bead) != (2, 1)
)


def spectrum(path: Path) -> None:
    """A spectrum of eight energies."""
    path.write_text("energy_kev,weight\n" + "".join(f"{k},{k / 9}\n" for k in range(20, 60, 5)))


def mesh(file_type: str) -> Maker:
    """A ball by trimesh."""

    def make(path: Path) -> None:
        import trimesh

        trimesh.creation.icosphere(1, 0.05).export(path, file_type=file_type)

    return make


def vtp(form: str, order: str = "<", header: str = "I", *, compressed: bool = False) -> Maker:
    """VTK's polygons in one of its encodings."""
    from tests.phantom.test_vtp import write

    return lambda path: write(path, form, order, header, compressed=compressed)


PHANTOM = """overlaps = "intended"
[[part]]
name = "a"
file = "part.stl"
unit = "m"
material = "water"
[[part]]
name = "b"
file = "part.stl"
unit = "m"
material = "cortical_bone"
segment = "tibia_l"
"""

STUDY = """name = "mine"
title = "A study"
preset = "demo"
subjects = ["subject01", "subject02"]
postures = ["squat_30"]
methods = ["uncorrected", "rigid"]
[settings.scan]
views = 60
[[noise]]
levels = [[0, 1.5], [3, "none"]]
convention = "SI"
[ladder]
f_a = [0, "none"]
conventions = ["per-sample"]
"""


def motions() -> tuple[Motion, ...]:
    """One of every kind, of four views."""
    times, rng = np.arange(4) / 31, np.random.default_rng(4)
    still = np.tile(np.eye(4), (4, 1, 1))
    points = rng.normal(size=(5, 3)) / 10
    grid = ls.VolumeGrid.cubic(3, 0.1, [0.0, 0.0, 0.0])
    moved = points + rng.normal(size=(4, 5, 3)) / 1e3
    moved[0] = points
    nodes = rng.normal(size=(4, 3, 3, 3, 3)) / 1e3
    nodes[0] = 0
    shares = np.full((2, 3, 3, 3), 0.5, np.float32)
    return (
        ls.RigidMotion(times, still),
        ControlPointMotion(times, points, moved),
        FieldMotion(times, grid, nodes.astype(np.float32)),
        PolyrigidMotion(times, np.tile(np.eye(4), (4, 2, 1, 1)), grid, shares),
    )


def motion(number: int) -> Maker:
    """Of one of :func:`motions`."""
    from legsim.deformation import files as motion_files

    return lambda path: motion_files.save_motion(path, motions()[number])


def dicom_slice(path: Path) -> None:
    """The second of four slices of a CT series; the others are beside it in the folder ct."""
    from legsim.geometry import ct_series

    folder = path.parent / "ct"
    grid = ls.VolumeGrid((5, 4, 6), (7e-4, 9e-4, 1.1e-3), (0.1, 0.45, -0.083))
    drawn = np.random.default_rng(6).uniform(0, 60, grid.shape_zyx).astype(np.float32)
    slices = ct_series.save(folder, ls.Volume(grid, drawn), water=20.6)
    slices[1].rename(path)


def sensor_toml(path: Path) -> None:
    """A sensor of the catalogue."""
    from legsim.core import resources

    path.write_bytes(resources.model_file("sensors/bmi160.toml").read_bytes())


def raw(path: Path) -> None:
    """Numbers without a header but for eight bytes."""
    path.write_bytes(struct.pack("<q", 7) + images().tobytes())


def toml_of(tree: dict) -> Maker:
    """A tree as TOML."""
    return content(tomli_w.dumps(tree))
