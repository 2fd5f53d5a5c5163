import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.phantom.meshes import Part, Phantom

CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def tetrahedron(name="a", **changes) -> Part:
    return Part(
        **(
            {
                "name": name,
                "material": "water",
                "attenuation": 20.0,
                "vertices": CORNERS,
                "triangles": FACES,
            }
            | changes
        )
    )


def test_moving_a_phantom_keeps_all_but_the_vertices():
    moved = Phantom((tetrahedron("a"), tetrahedron("b"))).with_vertices((CORNERS + 1, CORNERS))
    np.testing.assert_array_equal(moved.parts[0].vertices, CORNERS + 1)
    assert moved.parts[0].name == "a"
    assert moved.parts[1].attenuation == 20.0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: tetrahedron(triangles=np.array([[0, 1, 4]])),
            r"vertices it does not have \(0..3\)",
        ),
        (lambda: tetrahedron(vertices=CORNERS * np.nan), "not a finite number"),
        (lambda: tetrahedron(attenuation=-1.0), "at least 0"),
        (lambda: Phantom((tetrahedron(), tetrahedron())), "repeated: a"),
        (lambda: Phantom(()), "it has no part"),
    ],
)
def test_impossible_values_are_refused(make, message):
    with pytest.raises(LegsimError, match=message):
        make()
