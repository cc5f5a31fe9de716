"""Turns the accepted iterates of somebody else's optimiser into a trace."""

import time

import numpy as np

from fmsync.estimators.base import Callback, Trace


class Recorder:
    """Called with every point whose gradient is asked for: pymanopt asks again for each Hessian, at the same point."""

    def __init__(self, callback: Callback):
        self._callback = callback
        self._began = time.perf_counter()
        self._history: list[tuple[float, float, float]] = []
        self._last: np.ndarray | None = None

    def __call__(self, absolute: np.ndarray, cost: float, gradient_norm: float) -> None:
        if absolute is self._last:
            return
        self._last = absolute
        self._history.append((float(cost), float(gradient_norm), time.perf_counter() - self._began))
        self._callback(len(self._history) - 1, absolute, float(cost), float(gradient_norm))

    def trace(self) -> Trace:
        """The history so far, (K + 1,) each; empty when the optimiser could not be watched."""
        columns = np.array(self._history).reshape(-1, 3).T
        return Trace(*columns)
