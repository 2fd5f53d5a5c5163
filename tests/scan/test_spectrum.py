"""Spectra from the tube model and from tables: known values, the laws of filters, refusals that
name the line.
"""

import sys

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.phantom import materials
from legsim.scan import spectrum as scan_spectrum
from legsim.scan.spectrum import Spectrum


def mean_energy(spectrum: Spectrum) -> float:
    return float(spectrum.energies_kev @ spectrum.weights)


def tube(**changes) -> Spectrum:
    pytest.importorskip("spekpy", reason="pip install 'legsim[spectra]'")
    settings = {
        "kvp": 90.0,
        "anode_deg": 12.0,
        "aluminum_mm": 3.0,
        "copper_mm": 0.1,
        "response": "count",
    }
    return scan_spectrum.tube(**(settings | changes))


def test_a_tubes_spectrum_ends_at_its_voltage_and_carries_the_lines_of_tungsten():
    spectrum = tube()
    assert 88 < spectrum.energies_kev.max() <= 90
    at = dict(
        zip(
            np.floor(spectrum.energies_kev).astype(int).tolist(),
            spectrum.weights.tolist(),
            strict=True,
        )
    )
    lines = max(at[k] for k in (57, 58, 59))  # K-alpha at 58.0 and 59.3 keV
    assert lines > 1.5 * at[63]
    assert 40 < mean_energy(spectrum) < 60


def test_filters_act_by_beer_and_lambert_and_the_response_weighs_by_energy():
    """More aluminum takes the xraylib attenuation of aluminum; SpekPy brings tables of its own."""
    thin, thick = tube(copper_mm=0.0), tube(copper_mm=0.0, aluminum_mm=8.0)
    energies = thin.energies_kev[thin.energies_kev > 30]
    of_thin, of_thick = (np.interp(energies, s.energies_kev, s.weights) for s in (thin, thick))
    through = np.exp(-5e-3 * np.array([materials.attenuation("aluminum", e) for e in energies]))
    ratio = of_thick / of_thin / through
    np.testing.assert_allclose(ratio / ratio[-1], 1, rtol=0.03)
    weighed, counted = tube(response="energy"), tube()
    np.testing.assert_allclose(
        weighed.weights / counted.weights / counted.energies_kev,
        1 / mean_energy(counted),
        rtol=1e-9,
    )


def test_what_the_tube_model_cannot_do_is_reported():
    with pytest.raises(LegsimError, match=r"no spectrum for 2000 kV.*choose 30 to 300 kV"):
        tube(kvp=2000.0)


def test_a_missing_tube_model_is_reported(monkeypatch):
    monkeypatch.setitem(sys.modules, "spekpy", None)
    with pytest.raises(LegsimError, match=r"pip install 'legsim\[spectra\]'"):
        scan_spectrum.tube(kvp=90, anode_deg=12, aluminum_mm=3, copper_mm=0, response="energy")


def test_a_table_is_read_and_normalized(tmp_path):
    path = tmp_path / "s.csv"
    path.write_text("energy_kev, weight\n40, 1\n\n60.5, 3e2\n")
    spectrum = scan_spectrum.load(path)
    np.testing.assert_array_equal(spectrum.energies_kev, [40, 60.5])
    np.testing.assert_allclose(spectrum.weights, [1 / 301, 300 / 301])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("energy,weight\n40,1\n", r"line 1.*start the table with energy_kev,weight"),
        ("energy_kev,weight\n40\n", r"line 2.*'40' is not two numbers"),
        ("energy_kev,weight\n40,x\n", r"line 2.*not two numbers"),
        ("energy_kev,weight\n40,1\n2,1\n", r"line 3.*5 to 800 keV"),
        ("\nenergy_kev,weight\n40,1\n\n2,1\n", r"line 5.*5 to 800 keV"),
        ("energy_kev,weight\n40,1e308\n50,1e308\n", r"their sum too.*fix the table"),
        ("energy_kev,weight\n40,-1\n", r"line 2.*weights from 0"),
        ("energy_kev,weight\n40,nan\n", r"line 2.*weights from 0"),
        ("energy_kev,weight\n40,0\n", r"not all zero.*fix the table"),
        ("energy_kev,weight\n", r"fix the table"),
        ("", r"s.csv"),
    ],
)
def test_tables_that_are_none_are_refused(tmp_path, text, message):
    (tmp_path / "s.csv").write_text(text)
    with pytest.raises(LegsimError, match=message):
        scan_spectrum.load(tmp_path / "s.csv")


def test_a_table_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(LegsimError, match=r"no\.csv"):
        scan_spectrum.load(tmp_path / "no.csv")


def test_an_energy_without_photons_changes_nothing():
    """Behind 12 cm of titanium too, where only the missing energy would pass."""
    alone, beside = Spectrum([20.0], [1.0]), Spectrum([20.0, 150.0], [1.0, 0.0])
    lengths = np.array([[0.0], [0.01], [0.12]])
    np.testing.assert_allclose(
        beside.line_integral(beside.attenuations("titanium")[None], lengths),
        alone.line_integral(alone.attenuations("titanium")[None], lengths),
        rtol=1e-12,
    )
