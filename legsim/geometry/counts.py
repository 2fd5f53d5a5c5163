"""From detector counts to line integrals: dark and flat fields, air, bad pixels, the logarithm.

A line integral is -ln((counts - dark) / reference), the reference being what the pixel reads, dark
subtracted, where nothing stands in the beam: of one number, of a part of each view that sees air,
or of a flat field.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from legsim.core.errors import LegsimError
from legsim.core.values import Float32Array, FloatArray
from legsim.geometry import bad_pixels

THICKEST = 20.0
"""line integral that no body reaches: two photons of a billion would pass, 1 m of water stops 20"""

_BELOW_AIR = -0.2
"""line integral below which no noise of a scanner brings a twentieth of the pixels"""

_FEW = 1e-3
"""share of pixels that may lie beyond a physical limit: bad pixels, metal"""

_MOST_BAD = 0.2
"""share of a view's pixels that may be interpolated"""

_OFF_AIR = 0.05
"""line integral by which a reading at the end of the range may differ from air's"""

_CURE = "say how counts become line integrals: i0 (the reading without an object), air (a part of "
_CURE += "each view that sees none), or a flat field; or that they are line integrals"


@dataclass(frozen=True, slots=True)
class Region:
    """Columns and rows of a view, the last ones not included."""

    columns: tuple[int, int]
    rows: tuple[int, int]

    @classmethod
    def parsed(cls, text: str) -> "Region":
        """Of "X0:X1,Y0:Y1".

        Raises:
            LegsimError: it is none.
        """
        try:
            (x0, x1), (y0, y1) = (map(int, part.split(":")) for part in text.split(","))
        except ValueError:
            raise LegsimError(
                f"{text!r} is no region; give columns and rows as in 0:20,0:480"
            ) from None
        return cls((x0, x1), (y0, y1))

    def of(self, images: NDArray) -> NDArray:
        """The part of images (…, rows, columns).

        Raises:
            LegsimError: it is empty or reaches beyond the detector.
        """
        rows, columns = images.shape[-2:]
        inside = (
            0 <= self.columns[0] < self.columns[1] <= columns
            and 0 <= self.rows[0] < self.rows[1] <= rows
        )
        if not inside:
            raise LegsimError(
                f"air region of columns {self.columns[0]} to {self.columns[1]} and rows "
                f"{self.rows[0]} to {self.rows[1]} is not part of {columns} columns and {rows} "
                "rows; give X0:X1,Y0:Y1 inside the detector"
            )
        return images[..., slice(*self.rows), slice(*self.columns)]


@dataclass(frozen=True, slots=True, eq=False)
class Counts:
    """How counts become line integrals: by ``i0``, ``air`` or ``flat`` (also with ``air``)."""

    i0: float | None = None
    """reading without an object, the dark reading included"""
    air: Region | None = None
    """what sees no object in any view: each view is scaled so that it is 0 there in the median; the
    text of :meth:`Region.parsed` is taken too
    """
    flat: FloatArray | None = None
    """(rows, columns) readings without an object"""
    dark: FloatArray | None = None
    """(rows, columns) readings without a beam"""
    bad: NDArray[np.bool_] | None = None
    """(rows, columns) pixels that are known to be wrong"""

    def __post_init__(self) -> None:
        if isinstance(self.air, str):
            object.__setattr__(self, "air", Region.parsed(self.air))
        if self.i0 is not None and not (np.isfinite(self.i0) and self.i0 > 0):
            raise LegsimError(f"i0 is {self.i0:g}; give the positive reading without an object")
        if self.i0 is not None and (self.air is not None or self.flat is not None):
            raise LegsimError("i0 and air or flat both say the reading without an object; give one")
        if self.i0 is None and self.air is None and self.flat is None:
            raise LegsimError(f"a dark field or bad pixels alone make no line integrals; {_CURE}")


@dataclass(frozen=True, slots=True, eq=False)
class Integrals:
    """Line integrals and what became of the counts."""

    values: Float32Array
    """(v, rows, columns)"""
    notes: tuple[str, ...] = ()


def line_integrals(images: NDArray, counts: Counts) -> Integrals:
    """Turns images (v, rows, columns) of counts into line integrals.

    Pixels are interpolated from their neighbors where they are given as bad, read nothing in the
    flat field or in all views, or stand out and never change; and in single views where they read
    nothing or are saturated.

    Raises:
        LegsimError: fields of another size, a reading without an object that is none, over a fifth
            of a view bad, or results that no scan gives.
    """
    for name in ("flat", "dark", "bad"):
        field = getattr(counts, name)
        if field is not None and field.shape != images.shape[1:]:
            raise LegsimError(
                f"the {name} image has {field.shape[::-1]} columns and rows, the views "
                f"{images.shape[:0:-1]}; give one of this detector"
            )
    dark = np.zeros(images.shape[1:]) if counts.dark is None else np.asarray(counts.dark, float)
    reference = _reference(images, dark, counts)
    found = bad_pixels.find(images, dark, reference, counts.bad)
    values = np.empty(images.shape, np.float32)
    single = 0
    for view, image in enumerate(images):
        integrals, wrong = _of_view(image, dark, reference, found, counts, view)
        single += int((wrong & ~found.always).sum())
        values[view] = bad_pixels.interpolated(integrals, wrong)
    _check_result(values, counts)
    return Integrals(values, found.notes(single, len(images)))


def _of_view(
    image: NDArray,
    dark: FloatArray,
    reference: FloatArray,
    found: bad_pixels.BadPixels,
    counts: Counts,
    view: int,
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """(line integrals, pixels to be interpolated) of one view (rows, columns)."""
    signal = image.astype(float) - dark
    wrong = found.always | ~(signal > 0) | ~np.isfinite(signal)
    with np.errstate(divide="ignore", invalid="ignore"):
        integrals = -np.log(signal / reference)
    if counts.air is not None:
        seen = counts.air.of(integrals)[~counts.air.of(wrong)]
        if not seen.size:
            raise LegsimError(f"view {view}: no good pixel in the air region; give another one")
        integrals -= np.median(seen)
    # where air itself is at the end of the detector's range, that reading is right
    wrong |= (image >= found.saturation) & (np.abs(integrals) > _OFF_AIR)
    if wrong.mean() > _MOST_BAD:
        raise LegsimError(
            f"view {view}: {100 * wrong.mean():.0f} % of the pixels are bad, read nothing or are "
            "saturated; check the dark field, the map of bad pixels and the exposure"
        )
    return integrals, wrong


def _reference(images: NDArray, dark: FloatArray, counts: Counts) -> FloatArray:
    """(rows, columns) readings without an object, dark subtracted; 1 where air alone scales."""
    if counts.flat is not None:
        reference = np.asarray(counts.flat, float) - dark
    elif counts.i0 is not None:
        reference = counts.i0 - dark
    else:
        assert counts.air is not None
        counts.air.of(images)
        return np.ones(images.shape[1:])
    if np.median(reference) <= 0:
        raise LegsimError(
            "the reading without an object is below that without a beam; exchange flat and dark, "
            "or correct i0"
        )
    return reference


def _check_result(values: Float32Array, counts: Counts) -> None:
    """Refuses results that are negative for many rays: the reference is not that of air."""
    low = float(np.percentile(_sampled(values), 5))
    if low < _BELOW_AIR:
        raise LegsimError(
            f"a twentieth of all line integrals is below {low:.3g}: many pixels read more than air "
            f"should; the {'air region' if counts.air else 'reading without an object'} is wrong, "
            "or the images are inverted"
        )


def refuse_counts(images: NDArray, name: str) -> None:
    """Refuses images (v, rows, columns) that cannot be line integrals as they are.

    Raises:
        LegsimError: whole numbers, transmissions, or values beyond what a body stops; the line
            begins with ``name``.
    """
    if images.dtype.kind in "iu":
        raise LegsimError(f"{name}: holds whole numbers, counts of a detector; {_CURE}")
    thin = _sampled(images)
    thick = float((thin > THICKEST).mean())
    if thick > _FEW:
        raise LegsimError(
            f"{name}: {100 * thick:.3g} % of its values are above {THICKEST:g}, up to "
            f"{thin.max():.4g}, as no line integral is; {_CURE}"
        )
    low = float(np.percentile(thin, 5))
    if low < _BELOW_AIR and thin.mean() < 0:
        raise LegsimError(
            f"{name}: a twentieth of its values is below {low:.3g} and their mean is "
            f"{thin.mean():.3g}, but line integrals are 0 or more; turn their sign, or {_CURE}"
        )
    near_one, near_zero = (float((np.abs(thin - x) < 0.02).mean()) for x in (1.0, 0.0))
    if near_one > max(0.05, 5 * near_zero) and thin.min() > -0.05 and thin.max() < 1.2:
        raise LegsimError(
            f"{name}: looks like transmissions (air at 1, nothing at 0), not line integrals; give "
            "i0 of 1"
        )


def _sampled(images: NDArray) -> NDArray:
    """About a million of the values, from all views alike."""
    step = max(1, int(np.ceil(np.sqrt(images.size / 1e6))))
    return images[:, ::step, ::step]
