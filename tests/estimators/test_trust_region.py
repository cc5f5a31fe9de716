"""The optimiser on a model whose minimum is known, and the derivatives of the model of rotations."""

import numpy as np
import pytest

import data_gen
from fmsync import so
from fmsync.energy import gradient, hessian
from fmsync.estimators.trust_region import Point, Rotations, minimise


class Quadratic:
    """½ xᵀ A x - bᵀ x on a plain vector space."""

    dimension, diameter, magnitude = 6, 100.0, 1.0

    def __init__(self, eigenvalues):
        rng = np.random.default_rng(0)
        q, _ = np.linalg.qr(rng.standard_normal((6, 6)))
        self.a, self.b = (q * eigenvalues) @ q.T, rng.standard_normal(6)

    def evaluate(self, x):
        return Point(x, float(x @ self.a @ x / 2 - self.b @ x), self.a @ x - self.b, None)

    def hessian(self, point, direction):
        return self.a @ direction

    def preconditioner(self, point):
        return np.ones(6)

    def retract(self, point, step):
        return point.absolute + step


def test_a_quadratic_is_minimised():
    model, seen = Quadratic(np.geomspace(1, 100, 6)), []
    found, converged, trace = minimise(
        model, np.zeros(6), tolerance=1e-10, max_iterations=50, callback=lambda *values: seen.append(values)
    )
    assert converged
    np.testing.assert_allclose(found, np.linalg.solve(model.a, model.b), atol=1e-10)
    assert (np.diff(trace.cost) <= 0).all()
    assert [values[0] for values in seen] == list(range(len(trace.cost)))


def test_a_direction_of_negative_curvature_is_followed_to_the_boundary_and_the_limit_is_kept():
    model = Quadratic([-1.0, 1, 2, 3, 4, 5])
    _, converged, trace = minimise(model, np.zeros(6), tolerance=1e-10, max_iterations=3)
    assert not converged
    assert len(trace.cost) == 4
    assert trace.cost[-1] < -100  # unbounded: every radius is used


@pytest.mark.parametrize("sparse", [False, True])
def test_rotations_know_the_derivatives_of_the_energy(sparse):
    graph = data_gen.random_graph(12, 0.3 if sparse else 1.0, rng=0)
    p = data_gen.perturb(data_gen.planted(12, 4, graph, rng=0), 0.1, 1)
    assert p.is_dense != sparse
    model, c = Rotations(p), so.random_uniform(4, 12, rng=1)
    point, direction = model.evaluate(c), so.skew(np.random.default_rng(2).standard_normal(c.shape))
    np.testing.assert_allclose(point.gradient, gradient(p, c), atol=1e-12)
    rounding = 1e-4 if sparse else 1e-12  # products of sparse graphs are in single precision
    np.testing.assert_allclose(model.hessian(point, direction), hessian(p, c, direction), atol=rounding)
    assert (model.preconditioner(point) > 0).all()
