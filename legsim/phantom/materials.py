"""Linear attenuation of tissues and implants at a photon energy.

Compositions are ICRU's, cross sections xraylib's.
"""

from dataclasses import dataclass

import xraylib

from legsim.core.errors import LegsimError

DEFAULT_ENERGY_KEV = 60.0
"""monochromatic default: about the mean energy of a filtered 90 to 120 kV C-arm spectrum"""

ENERGY_RANGE_KEV = (5.0, 800.0)
"""range of the tables: no edges of the tissues' elements, and xraylib's totals are valid"""


@dataclass(frozen=True, slots=True)
class Material:
    """A mixture of elements."""

    name: str
    density: float
    """kg/m^3"""
    composition: tuple[tuple[str, float], ...]
    """(element symbol, mass fraction); the fractions sum to 1 within the rounding of the tables"""


def _tissue(name: str, density: float, **mass_percent: float) -> Material:
    return Material(
        name, density, tuple((symbol, percent / 100) for symbol, percent in mass_percent.items())
    )


# ICRU Report 44 (1989) and 46 (1992), adult; tendon and meniscus: connective tissue of Woodard and
# White, Br. J. Radiol. 59 (1986) 1209
_MATERIALS = (
    _tissue("skin", 1090, H=10.0, C=20.4, N=4.2, O=64.5, Na=0.2, P=0.1, S=0.2, Cl=0.3, K=0.1),
    _tissue("fat", 950, H=11.4, C=59.8, N=0.7, O=27.8, Na=0.1, S=0.1, Cl=0.1),
    _tissue("muscle", 1050, H=10.2, C=14.3, N=3.4, O=71.0, Na=0.1, P=0.2, S=0.3, Cl=0.1, K=0.4),
    _tissue("tendon", 1120, H=9.4, C=20.7, N=6.2, O=62.2, Na=0.6, S=0.6, Cl=0.3),
    _tissue("meniscus", 1120, H=9.4, C=20.7, N=6.2, O=62.2, Na=0.6, S=0.6, Cl=0.3),
    _tissue("cartilage", 1100, H=9.6, C=9.9, N=2.2, O=74.4, Na=0.5, P=2.2, S=0.9, Cl=0.3),
    _tissue(
        "cortical_bone", 1920, H=3.4, C=15.5, N=4.2, O=43.5, Na=0.1, Mg=0.2, P=10.3, S=0.3, Ca=22.5
    ),
    _tissue(
        "cancellous_bone",
        1180,
        H=8.5,
        C=40.4,
        N=2.8,
        O=36.7,
        Na=0.1,
        Mg=0.1,
        P=3.4,
        S=0.2,
        Cl=0.2,
        K=0.1,
        Ca=7.4,
        Fe=0.1,
    ),
    _tissue("yellow_marrow", 980, H=11.5, C=64.4, N=0.7, O=23.1, Na=0.1, S=0.1, Cl=0.1),
    _tissue("red_marrow", 1030, H=10.5, C=41.4, N=3.4, O=43.9, P=0.1, S=0.2, Cl=0.2, K=0.2, Fe=0.1),
    _tissue(
        "blood", 1060, H=10.2, C=11.0, N=3.3, O=74.5, Na=0.1, P=0.1, S=0.2, Cl=0.3, K=0.2, Fe=0.1
    ),
    _tissue(
        "soft_tissue", 1060, H=10.2, C=14.3, N=3.4, O=70.8, Na=0.2, P=0.3, S=0.3, Cl=0.2, K=0.3
    ),
    _tissue("water", 998.2, H=11.1898, O=88.8102),
    _tissue("air", 1.205, C=0.0124, N=75.5268, O=23.1781, Ar=1.2827),
    _tissue("pmma", 1190, H=8.0538, C=59.9848, O=31.9614),
    _tissue("aluminum", 2699, Al=100),
    _tissue("titanium", 4540, Ti=100),
    _tissue("steel", 7900, Fe=69.5, Cr=19.0, Ni=9.5, Mn=2.0),
    _tissue("cobalt_chromium", 8300, Co=65.5, Cr=28.5, Mo=6.0),
    _tissue("tantalum", 16654, Ta=100),
    _tissue("tungsten", 19300, W=100),
    _tissue("lead", 11350, Pb=100),
)

_BY_NAME = {material.name: material for material in _MATERIALS}


def names() -> tuple[str, ...]:
    """Names of all materials."""
    return tuple(_BY_NAME)


def material(name: str) -> Material:
    """Finds the material of that name.

    Raises:
        LegsimError: unknown material; the message lists the known ones.
    """
    if name not in _BY_NAME:
        raise LegsimError(
            f"unknown material {name!r}; known: {', '.join(_BY_NAME)}; or state attenuation_per_mm"
        )
    return _BY_NAME[name]


def attenuation(name: str, energy_kev: float = DEFAULT_ENERGY_KEV) -> float:
    """Linear attenuation in 1/m of a material for photons of one energy.

    Coherent scattering is included.

    Raises:
        LegsimError: unknown material, or an energy outside ENERGY_RANGE_KEV.
    """
    low, high = ENERGY_RANGE_KEV
    if not low <= energy_kev <= high:
        raise LegsimError(
            f"photon energy {energy_kev} keV is outside {low:g} to {high:g} keV, where cross "
            "sections are tabulated"
        )
    chosen = material(name)
    total = sum(fraction for _, fraction in chosen.composition)
    mass_attenuation = sum(
        f * xraylib.CS_Total(xraylib.SymbolToAtomicNumber(s), float(energy_kev))
        for s, f in chosen.composition
    )
    # cm^2/g times kg/m^3 is 0.1/m
    return 0.1 * chosen.density * mass_attenuation / total
