"""The marker-based standard: beads on the skin, seen in a scan of the same motion."""

from collections.abc import Callable
from dataclasses import dataclass

from legsim.correction import bead_tracking
from legsim.correction.bead_scan import BeadScan, shadows_of
from legsim.correction.bead_tracking import Reference
from legsim.correction.method import Correction, Scan
from legsim.correction.path_measurements import BeadShadows


@dataclass(frozen=True, slots=True)
class MarkerBased:
    """Rigid motion from the shadows of beads (Choi et al. 2013, 2014).

    >>> MarkerBased(BeadShadows(pixels))
    """

    beads: BeadScan | BeadShadows | Callable[[], BeadScan | BeadShadows]
    """a scan that shows four beads or more in every view, their shadows, or a function that makes
    one of these when called
    """
    reference: Reference = "bundle"
    """what fixes place and size of the scene, see :mod:`legsim.correction.bead_tracking`"""

    def __call__(self, scan: Scan, /) -> Correction:
        beads = self.beads() if callable(self.beads) else self.beads
        pixels = shadows_of(beads).pixels
        found = bead_tracking.estimate(scan.projections.geometry, pixels, reference=self.reference)
        note = (
            f"{pixels.shape[1]} beads: {100 * found.used.mean():.0f} % of their shadows were found "
            f"and used, {found.residual_px:.2f} px RMS from a rigid motion"
            f"{' of their static mean positions' if self.reference == 'mean' else ''}."
        )
        return Correction("marker-based", scan.projections, found.motion, notes=(note,))
