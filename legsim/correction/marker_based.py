"""The marker-based standard: beads on the skin, tracked in a second scan of the same motion."""

from collections.abc import Callable
from dataclasses import dataclass

from legsim.core.errors import LegsimError
from legsim.correction import bead_tracking
from legsim.correction.bead_scan import BeadScan
from legsim.correction.bead_tracking import Reference
from legsim.correction.method import Correction, Scan


@dataclass(frozen=True, slots=True)
class MarkerBased:
    """Rigid motion from the shadows of beads (Choi et al. 2013, 2014)."""

    beads: BeadScan | Callable[[], BeadScan]
    """the scan with beads, or a function that makes it when called"""
    reference: Reference = "bundle"
    """what fixes place and size of the scene, see :mod:`legsim.correction.bead_tracking`"""

    def __call__(self, scan: Scan, /) -> Correction:
        beads = self.beads() if callable(self.beads) else self.beads
        if not isinstance(beads, BeadScan):
            raise LegsimError(
                f"MarkerBased follows the beads of a BeadScan, not {type(beads).__name__}"
            )
        pixels = bead_tracking.track(beads.projections, beads.guesses, radius=beads.radius)
        found = bead_tracking.estimate(scan.projections.geometry, pixels, reference=self.reference)
        note = (
            f"{len(beads.guesses)} beads of {2e3 * beads.radius:g} mm: "
            f"{100 * found.used.mean():.0f} % of their shadows were found and "
            f"used, {found.residual_px:.2f} px RMS from a rigid motion"
            f"{' of their static mean positions' if self.reference == 'mean' else ''}."
        )
        return Correction("marker-based", scan.projections, found.motion, notes=(note,))
