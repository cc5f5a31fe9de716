"""Checks of arguments: what passes is returned, what does not is named."""

import numpy as np
import pytest

from fmsync import checks, so


def test_what_passes_is_returned():
    assert checks.count("n", np.int64(3)) == 3
    assert checks.count("n", 0, least=0) == 0
    assert checks.positive("step", 2) == 2.0
    assert checks.not_negative("sigma2", 0) == 0.0
    assert checks.probability("level", 0.5) == 0.5
    np.testing.assert_array_equal(checks.indices("vertices", [2, 0], 3), [2, 0])
    np.testing.assert_array_equal(checks.edge_weights(None, np.zeros((2, 2))), [1, 1])
    checks.one_of("energy", "geodesic", ("euclidean", "geodesic"))
    checks.rotations("maps", so.random_uniform(4, 3, rng=0))
    edges = np.array([[0, 1], [1, 2]], dtype=np.int32)
    copied = checks.connected_edges(3, edges)
    edges[:] = 0
    assert copied.dtype == np.int64
    assert copied.tolist() == [[0, 1], [1, 2]]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: checks.count("n", 2.5), "n: an integer >= 1, got 2.5"),
        (lambda: checks.count("n", "3"), "n: an integer >= 1, got 3"),
        (lambda: checks.count("n", np.nan), "n: an integer >= 1, got nan"),
        (lambda: checks.count("n", 1, least=2), "n: an integer >= 2, got 1"),
        (lambda: checks.one_of("energy", "free", ("euclidean", "geodesic")), "energy: 'euclidean' or 'geodesic', not"),
        (lambda: checks.positive("step", 0.0), "step: must be finite and > 0, got 0.0"),
        (lambda: checks.positive("step", np.inf), "step: must be finite and > 0, got inf"),
        (lambda: checks.not_negative("sigma2", -1), "sigma2: must be finite and >= 0, got -1"),
        (lambda: checks.probability("level", 1.0), "level: must lie strictly between 0 and 1, got 1.0"),
        (lambda: checks.indices("vertices", [0, 3], 3), r"vertices\[1\] = 3 is outside the vertices 0..2"),
        (lambda: checks.indices("vertices", [0.0], 3), "vertices: must be a row of integers, got float64"),
        (lambda: checks.indices("vertices", [[0]], 3), r"vertices: must be a row of integers, .* shape \(1, 1\)"),
        (lambda: checks.edge_weights([1.0], np.zeros((2, 2))), r"weights: expected \(2,\), got \(1,\)"),
        (lambda: checks.edge_weights([1, -1], np.array([[0, 1], [1, 2]])), r"edge 1 \(1, 2\) has weight -1.0"),
        (lambda: checks.rotations("maps", -np.eye(3)[None]), "maps: node 0 is not a rotation"),
        (lambda: checks.connected_edges(4, [[0, 1], [2, 3]]), r"2 components \(0, 1; 2, 3\)"),
    ],
)
def test_what_does_not_pass_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()
