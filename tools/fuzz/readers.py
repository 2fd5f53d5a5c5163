"""What reads each kind of file, and the valid files that are damaged."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import legsim as ls
from legsim.config import measured_scan
from legsim.core import resources
from legsim.core.files import load_toml
from legsim.deformation import files as motion_files
from legsim.geometry import ct_volume, image_files, label_images, projection_images
from legsim.geometry.counts import line_integrals
from legsim.geometry.projection_images import RawLayout
from legsim.imu import catalogue
from legsim.imu import files as imu_files
from legsim.kinematics import ik_tasks, on_osim_model, osim_file, osim_marker_set, osim_scaling
from legsim.mocap import c3d_analog, marker_sets
from legsim.phantom import label_maps, label_structures
from legsim.run import imu_files as run_imu_files
from legsim.run import measured, own_code, projection_files, shadow_files
from legsim.run.folder import RunFolder
from legsim.run.store import StageCache
from legsim.scan import spectrum
from legsim.study import config as study_config
from legsim.study import kept, results
from tools.fuzz import run_samples, samples, sensor_samples
from tools.fuzz.samples import Maker


@dataclass(frozen=True)
class Reader:
    """What reads a file, and how valid ones are made."""

    suffix: str
    load: Callable[[Path], object]
    makers: tuple[Maker, ...]
    name: str = "file"
    """stem of the file"""
    may_hold: str = ""
    """"nan": gaps are NaN; "inf": ranges without an end are infinite"""


def _of_markers(suffix: str, *makers: Maker) -> Reader:
    return Reader(suffix, ls.load_recording, makers or (samples.recording,), may_hold="nan")


def _geometry(path: Path) -> object:
    return ls.load_geometry(path, columns=7, rows=6, pixel_mm=10.0)


def _of_geometry(suffix: str, *makers: Maker) -> Reader:
    return Reader(suffix, _geometry, makers)


def _projections(path: Path) -> object:
    return projection_images.read_projections(path, samples.geometry(), line_integrals=True)


def _of_projections(suffix: str, *makers: Maker) -> Reader:
    return Reader(suffix, _projections, makers)


def _raw_projections(path: Path) -> object:
    layout = RawLayout.parsed("F32:7x6x5:8")
    return projection_images.read_projections(path, samples.geometry(), raw=layout)


def _labels(path: Path) -> object:
    image = label_images.load_label_image(path)
    map_file = path.parent / "labels.toml"
    if not map_file.exists():
        map_file.write_text(samples.LABEL_MAP)
    read = label_maps.load_label_map(map_file)
    made = label_structures.structure_grid([image], [read], side="l")
    return made.codes, made.world_from_index


def _imu_toml(path: Path) -> object:
    table = path.parent / "table.csv"
    if not table.exists():
        sensor_samples.imu_table(table)
    return [sensor.recording for sensor in run_imu_files.load(path)]


def _imu_table(path: Path) -> object:
    described = path.parent / "described.toml"
    if not described.exists():
        described.write_text(sensor_samples.IMU_TOML.replace("table.csv", path.name))
    return [sensor.recording for sensor in run_imu_files.load(described)]


def _imu_channels(path: Path) -> object:
    described = path.parent / "described.toml"
    if not described.exists():
        described.write_text(sensor_samples.CHANNELS_TOML)
    return [sensor.recording for sensor in run_imu_files.load(described)]


def _beads(path: Path) -> object:
    return shadow_files.load_beads(path, samples.geometry())


def _fiducials(path: Path) -> object:
    pixels = shadow_files.load_fiducials(path, samples.geometry(), bounded=False)
    return shadow_files.first_views(path, pixels)


def _scan(path: Path) -> object:
    if not (path.parent / "scan").exists():
        run_samples.scan_toml(path.with_name("first.toml"))
    beside = path.parent / "scan" / path.name
    beside.write_bytes(path.read_bytes())
    measured_scan.load(beside)
    return measured.load_measured_scan(beside).grid


def _times(path: Path) -> object:
    return projection_files.with_times(samples.geometry(), False, None, path)


def _phantom(path: Path) -> object:
    part = path.parent / "part.stl"
    if not part.exists():
        samples.mesh("stl")(part)
    return ls.load_phantom(path)


def _mesh(path: Path) -> object:
    described = path.parent / "p.toml"
    if not described.exists():
        described.write_text(
            f'[[part]]\nname = "a"\nfile = "{path.name}"\nunit = "m"\nmaterial = "water"\n'
        )
    return ls.load_phantom(described)


def _of_meshes(suffix: str, *makers: Maker) -> Reader:
    return Reader(suffix, _mesh, makers)


def _osim_leg(path: Path) -> object:
    leg, _ = on_osim_model.load(path, None)
    return leg.marker_sites()


def _osim_markers(path: Path) -> object:
    bare = path.parent / "bare.osim"
    if not bare.exists():
        samples.osim(4)(bare)
    return osim_marker_set.with_set(osim_file.read(bare), path)


def _ct(path: Path) -> object:
    beside = path.parent / "ct" / path.name
    beside.write_bytes(path.read_bytes())
    return ct_volume.load(beside.parent, water=20.6)


def _view(path: Path) -> object:
    """One view of a folder."""
    folder = path.parent / "views"
    if not folder.exists():
        folder.mkdir()
        for k in range(3):
            samples.dicom_view(k)(folder / f"{k}.dcm")
    (folder / "1.dcm").write_bytes(path.read_bytes())
    return projection_images.read_images(folder).values.astype(float)


def _projections_of_a_run(path: Path) -> object:
    return ls.load_projections(path, samples.geometry())


def _labels_on_grid(path: Path) -> object:
    return image_files.load_labels(path, samples.volume().grid)


def _flat(path: Path) -> object:
    counts = projection_images.read_counts(flat=path)
    values = (1e4 * np.exp(-samples.images())).astype(np.uint16)
    return None if counts is None else line_integrals(values, counts).values


def _method(path: Path) -> object:
    """Whose files are found; it is not run."""
    (path.parent / "table.json").write_text("{}")
    (path.parent / "weights.py").write_text("import table\n")
    return own_code.fingerprint(path)


def _stored(path: Path) -> object:
    """An entry of the store of finished stages."""
    store = StageCache(path.parent / "store")
    place = store.path / "one" / "k"
    place.mkdir(parents=True, exist_ok=True)
    (place / "a.txt").write_text("a")
    (place / "entry.json").write_bytes(path.read_bytes())
    into = path.parent / "into"
    into.mkdir(exist_ok=True)
    (into / "a.txt").unlink(missing_ok=True)
    with RunFolder(path.parent / "fetching", {}, store=store) as folder:
        return folder.cached("one", "k", lambda: ("a.txt",))


def _manifest(path: Path) -> None:
    if not (path.parent / "run").exists():
        run_samples.manifest(path.with_name("first.json"))
    (path.parent / "run/manifest.json").write_bytes(path.read_bytes())
    with RunFolder(path.parent / "run", {}) as folder:
        folder.done("one", "k")


def _scores(path: Path) -> object:
    """What a study has kept."""
    return kept.entries(path, "k", lambda: [{"a": 1.0}])


CHANNELS = (
    sensor_samples.channels(),
    sensor_samples.channels(unsigned=True, scale=0.1),
    sensor_samples.channels(processor=85),
    sensor_samples.channels(processor=86, scale=0.1),
)

MODELS = resources.model_file("lower_body").parent

READERS: dict[str, Reader] = {
    "trc": _of_markers(
        ".trc",
        samples.recording,
        samples.trc_of_other_programs(samples.sparse),
        samples.trc_of_other_programs(lambda text: text.replace("\t", ",")),
    ),
    "markers_csv": _of_markers(".csv"),
    "motive_csv": _of_markers(".csv", samples.capture_table("motive")),
    "nexus_csv": _of_markers(".csv", samples.capture_table("nexus")),
    "qualisys_tsv": _of_markers(
        ".tsv",
        samples.capture_table("qualisys"),
        samples.capture_table("qualisys", timed=False),
    ),
    "c3d": _of_markers(
        ".c3d",
        samples.c3d(84, -1.0),
        samples.c3d(84, 0.1, screens=("+X", "+Y"), analog_words=2),
        samples.c3d(85, -1.0, model_outputs=("LKneeAngles",)),
        samples.c3d(86, 0.1),
    ),
    "c3d_analog": Reader(".c3d", c3d_analog.load_analog, CHANNELS, may_hold="nan"),
    "imu_c3d": Reader(".c3d", _imu_channels, CHANNELS),
    "mot": _of_markers(".mot"),
    "sto": _of_markers(".sto", samples.recording, samples.content(samples.STATES)),
    "angles_csv": _of_markers(".csv", lambda p: ls.save_recording(p, samples.coordinates())),
    "osim": Reader(".osim", osim_file.read, (samples.osim(4), samples.osim(3)), may_hold="inf"),
    "scales": Reader(".xml", osim_scaling.read, (samples.content(samples.SCALES),)),
    "ik_tasks": Reader(".xml", ik_tasks.read, (samples.content(samples.TASKS),)),
    "osim_leg": Reader(".osim", _osim_leg, (samples.osim(4), samples.osim(3)), may_hold="inf"),
    "osim_markers": Reader(".xml", _osim_markers, (samples.marker_set,), may_hold="inf"),
    "marker_set": Reader(
        ".toml",
        marker_sets.load,
        (
            samples.copy(MODELS / "marker_sets/cast.toml"),
            samples.content(samples.ROLES),
        ),
    ),
    "geometry_json": _of_geometry(".json", samples.saved_geometry("legsim")),
    "rtk_xml": _of_geometry(".xml", samples.saved_geometry("rtk")),
    "conrad_xml": _of_geometry(".xml", samples.saved_geometry("conrad")),
    "tigre": _of_geometry(".json", samples.tigre, samples.saved_geometry("tigre")),
    "projtable": _of_geometry(".txt", samples.saved_geometry("projtable")),
    "matrices": _of_geometry(
        ".txt", samples.saved_geometry("matrices"), samples.matrix_table, samples.bracketed
    ),
    "astra": _of_geometry(".txt", samples.saved_geometry("astra")),
    "matrices_npy": _of_geometry(".npy", samples.saved_geometry("matrices")),
    "matrices_mat": _of_geometry(".mat", samples.matlab),
    "view_times": Reader(".txt", _times, (samples.content("t\n0\n0.1\n0.2\n0.3\n0.4\n"),)),
    "volume_mha": Reader(".mha", ls.load_volume, (samples.saved_volume,)),
    "volume_nifti": Reader(".nii", ls.load_volume, (samples.saved_volume,)),
    "volume_nii_gz": Reader(".nii.gz", ls.load_volume, (samples.saved_volume,)),
    "volume_nrrd": Reader(".nrrd", ls.load_volume, (samples.saved_volume,)),
    "volume_mhd": Reader(".mhd", ls.load_volume, (samples.volume_mhd,)),
    "labels_on_grid": Reader(".mha", _labels_on_grid, (samples.labels_on_grid,)),
    "ct_slice": Reader(".dcm", _ct, (samples.dicom_slice,)),
    "labels_nifti": Reader(".nii", _labels, (samples.itk_image(samples.labels()),)),
    "labels_mha": Reader(
        ".mha",
        _labels,
        (
            samples.itk_image(samples.labels()),
            samples.itk_image(samples.labels().astype(np.int32)),
            samples.itk_image(samples.labels().astype(np.float32)),
        ),
    ),
    "label_map": Reader(".toml", label_maps.load_label_map, (samples.content(samples.LABEL_MAP),)),
    "projections_mha": _of_projections(".mha", samples.saved_projections),
    "projections_of_a_run": Reader(".mha", _projections_of_a_run, (samples.saved_projections,)),
    "flat_field": Reader(".tif", _flat, (samples.flat,)),
    "views_dicom": Reader(".dcm", _view, (samples.dicom_view(1),)),
    "projections_tiff": _of_projections(
        ".tif", samples.tiff(), samples.tiff(compression="zlib"), samples.tiff(bigtiff=True)
    ),
    "projections_dicom": _of_projections(".dcm", samples.dicom(**samples.ANGLES), samples.dicom()),
    "projections_npy": _of_projections(".npy", lambda p: np.save(p, samples.images())),
    "projections_raw": Reader(".raw", _raw_projections, (samples.raw,)),
    "projections_png": Reader(
        ".png",
        lambda p: projection_images.read_images(p).values,
        (samples.itk_image((1e4 * samples.images()[0]).astype(np.uint16)),),
    ),
    "imu": Reader(".csv", imu_files.load_imu, (sensor_samples.imu,), may_hold="nan"),
    "imu_rows": Reader(".csv", imu_files.load_recordings, (sensor_samples.imu,)),
    "xsens": Reader(".txt", imu_files.load_recordings, (sensor_samples.xsens,)),
    "imu_sto": Reader(".sto", imu_files.load_recordings, (sensor_samples.imu_storage,)),
    "imu_table": Reader(".csv", _imu_table, (sensor_samples.imu_table,)),
    "imu_toml": Reader(".toml", _imu_toml, (samples.content(sensor_samples.IMU_TOML),)),
    "fiducials": Reader(".csv", _fiducials, (samples.content(samples.FIDUCIALS),)),
    "beads": Reader(".csv", _beads, (samples.content(samples.BEADS),), may_hold="nan"),
    "sensor": Reader(".toml", catalogue.load_sensor, (samples.sensor_toml,)),
    "spectrum": Reader(".csv", spectrum.load, (samples.spectrum,)),
    "motion": Reader(".npz", motion_files.load_motion, tuple(samples.motion(k) for k in range(4))),
    "phantom": Reader(".toml", _phantom, (samples.content(samples.PHANTOM),)),
    "stl": _of_meshes(".stl", samples.mesh("stl"), samples.mesh("stl_ascii")),
    "ply": _of_meshes(".ply", samples.mesh("ply")),
    "obj": _of_meshes(".obj", samples.mesh("obj")),
    "glb": _of_meshes(".glb", samples.mesh("glb")),
    "vtp": _of_meshes(
        ".vtp",
        samples.vtp("ascii"),
        samples.vtp("inline", compressed=True),
        samples.vtp("appended", ">", "Q"),
        samples.vtp("raw", compressed=True),
    ),
    "settings": Reader(".toml", ls.load_settings, (run_samples.settings,)),
    "scan_toml": Reader(".toml", _scan, (run_samples.scan_toml,)),
    "study_toml": Reader(
        ".toml", lambda p: study_config.load(str(p)), (samples.content(samples.STUDY),)
    ),
    "toml": Reader(".toml", load_toml, (samples.content(samples.STUDY),), may_hold="naninf"),
    "results": Reader(".json", results.load, (run_samples.results,), may_hold="nan"),
    "manifest": Reader(".json", _manifest, (run_samples.manifest,)),
    "stored": Reader(".json", _stored, (run_samples.stored,)),
    "scores": Reader(".json", _scores, (run_samples.scores,)),
    "own_method": Reader(".py", _method, (samples.content(run_samples.METHOD),)),
}
