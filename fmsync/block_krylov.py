"""The largest eigenpairs of a symmetric operator, multiple eigenvalues included."""

from collections.abc import Callable

import numpy as np

DENSE = 500  # below this size a dense solve is quicker and cannot miss anything


def largest_eigenpairs(apply: Callable[[np.ndarray], np.ndarray], size: int, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues (k,) descending and orthonormal eigenvectors (size, k) of a positive definite operator.

    Block Lanczos with full reorthogonalisation and a fixed random start. A Krylov space grown from b vectors holds at
    most b copies of a multiple eigenvalue (symmetric shapes have them, and single-vector ARPACK was seen to drop
    copies on a sphere), so when b found values coincide the search is repeated with a block twice as large.

    ``apply`` maps (size, b) to (size, b); residuals of eigenpairs are below a billionth of the eigenvalue.
    """
    if size <= DENSE:
        values, vectors = np.linalg.eigh(apply(np.eye(size)))
        return values[::-1][:k], vectors[:, ::-1][:, :k]
    block = 2
    while True:
        start = np.linalg.qr(np.random.default_rng(0).standard_normal((size, block)))[0].T  # (b, size)
        values, rows = block_lanczos(apply, start, k, lambda values: 1e-9 * values)
        coincide = values[block - 1 :] > values[: max(len(values) - block + 1, 0)] * (1 - 1e-6)
        if not coincide.any():
            return values, rows.T
        block *= 2


def block_lanczos(
    apply: Callable[[np.ndarray], np.ndarray],
    rows: np.ndarray,
    k: int,
    tolerance: Callable[[np.ndarray], np.ndarray],
    depth: int | None = None,
    cycles: int = 1,
) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues (k,) descending and eigenvectors (k, size) of a symmetric operator, in the precision of ``rows``.

    Begins with orthonormal ``rows`` (b, size); ``apply`` maps (size, b) to (size, b). Ends when the residuals (k,) are
    below ``tolerance`` of the eigenvalues. With a ``depth``, which needs b = k, it begins again from the best k after
    so many products, and after the last of the ``cycles`` returns the best there is.
    """
    block, size = rows.shape
    room = 4 * k + 20 * block if depth is None else depth * block
    krylov = np.empty((room, size), rows.dtype)  # orthonormal rows; contiguous, so every product below is one GEMM
    for _ in range(cycles):
        projected = np.zeros((0, 0))  # upper triangle of the operator in that basis
        used, met, full = 0, False, False
        while not (met or full):
            if used + block > len(krylov):
                krylov = np.concatenate([krylov, np.empty_like(krylov)])
            krylov[used : used + block] = rows
            used += block
            basis = krylov[:used]

            image = apply(rows.T).T  # (b, size)
            overlap = basis @ image.T  # (used, b)
            image -= overlap.T @ basis
            projected = np.pad(projected, (0, block))
            projected[:, -block:] = overlap

            # The second pass comes after the normalisation: when the space is exhausted what is left is noise, and this
            # turns it into fresh directions. In single precision the search ends before.
            rows, scale = orthonormal_rows(image)
            if rows.dtype == np.float64:
                rows = rows - (basis @ rows.T).T @ basis
                rows, _ = orthonormal_rows(rows)

            full = depth is not None and used == depth * block
            often = depth is not None or used // block % 2 == 0  # the test is cheap beside products of wide blocks
            if full or (used >= 2 * k and often):
                values, combination = np.linalg.eigh(projected, UPLO="U")
                values, combination = values[::-1][:k], combination[:, ::-1][:, :k]  # (k,), (used, k)
                residual = np.linalg.norm(scale @ combination[-block:], axis=0)
                met = bool((residual <= tolerance(values)).all())
        rows = combination.T.astype(krylov.dtype, copy=False) @ basis
        if met:
            break
    return values, rows


def orthonormal_rows(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal rows and the triangle R with rows = R^T q: Cholesky, twice if oblique, or QR near rank loss."""
    size = np.sqrt((rows * rows).sum(axis=1))
    gram = rows @ rows.T
    least = np.linalg.eigvalsh(gram / np.outer(size, size))[0] if size.min() > 0 else 0.0
    if not least > 1e-4:
        q, r = np.linalg.qr(rows.T)
        return q.T, r
    triangle = np.linalg.cholesky(gram)  # (b, b), so its inverse is cheap and well conditioned here
    q = np.linalg.inv(triangle) @ rows
    if least > 0.1:  # then one factor leaves them orthonormal to rounding
        return q, triangle.T
    again = np.linalg.cholesky(q @ q.T)
    return np.linalg.inv(again) @ q, (triangle @ again).T
