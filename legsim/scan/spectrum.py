"""Spectra: a tube's, by SpekPy's model, or a table of the user."""

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from legsim.core import files
from legsim.core.errors import LegsimError, file_error
from legsim.core.values import FloatArray, frozen
from legsim.phantom.materials import ENERGY_RANGE_KEV, attenuation

_RAYS_AT_ONCE = 4096


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """Photons by energy, as the detector weights them."""

    energies_kev: FloatArray
    """(e,)"""
    weights: FloatArray
    """(e,) of sum 1"""

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "energies_kev", frozen("Spectrum.energies_kev", self.energies_kev, (None,))
        )
        weights = frozen("Spectrum.weights", self.weights, (len(self.energies_kev),))
        with np.errstate(over="ignore"):
            total = weights.sum()
        if not (np.isfinite(total) and (weights >= 0).all() and total > 0):
            raise LegsimError(
                "Spectrum.weights must be finite, their sum too, not negative, and not all zero"
            )
        object.__setattr__(
            self, "weights", frozen("Spectrum.weights", weights / total, weights.shape)
        )

    def attenuations(self, name: str) -> FloatArray:
        """Linear attenuations (e,) in 1/m of a material at each energy."""
        return np.array([attenuation(name, float(energy)) for energy in self.energies_kev])

    def line_integral(self, attenuations: ArrayLike, path_lengths: ArrayLike) -> FloatArray:
        """Line integrals -ln of the transmitted share (...,) through several materials.

        Path lengths (..., m) are in m, ``attenuations`` (m, e) in 1/m.
        """
        coefficients, lengths = np.asarray(attenuations, float), np.asarray(path_lengths, float)
        # energies without photons leave nothing of a thick object's, or of its transmission
        present = slice(None) if self.weights.all() else self.weights > 0
        coefficients, weights = coefficients[:, present], self.weights[present]
        rays = lengths.reshape(-1, lengths.shape[-1])
        integrals = np.zeros(len(rays))
        met = np.flatnonzero(rays.any(-1))
        for chosen in np.array_split(met, max(1, len(met) // _RAYS_AT_ONCE)):
            exponents = rays[chosen] @ coefficients
            least = exponents.min(
                -1, keepdims=True
            )  # factored out of the sum, so that thick objects do not underflow
            integrals[chosen] = least[:, 0] - np.log(np.exp(least - exponents) @ weights)
        return integrals.reshape(lengths.shape[:-1])

    def as_of_water(self, line_integrals: ArrayLike) -> FloatArray:
        """Line integrals without the beam hardening that water would have caused.

        The result is what water of the same transmission would have at its mean attenuation. Below
        0, where only noise leads, nothing changes; beyond 2 m of water the last slope continues.
        """
        values, water = np.asarray(line_integrals, float), self.attenuations("water")
        lengths = np.linspace(0.0, 2.0, 4001)
        measured, mean = (
            self.line_integral(water[None], lengths[:, None]),
            float(self.weights @ water),
        )
        beyond = (lengths[-1] - lengths[-2]) / (measured[-1] - measured[-2])
        inside = mean * np.interp(values, measured, lengths)
        return np.where(
            values < 0, values, inside + mean * beyond * np.maximum(values - measured[-1], 0)
        )


Response = Literal["energy", "count"]

_HEADER = ["energy_kev", "weight"]

_BIN_KEV = 1.0


def tube(
    *, kvp: float, anode_deg: float, aluminum_mm: float, copper_mm: float, response: Response
) -> Spectrum:
    """Spectrum of a tungsten tube behind filters, in bins of 1 keV.

    Model: SpekPy (Poludniowski et al., Med. Phys. 48 (2021) 3630). ``response`` "energy" weights
    each photon by its energy, as a flat panel that absorbs all of them does; "count" weights all
    alike.

    Raises:
        LegsimError: SpekPy is not installed, or has no spectrum for these values.
    """
    try:
        import spekpy  # pyright: ignore[reportMissingImports]  # an extra: heavy, and only this needs it
    except ImportError:
        raise LegsimError(
            "a tube's spectrum needs SpekPy, which is not installed: pip install "
            "'legsim[spectra]', or give your own table"
        ) from None
    try:
        model = spekpy.Spek(kvp=kvp, th=anode_deg, dk=_BIN_KEV)
        columns = model.filter("Al", aluminum_mm).filter("Cu", copper_mm).get_spectrum()
        energies, fluence = (np.asarray(column, float) for column in columns)
    except Exception as error:  # SpekPy raises bare exceptions
        raise LegsimError(
            f"SpekPy has no spectrum for {kvp:g} kV and an anode of {anode_deg:g} degrees "
            f"({error}); choose 30 to 300 kV, 6 to 20 degrees"
        ) from error
    kept = (energies >= ENERGY_RANGE_KEV[0]) & (fluence > 0)
    weights = fluence * energies if response == "energy" else fluence
    return Spectrum(energies[kept], weights[kept])


def load(path: Path | str) -> Spectrum:
    """Reads a table ``energy_kev,weight``, one line per photon energy.

    Weights are photons as the detector weights them, in any unit.

    Raises:
        LegsimError: not such a table, or an energy without cross sections.
    """
    path = Path(path)
    reader = csv.reader(files.read(path, "CSV"))
    rows = [(f"line {reader.line_num}", [cell.strip() for cell in row]) for row in reader if row]
    place, header = rows[0]
    if header != _HEADER:
        raise file_error(
            path,
            f"the header is {','.join(header)!r}",
            f"start the table with {','.join(_HEADER)}",
            place=place,
        )
    table = []
    for place, row in rows[1:]:
        try:
            energy, weight = (float(cell) for cell in row)
        except ValueError:
            raise file_error(
                path,
                f"{','.join(row)!r} is not two numbers",
                "write an energy in keV and a weight",
                place=place,
            ) from None
        low, high = ENERGY_RANGE_KEV
        if not (low <= energy <= high and 0 <= weight < np.inf):
            raise file_error(
                path,
                f"{','.join(row)!r}",
                f"give energies of {low:g} to {high:g} keV and weights from 0",
                place=place,
            )
        table.append((energy, weight))
    try:
        energies, weights = np.array(table, float).reshape(-1, 2).T
        return Spectrum(energies, weights)
    except LegsimError as error:
        raise file_error(path, str(error), "fix the table") from error
