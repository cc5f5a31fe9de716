"""Kernels of SO(n) against slow twins: SciPy, geomstats, closed forms."""

import numpy as np
import pytest
import scipy.linalg
from geomstats.geometry.special_orthogonal import SpecialOrthogonal

from bench.speed import logarithms_by_eigenvectors
from fmsync import so


@pytest.fixture
def rng():
    return np.random.default_rng(20)


def random_skew(rng, size, n, scale=1.0):
    return scale * so.skew(rng.standard_normal((*size, n, n)))


def rotation_with_angles(angles, rng):
    """Conjugate plane rotations by a random frame; returns (rotation, its logarithm)."""
    n = 2 * len(angles)
    block = np.zeros((n, n))
    for k, angle in enumerate(angles):
        block[2 * k + 1, 2 * k], block[2 * k, 2 * k + 1] = angle, -angle
    frame = so.random_uniform(n, (), rng)
    return frame @ scipy.linalg.expm(block) @ frame.T, frame @ block @ frame.T


class TestProject:
    def test_is_the_nearest_rotation_among_many(self, rng):
        for a in rng.standard_normal((20, 3, 3)):
            nearest = np.linalg.norm(a - so.project(a))
            others = np.linalg.norm(a - so.random_uniform(3, 5000, rng), axis=(1, 2))
            assert nearest <= others.min() + 1e-12

    def test_negative_determinant_flips_the_smallest_singular_direction(self, rng):
        a = np.array([[-2.0, 0.3, 0.0], [0.1, 1.0, 0.2], [0.0, -0.1, 0.4]])
        assert np.linalg.det(a) < 0
        u, s, vt = np.linalg.svd(a)
        best = s[0] + s[1] - s[2]  # largest trace of R^T A over rotations
        assert np.trace(so.project(a).T @ a) == pytest.approx(best, abs=1e-12)
        wrong = u @ vt
        wrong[:, -1] *= -1
        assert np.trace(wrong.T @ a) < best - 1e-3

    def test_batches_and_leaves_rotations_alone(self, rng):
        c = so.random_uniform(6, (2, 5), rng)
        np.testing.assert_allclose(so.project(c), c, atol=1e-13)
        np.testing.assert_allclose(np.linalg.det(so.project(rng.standard_normal((50, 7, 7)))), 1, atol=1e-12)


class TestQf:
    def test_matches_scipy_with_positive_diagonal(self, rng):
        a = rng.standard_normal((5, 5))
        q, r = scipy.linalg.qr(a)
        expected = q @ np.diag(np.sign(np.diag(r)))
        np.testing.assert_allclose(so.qf(a), expected, atol=1e-13)

    def test_retraction_stays_in_the_group_and_is_first_order(self, rng):
        c, omega = so.random_uniform(6, (), rng), random_skew(rng, (), 6)
        assert np.linalg.det(so.qf(c + 5 * c @ omega)) == pytest.approx(1)
        errors = [np.linalg.norm(so.qf(c + t * c @ omega) - c @ so.exp(t * omega)) for t in (1e-2, 1e-3)]
        assert np.log10(errors[0] / errors[1]) == pytest.approx(2, abs=0.1)


class TestRetractions:
    def test_exp_matches_scipy(self, rng):
        omega = random_skew(rng, (4,), 9)
        np.testing.assert_allclose(so.exp(omega), [scipy.linalg.expm(w) for w in omega], atol=1e-13)

    def test_cayley_is_second_order_orthogonal_and_reversible(self, rng):
        omega = random_skew(rng, (), 8)
        errors = [np.linalg.norm(so.cayley(t * omega) - so.exp(t * omega)) for t in (1e-1, 1e-2)]
        assert np.log10(errors[0] / errors[1]) == pytest.approx(3, abs=0.1)
        np.testing.assert_allclose(so.cayley(omega) @ so.cayley(-omega), np.eye(8), atol=1e-12)
        np.testing.assert_allclose(so.cayley(omega).T @ so.cayley(omega), np.eye(8), atol=1e-12)

    @pytest.mark.parametrize("scale", [1e-200, 1.0, 1e150])
    def test_projection_matches_singular_vectors(self, rng, scale):
        a = rng.standard_normal((40, 6, 6)) + 3 * np.eye(6)  # of both kinds: products will do, or not
        a[:10, 0] *= -1  # reflections
        a[10:20, 0] *= 1e-7  # nearly singular
        u, _, vt = np.linalg.svd(a)
        u[:, :, -1] *= np.sign(np.linalg.det(u @ vt))[:, None]
        np.testing.assert_allclose(so.project(scale * a), u @ vt, atol=1e-13)

    def test_projection_of_zeros_is_a_rotation_and_nan_is_an_error(self):
        np.testing.assert_array_equal(so.project(np.zeros((2, 3, 3))), np.stack([np.eye(3)] * 2))
        with np.errstate(invalid="ignore"), pytest.raises(np.linalg.LinAlgError):
            so.project_unchecked(np.full((1, 3, 3), np.nan))

    def test_tangent_projection(self, rng):
        c, v = so.random_uniform(5, 3, rng), rng.standard_normal((3, 5, 5))
        p = so.tangent(c, v)
        np.testing.assert_allclose(p, c @ so.skew(so.transpose(c) @ v), atol=1e-13)
        np.testing.assert_allclose(so.tangent(c, p), p, atol=1e-13)


class TestLog:
    @pytest.mark.parametrize("n", [2, 3, 4, 7, 20])
    def test_matches_scipy_on_random_rotations(self, rng, n):
        r = so.random_uniform(n, 12, rng)
        expected = np.array([scipy.linalg.logm(x).real for x in r])
        np.testing.assert_allclose(so.log(r), expected, atol=1e-9)

    def test_round_trip_up_to_the_cut_locus(self, rng):
        for gap in (1e-1, 1e-3, 1e-5, 1e-8):
            r, omega = rotation_with_angles([np.pi - gap, 1.3, 0.2, 2e-4], rng)
            np.testing.assert_allclose(so.exp(so.log(r)), r, atol=1e-12)
            # rounding of R by 1e-16 moves its logarithm by 1e-16 π / sin(angle): no method does better
            np.testing.assert_allclose(so.log(r), omega, atol=1e-11 + 2e-14 / gap)

    @pytest.mark.parametrize(
        "angles",
        [
            [np.pi, 1.0, 0.5],
            [np.pi, np.pi, 0.3],
            [0.7, 0.7, 0.7],
            [0.0, 0.0, 2.0],
            [0.9, np.pi - 0.9, 0.1],
            [np.pi - 2e-3, np.pi - 1e-3, 2.0],  # two planes whose cosines nearly agree, where θ / sin θ is steep
            [np.pi - 1e-8, np.pi - 1e-8, np.pi - 1e-8],
        ],
    )
    def test_repeated_and_mirrored_angles(self, rng, angles):
        r, _ = rotation_with_angles(angles, rng)
        omega = so.log(r)
        np.testing.assert_allclose(so.exp(omega), r, atol=1e-7)
        assert np.linalg.norm(omega) == pytest.approx(np.sqrt(2) * np.linalg.norm(angles), abs=1e-6)
        np.testing.assert_allclose(omega, -omega.T, atol=1e-12)

    @pytest.mark.parametrize("gap", [0.3, 3e-2, 1e-3])
    def test_two_planes_near_the_cut_locus_keep_their_digits(self, rng, gap):
        for _ in range(20):
            r, omega = rotation_with_angles([np.pi - gap, np.pi - 0.6 * gap, 0.4, 2.0, 1.0], rng)
            np.testing.assert_allclose(so.log(r), omega, atol=3e-11)

    @pytest.mark.parametrize("n", [2, 3, 8, 20])
    def test_the_polynomial_near_the_identity_agrees_with_eigenvectors(self, rng, n):
        """It says for itself where it is good: at angles up to 1.2 it is, at angles beyond π/2 it is not."""
        largest = np.array([1e-8, 1e-3, 0.3, 0.9, 1.2, 1.6, 2.5, 3.1])
        omega = random_skew(rng, (8,), n)
        omega *= (largest / np.linalg.norm(omega, ord=2, axis=(1, 2)))[:, None, None]
        found, near = so._log_series(so.exp(omega))
        assert near.tolist() == [True] * 5 + [False] * 3
        np.testing.assert_allclose(found[near], omega[near], atol=1e-14, rtol=1e-9)
        np.testing.assert_allclose(logarithms_by_eigenvectors(so.exp(omega)), omega, atol=1e-10)

    @pytest.mark.parametrize("n", [2, 3, 8, 20])
    def test_square_roots_have_half_the_angles(self, rng, n):
        """They say for themselves where they are good: as long as no angle is within a thousandth of π."""
        largest = np.array([0.3, 1.6, 2.5, 3.1, np.pi - 2e-3, np.pi - 1e-6, np.pi])
        omega = random_skew(rng, (7,), n)
        omega *= (largest / np.linalg.norm(omega, ord=2, axis=(1, 2)))[:, None, None]
        found, good = so._square_roots(so.exp(omega))
        assert good.tolist() == [True] * 5 + [False] * 2
        np.testing.assert_allclose(found[good], so.exp(omega[good] / 2), atol=1e-12)

    def test_identity_and_batches(self):
        assert np.abs(so.log(np.eye(6))).max() < 1e-12
        assert so.log(np.zeros((0, 4, 4))).shape == (0, 4, 4)
        several = so.random_uniform(6, (3, 2), rng=1)  # far from the identity, and read along columns
        np.testing.assert_allclose(so.log(so.transpose(several)), -so.log(several), atol=1e-12)


class TestDist:
    @pytest.mark.parametrize("n", [2, 3, 5, 20])
    def test_is_the_norm_of_the_logarithm(self, rng, n):
        a, b = so.random_uniform(n, (2, 10), rng)
        np.testing.assert_allclose(so.dist(a, b), np.linalg.norm(so.log(so.transpose(a) @ b), axis=(1, 2)), rtol=1e-9)

    def test_small_distances_keep_their_digits(self, rng):
        a, omega = so.random_uniform(8, (), rng), random_skew(rng, (), 8)
        for t in (1e-3, 1e-6):
            assert so.dist(a, a @ so.exp(t * omega)) == pytest.approx(t * np.linalg.norm(omega), rel=1e-6)
        assert so.dist(a, a) == 0

    def test_geomstats_distance_is_ours_over_root_two(self, rng):
        group = SpecialOrthogonal(n=5)
        a, b = so.random_uniform(5, (2, 6), rng)
        theirs = group.metric.dist(a, b)
        np.testing.assert_allclose(so.dist(a, b), np.sqrt(2) * theirs, rtol=1e-8)

    def test_geomstats_exp_and_log_agree(self, rng):
        group = SpecialOrthogonal(n=4)
        c, omega = so.random_uniform(4, (), rng), random_skew(rng, (), 4, 0.4)
        np.testing.assert_allclose(group.metric.exp(c @ omega, c), c @ so.exp(omega), atol=1e-10)
        r = so.random_uniform(4, (), rng)
        np.testing.assert_allclose(group.metric.log(r, c), c @ so.log(c.T @ r), atol=1e-8)


class TestHaar:
    def test_moments_of_the_trace(self, rng):
        n, size = 20, 20000
        trace = np.trace(so.random_uniform(n, size, rng), axis1=-2, axis2=-1)
        assert abs(trace.mean()) < 4 / np.sqrt(size)  # E tr = 0, E tr² = 1
        assert abs((trace**2).mean() - 1) < 4 * np.sqrt(2 / size)

    def test_every_entry_has_variance_one_over_n(self, rng):
        n, size = 4, 20000
        c = so.random_uniform(n, size, rng)
        assert np.abs((c**2).mean(0) - 1 / n).max() < 5 * np.sqrt(2) / n / np.sqrt(size)
        np.testing.assert_allclose(np.linalg.det(c), 1, atol=1e-12)

    def test_left_translation_leaves_the_law(self, rng):
        """The mean of a nonlinear function must not depend on the frame: E exp(tr(QC)) is the same for every Q."""
        c = so.random_uniform(3, 40000, rng)
        q = so.random_uniform(3, (), rng)
        plain, turned = (np.exp(np.trace(x, axis1=-2, axis2=-1)) for x in (c, q @ c))
        assert abs(plain.mean() - turned.mean()) < 4 * np.sqrt((plain.var() + turned.var()) / len(c))

    def test_geomstats_is_not_haar(self):
        """Documents the trap: E tr of its random_uniform at n = 20 is -2.9, not 0."""
        np.random.seed(0)  # noqa: NPY002 (geomstats draws from the global generator)
        theirs = SpecialOrthogonal(n=20).random_uniform(2000)
        assert np.trace(theirs, axis1=-2, axis2=-1).mean() < -2

    def test_seeds(self):
        np.testing.assert_array_equal(so.random_uniform(4, 3, rng=7), so.random_uniform(4, 3, rng=7))
        assert np.abs(so.random_uniform(4, 3, rng=7) - so.random_uniform(4, 3, rng=8)).max() > 0.1


class TestFrechetMean:
    def test_geodesic_mean_minimises_the_sum_of_squares(self, rng):
        r = so.exp(random_skew(rng, (15,), 4, 0.3))
        mean = so.frechet_mean(r)
        value = (so.dist(mean, r) ** 2).sum()
        for omega in random_skew(rng, (20,), 4, 1e-3):
            assert (so.dist(mean @ so.exp(omega), r) ** 2).sum() > value

    def test_chordal_mean_minimises_the_sum_of_squares(self, rng):
        r = so.exp(random_skew(rng, (15,), 4, 0.3))
        mean = so.frechet_mean(r, distance="chordal")
        value = ((mean - r) ** 2).sum()
        for omega in random_skew(rng, (20,), 4, 1e-3):
            assert ((mean @ so.exp(omega) - r) ** 2).sum() > value

    def test_two_points_meet_halfway_and_axes_are_independent(self, rng):
        a, omega = so.random_uniform(5, 3, rng), random_skew(rng, (3,), 5, 0.5)
        pair = np.stack([a, a @ so.exp(omega)])  # (2, 3, 5, 5)
        for distance in ("geodesic", "chordal"):
            np.testing.assert_allclose(so.frechet_mean(pair, distance=distance), a @ so.exp(omega / 2), atol=1e-8)

    def test_errors(self, rng):
        with pytest.raises(ValueError, match="distance"):
            so.frechet_mean(np.eye(3)[None], distance="euclidean")
        with pytest.raises(ValueError, match="at least one"):
            so.frechet_mean(np.zeros((0, 3, 3)))
        with pytest.raises(RuntimeError, match="chordal"):
            so.frechet_mean(so.random_uniform(8, 3, rng), max_iterations=1)
