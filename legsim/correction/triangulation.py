"""Places of beads from the rays through their shadows."""

import numpy as np

from legsim.core.values import FloatArray
from legsim.geometry.cone_beam import ConeBeamGeometry


def triangulated(
    geometry: ConeBeamGeometry, pixels: FloatArray, weights: FloatArray | None = None
) -> FloatArray:
    """Points (b, 3) m nearest to the rays through their shadows (v, b, 2), as if nothing moved.

    Squared distances to the rays are summed over the views, weighted (v, b); None weights what is
    seen alike. A bead without weight is at 0.
    """
    by_view = np.isfinite(pixels).all(-1).astype(float) if weights is None else weights
    sources = geometry.sources()
    places = np.zeros((pixels.shape[1], 3))
    for bead in np.flatnonzero(by_view.any(0)):
        views = np.flatnonzero(by_view[:, bead])
        homogeneous = np.concatenate([pixels[views, bead], np.ones((len(views), 1))], -1)
        rays = np.linalg.solve(geometry.matrices[views, :, :3], homogeneous[..., None])[..., 0]
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
        across *= by_view[views, bead, None, None]
        places[bead] = np.linalg.solve(
            across.sum(0), np.einsum("vij,vj->i", across, sources[views])
        )
    return places
