"""Error curves over the noise's factor cross the limit."""

import numpy as np

from legsim import figures
from legsim.figures import ErrorLine, ErrorPanel


def test_errors_fall_with_the_factor_and_cross_the_limit():
    exponents = np.arange(4.0)
    lines = (
        ErrorLine("SI", exponents, 10.0**-exponents),
        ErrorLine("paper", exponents, np.array([5.0, 1.0, 0.1, 0.0]), published=True),
    )
    panels = [
        ErrorPanel(title, axis, 1.0, lines)
        for title, axis in (("both", "translation (mm)"), ("one", "translation (mm)"))
    ]
    figure = figures.error_lines(panels)
    left, right = figure.axes[:2]
    assert left.get_yscale() == "log"
    assert left.get_ylim() == right.get_ylim()
    curve, published, limit = (np.asarray(line.get_ydata()) for line in left.lines)
    np.testing.assert_allclose(curve, 10.0**-exponents)
    assert np.isnan(published[3])  # zero has no place
    assert left.lines[1].get_linestyle() == "None"
    assert set(limit) == {1.0}
    assert [t.get_text() for t in figure.legends[0].get_texts()] == ["SI", "paper"]
    assert "1 mm" in [t.get_text() for t in left.texts]
