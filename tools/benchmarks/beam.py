"""Processor time a view of one energy, of a tube's spectrum, and of each step of the detector, on
both legs of the phantom.

Usage: python -m tools.benchmarks.beam [--views 6] (needs the extra "spectra")
"""

import argparse
import time
from collections.abc import Callable

import numpy as np

from legsim import config
from legsim.kinematics.skeleton import SEGMENTS
from legsim.opencl.device import open_device
from legsim.phantom import leg_phantom
from legsim.run.c_arm import c_arm
from legsim.scan import detector, projector
from legsim.scan import spectrum as scan_spectrum
from legsim.scan.detector import Detector

STEPS = {
    "photons": Detector(photons=1e4),
    "scatter": Detector(scatter_to_primary=0.3),
    "blur": Detector(blur_fwhm=1e-3),
    "lag, 4 exponentials": Detector(lag=((0.01, 0.1), (0.005, 1.0), (0.003, 3.0), (0.001, 20.0))),
}


def seconds(work: Callable[[], object]) -> float:
    """Processor time of ``work``."""
    start = time.process_time()
    work()
    return time.process_time() - start


def main() -> None:
    """Prints milliseconds per view."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--views", type=int, default=6)
    views = parser.parse_args().views
    legs, device = leg_phantom.load_leg_phantom(), open_device()
    settings = config.load_settings(overrides=(f"scan.views={views}",)).scan
    knee = legs.reference_world_from_segment[SEGMENTS.index("tibia_l"), :3, 3]
    geometry = c_arm(settings).geometry(np.arange(views) / settings.rate_hz, knee)
    spectrum = scan_spectrum.tube(
        kvp=90.0, anode_deg=12.0, aluminum_mm=3.0, copper_mm=0.1, response="energy"
    )
    projector.project(legs.phantom, geometry[:1], device)  # builds the kernels
    projector.project_spectrum(legs.phantom, geometry[:1], device, spectrum)
    clean = projector.project(legs.phantom, geometry, device)
    times = {
        "one energy": seconds(lambda: projector.project(legs.phantom, geometry, device)),
        f"spectrum of {len(spectrum.energies_kev)} energies": seconds(
            lambda: projector.project_spectrum(legs.phantom, geometry, device, spectrum)
        ),
    }
    times |= {
        name: seconds(lambda what=what: detector.detect(clean, what, np.random.default_rng(0)))
        for name, what in STEPS.items()
    }
    for name, spent in times.items():
        print(f"{name:28} {1e3 * spent / views:8.1f} ms a view")


if __name__ == "__main__":
    main()
