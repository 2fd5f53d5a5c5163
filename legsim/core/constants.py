"""Physical constants, in SI units."""

from legsim.core.values import frozen

STANDARD_GRAVITY = 9.80665
"""m/s^2, one g (3rd General Conference on Weights and Measures, 1901)"""

GRAVITY_WORLD = frozen("gravity", (0.0, -STANDARD_GRAVITY, 0.0), (3,))
