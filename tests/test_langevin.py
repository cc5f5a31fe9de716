"""The Langevin normaliser against determinants in hundreds of digits, samples and its own derivative."""

import mpmath
import numpy as np
import pytest

from fmsync import langevin, so


def by_determinants(n, kappa, digits):
    """(log c_n, β_n) from Bessel determinants; β by a difference quotient with a quarter of the digits as its step."""
    with mpmath.workdps(digits):
        k = n // 2

        def log_c(x):
            bessel = [mpmath.besseli(m, 2 * x) for m in range(2 * k + 2)]
            if n % 2 == 0:
                rows = [[bessel[abs(a - b)] + bessel[a + b] for b in range(k)] for a in range(k)]
                return mpmath.log(mpmath.det(mpmath.matrix(rows)) / 2)
            rows = [[bessel[abs(a - b)] - bessel[a + b + 1] for b in range(k)] for a in range(k)]
            return x + mpmath.log(mpmath.det(mpmath.matrix(rows)))

        x, step = mpmath.mpf(kappa), mpmath.mpf(10) ** (-digits // 4)
        beta = (log_c(x + step) - log_c(x - step)) / (2 * step) / n
        return +log_c(x), beta


@pytest.mark.parametrize("n", [2, 3, 4, 5, 12, 13, 20, 31])
@pytest.mark.parametrize("kappa", [1e-8, 1e-3, 0.1, 1.0, 1.99, 2.0, 10.0, 100.0, 1e3, 1e4])
def test_all_sizes_and_concentrations_agree_with_many_digits(n, kappa):
    log_c, beta = by_determinants(n, kappa, digits=160)
    assert abs(langevin.log_normaliser(n, kappa) / log_c - 1) < 1e-12
    assert abs(langevin.mean_cosine(n, kappa) - beta) < 1e-12


@pytest.mark.parametrize(
    ("n", "kappa", "log_c", "beta"),
    [  # by_determinants with 350 to 1200 digits, which takes up to a minute each
        (51, 1e4, 505213.0473867160496873655, 0.99874998435504618521),
        (100, 1e3, 88826.46427321065853816388, 0.97524682639584012815),
        (100, 1e4, 983127.2838191895369156609, 0.99752496898491319868),
        (200, 0.3, 0.04499999999999999666933093, 0.0014999999999999999445),
        (200, 1e3, 162071.4564147709367861287, 0.95024344938345627396),
        (200, 1e4, 1939159.583213473745807659, 0.99502493749960342154),
        (20, 10.0, 50.22636766261384, 0.508369965635428),
        (20, 100.0, 1629.75919994661, 0.95243745400096),
        (13, 6.5, 21.3635507073652, 0.51516151106851),
    ],
)
def test_large_sizes_agree_with_stored_digits(n, kappa, log_c, beta):
    np.testing.assert_allclose(langevin.log_normaliser(n, kappa), log_c, rtol=1e-12)
    np.testing.assert_allclose(langevin.mean_cosine(n, kappa), beta, atol=1e-11)


def test_arrays_and_zero():
    kappa = np.array([[0.0, 0.5], [20.0, 3000.0]])
    one_by_one = [[langevin.log_normaliser(7, x) for x in row] for row in kappa]
    np.testing.assert_allclose(langevin.log_normaliser(7, kappa), one_by_one, rtol=1e-13)
    assert langevin.log_normaliser(7, 0.0) == 0
    assert abs(langevin.mean_cosine(7, 0.0)) < 1e-15
    assert langevin.log_normaliser(7, np.empty(0)).shape == (0,)


def test_the_definition_holds_on_haar_samples():
    traces = np.trace(so.random_uniform(4, 200_000, rng=0), axis1=1, axis2=2)
    np.testing.assert_allclose(np.exp(langevin.log_normaliser(4, 0.7)), np.exp(0.7 * traces).mean(), rtol=0.01)


def test_matched_kappa_inverts_the_mean_cosine():
    for n, kappa in [(2, 0.3), (3, 5.0), (20, 11.17), (20, 4000.0)]:
        np.testing.assert_allclose(langevin.matched_kappa(n, langevin.mean_cosine(n, kappa)), kappa, rtol=1e-8)
    assert langevin.matched_kappa(5, -0.1) == 0


def test_the_papers_noise_has_the_matched_concentrations():
    """The mean trace of 4000 samples has a standard error of .016: .4 % of it at σ² = 1."""
    from fmsync.bounds import projected_noise_moments

    for sigma2, kappa in [(0.02, 49.7), (0.1, 11.17), (0.2, 8.14), (0.6, 4.82), (1.0, 3.74)]:
        matched = langevin.matched_kappa(20, projected_noise_moments(20, sigma2)[0] / 20)
        assert abs(matched / kappa - 1) < 0.012


def test_bad_input_is_named():
    with pytest.raises(ValueError, match="n: an integer >= 2, got 1"):
        langevin.log_normaliser(1, 1.0)
    with pytest.raises(ValueError, match=r"kappa: concentrations lie in \[0, 100000\], got -1"):
        langevin.mean_cosine(3, [1.0, -1.0])
    with pytest.raises(ValueError, match="cosine: 1.0 asks for a concentration above 100000"):
        langevin.matched_kappa(3, 1.0)
