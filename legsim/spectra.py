"""Where a spectrum comes from: a tube's, by SpekPy's model, or a table of one's own."""

import csv
from pathlib import Path
from typing import Literal

import numpy as np

from legsim import text_lines
from legsim.errors import LegsimError, at
from legsim.materials import ENERGY_RANGE_KEV, Spectrum

Response = Literal["energy", "count"]
_HEADER = ["energy_kev", "weight"]
_BIN_KEV = 1.0


def tube(*, kvp: float, anode_deg: float, aluminum_mm: float, copper_mm: float, response: Response) -> Spectrum:
    """A tungsten tube's spectrum behind filters, in bins of 1 keV (SpekPy: Poludniowski et al., Med. Phys. 48 (2021) 3630).

    ``response`` "energy" weighs each photon by its energy, as a flat panel that stops them all does; "count" weighs all alike.

    Raises:
        LegsimError: SpekPy is not installed, or has no spectrum for these values.
    """
    try:
        import spekpy  # pyright: ignore[reportMissingImports]  # an extra: heavy, and only this needs it
    except ImportError:
        raise LegsimError(
            "a tube's spectrum needs SpekPy, which is not installed: pip install 'legsim[spectra]', or give a table of your own"
        ) from None
    try:
        model = spekpy.Spek(kvp=kvp, th=anode_deg, dk=_BIN_KEV)
        columns = model.filter("Al", aluminum_mm).filter("Cu", copper_mm).get_spectrum()
        energies, fluence = (np.asarray(column, float) for column in columns)
    except Exception as error:  # SpekPy raises bare exceptions
        raise LegsimError(
            f"SpekPy has no spectrum for {kvp:g} kV and an anode of {anode_deg:g} degrees ({error}); choose 30 to 300 kV, 6 to 20 degrees"
        ) from error
    kept = (energies >= ENERGY_RANGE_KEV[0]) & (fluence > 0)
    weights = fluence * energies if response == "energy" else fluence
    return Spectrum(energies[kept], weights[kept])


def load(path: Path | str) -> Spectrum:
    """Reads a table ``energy_kev,weight``, a line a photon energy: photons as the detector weighs them, in any unit.

    Raises:
        LegsimError: not such a table, or an energy where no cross sections are.
    """
    path = Path(path)
    reader = csv.reader(text_lines.read(path, "CSV"))
    rows = [(f"line {reader.line_num}", [cell.strip() for cell in row]) for row in reader if row]
    place, header = rows[0]
    if header != _HEADER:
        raise at(path, f"the header is {','.join(header)!r}", f"start the table with {','.join(_HEADER)}", place=place)
    table = []
    for place, row in rows[1:]:
        try:
            energy, weight = (float(cell) for cell in row)
        except ValueError:
            raise at(path, f"{','.join(row)!r} is not two numbers", "write an energy in keV and a weight", place=place) from None
        low, high = ENERGY_RANGE_KEV
        if not (low <= energy <= high and 0 <= weight < np.inf):
            raise at(path, f"{','.join(row)!r}", f"give energies of {low:g} to {high:g} keV and weights from 0", place=place)
        table.append((energy, weight))
    try:
        energies, weights = np.array(table, float).reshape(-1, 2).T
        return Spectrum(energies, weights)
    except LegsimError as error:
        raise at(path, str(error), "mend the table") from error
