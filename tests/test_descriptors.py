import numpy as np
import pytest

from fmsync.descriptors import heat_kernel, heat_kernel_signature, wave_kernel_signature
from fmsync.shape import Basis, laplace_beltrami
from tests.surfaces import icosphere, potato, relabelled, rotation

SIGNATURES = [heat_kernel_signature, wave_kernel_signature]


@pytest.fixture(scope="module")
def basis():
    return laplace_beltrami(*potato(2), 15)


def test_heat_kernel_signature_equals_the_sum(basis):
    fast = heat_kernel_signature(basis, 3)
    low, high = 4 * np.log(10) / basis.eigenvalues[-1], 4 * np.log(10) / basis.eigenvalues[1]
    for column, t in enumerate([low, np.sqrt(low * high), high]):
        for x in (0, 17, 101):
            heat = sum(np.exp(-basis.eigenvalues[k] * t) * basis.eigenfunctions[x, k] ** 2 for k in range(15))
            trace = sum(np.exp(-basis.eigenvalues[k] * t) for k in range(15))
            assert fast[x, column] == pytest.approx(heat / trace)


def test_wave_kernel_signature_equals_the_sum(basis):
    n_energies = 6
    fast = wave_kernel_signature(basis, n_energies)
    logs = [np.log(value) for value in basis.eigenvalues[1:]]
    width = 7 * (logs[-1] - logs[0]) / (n_energies + 27)
    for column, e in enumerate(np.linspace(logs[0] + 2 * width, logs[-1] - 2 * width, n_energies)):
        weights = [np.exp(-((e - log) ** 2) / (2 * width**2)) for log in logs]
        for x in (0, 17, 101):
            wave = sum(w * basis.eigenfunctions[x, k + 1] ** 2 for k, w in enumerate(weights))
            assert fast[x, column] == pytest.approx(wave / sum(weights))


def test_heat_kernel_equals_the_sum(basis):
    fast = heat_kernel(basis, np.array([3, 50]), 2)
    times = [4 * np.log(10) / basis.eigenvalues[-1], 4 * np.log(10) / basis.eigenvalues[1]]
    slow = []
    for y in (3, 50):
        for t in times:
            heat = sum(
                np.exp(-basis.eigenvalues[k] * t) * basis.eigenfunctions[:, k] * basis.eigenfunctions[y, k]
                for k in range(15)
            )
            slow.append(heat / np.sqrt(basis.mass @ heat**2))
    np.testing.assert_allclose(fast, np.transpose(slow), atol=1e-10)


@pytest.mark.parametrize("signature", SIGNATURES)
def test_signatures_survive_motion_scale_and_renumbering(signature):
    vertices, faces = potato(2)
    moved, moved_faces, old = relabelled(40 * vertices @ rotation(3).T + [1, 2, 3], faces, rng=4)
    here = signature(laplace_beltrami(vertices, faces, 12))
    there = signature(laplace_beltrami(moved, moved_faces, 12))
    np.testing.assert_allclose(there, here[old], rtol=1e-6)


@pytest.mark.parametrize("signature", SIGNATURES)
def test_signatures_have_mean_one_and_are_flat_on_a_sphere(signature, basis):
    np.testing.assert_allclose(basis.mass @ signature(basis), 1)
    assert np.ptp(signature(basis), axis=0).max() > 0.2  # ten times what is called flat below
    sphere = laplace_beltrami(*icosphere(3), 9)  # whole multiplets 1 + 3 + 5: sums of squares are constant
    np.testing.assert_allclose(signature(sphere), 1, atol=0.02)


def test_many_energies_of_a_small_basis_stay_finite():
    assert np.isfinite(wave_kernel_signature(laplace_beltrami(*potato(1), 3), 2000)).all()


def test_bad_input_is_named(basis):
    constant = Basis([0.0], np.ones((2, 1)), [0.5, 0.5])
    for signature in SIGNATURES:
        with pytest.raises(ValueError, match="at least two functions"):
            signature(constant)
        with pytest.raises(ValueError, match="an integer >= 1, got 0"):
            signature(basis, 0)
    with pytest.raises(ValueError, match=r"landmarks\[1\] = 999 is outside"):
        heat_kernel(basis, np.array([0, 999]))
