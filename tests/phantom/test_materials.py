"""Attenuation of tissues: against published tables, and by the laws of mixtures and spectra."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.phantom import materials
from legsim.scan import spectrum


@pytest.mark.parametrize(
    ("name", "energy_kev", "mass_attenuation"),
    [
        # NIST (Hubbell and Seltzer 1995), table 4, cm^2/g with coherent scattering
        ("water", 60.0, 0.2059),
        ("water", 100.0, 0.1707),
        ("cortical_bone", 60.0, 0.3148),
        ("cortical_bone", 100.0, 0.1855),
        ("muscle", 60.0, 0.2048),
        ("fat", 60.0, 0.1974),
        ("aluminum", 60.0, 0.2778),
        ("lead", 60.0, 5.021),
    ],
)
def test_attenuation_agrees_with_nist_within_one_percent(name, energy_kev, mass_attenuation):
    expected = 0.1 * materials.material(name).density * mass_attenuation
    assert materials.attenuation(name, energy_kev) == pytest.approx(expected, rel=0.012)


def test_every_composition_is_whole_and_every_attenuation_falls_with_energy():
    for name in materials.names():
        composition = materials.material(name).composition
        assert sum(f for _, f in composition) == pytest.approx(1, abs=0.003), name
        assert len({s for s, _ in composition}) == len(composition)
    for name in (
        "skin",
        "fat",
        "muscle",
        "tendon",
        "cartilage",
        "cortical_bone",
        "cancellous_bone",
        "yellow_marrow",
        "water",
    ):
        values = [materials.attenuation(name, e) for e in (20.0, 40.0, 60.0, 80.0, 120.0)]
        assert values == sorted(values, reverse=True), name


def test_tissues_are_ordered_as_on_a_radiograph():
    order = [
        "air",
        "fat",
        "muscle",
        "cartilage",
        "cancellous_bone",
        "cortical_bone",
        "titanium",
        "tantalum",
    ]
    values = [materials.attenuation(name) for name in order]
    assert values == sorted(values)
    assert (
        materials.attenuation("yellow_marrow")
        < materials.attenuation("muscle")
        < materials.attenuation("skin") * 1.05
    )


def test_a_spectrum_of_one_line_is_monochromatic_and_hardening_lowers_thick_integrals():
    single = spectrum.Spectrum(np.array([60.0]), np.array([3.0]))
    paths = np.array([[0.01, 0.1], [0.05, 0.0]])
    both = np.stack([single.attenuations(name) for name in ("cortical_bone", "muscle")])
    np.testing.assert_allclose(single.line_integral(both, paths), (paths @ both)[:, 0], rtol=1e-12)
    broad = spectrum.Spectrum(np.array([40.0, 60.0, 90.0]), np.array([1.0, 2.0, 1.0]))
    lengths = np.array([[1e-6], [0.1], [1.0], [50.0]])
    effective = (
        broad.line_integral(broad.attenuations("cortical_bone")[None], lengths) / lengths[:, 0]
    )
    assert (np.diff(effective) < 0).all()
    assert effective[0] == pytest.approx(
        broad.attenuations("cortical_bone") @ broad.weights, rel=1e-3
    )
    assert effective[-1] == pytest.approx(materials.attenuation("cortical_bone", 90.0), rel=1e-2)


def test_water_read_as_of_water_is_linear_and_noise_below_zero_stays():
    broad = spectrum.Spectrum(np.array([30.0, 60.0, 90.0]), np.array([1.0, 2.0, 1.0]))
    lengths = np.array([0.0, 1e-4, 0.013, 0.2, 1.0, 1.99, 3.0])
    water = broad.attenuations("water")
    found = broad.as_of_water(broad.line_integral(water[None], lengths[:, None]))
    np.testing.assert_allclose(found, lengths * (broad.weights @ water), rtol=1e-3)
    np.testing.assert_array_equal(broad.as_of_water([-0.5, -1e-3]), [-0.5, -1e-3])


def test_refusals_name_the_cure():
    with pytest.raises(
        LegsimError, match=r"unknown material 'bone'; known: skin, fat.*attenuation_per_mm"
    ):
        materials.attenuation("bone")
    with pytest.raises(LegsimError, match="outside 5 to 800 keV"):
        materials.attenuation("water", 2.0)
    with pytest.raises(LegsimError, match="not all zero"):
        spectrum.Spectrum(np.array([60.0]), np.array([0.0]))
