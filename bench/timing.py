"""Timing in pairs: ours and the peer in turn, in one process, on the same input; medians and their ratio."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fmsync.threads import single_threaded_blas


@dataclass(frozen=True)
class Comparison:
    """Median seconds of two ways to the same result, and the median of the ratios of the paired runs."""

    name: str
    ours: float
    peer: float
    ratio: float
    goal: float | None = None

    def __str__(self) -> str:
        goal = "" if self.goal is None else f"  (goal {self.goal:g}x: {'met' if self.ratio >= self.goal else 'MISSED'})"
        return f"{self.name:58s} {1e3 * self.ours:10.2f} ms {1e3 * self.peer:10.2f} ms {self.ratio:7.2f}x{goal}"


def seconds(function: Callable[[], object]) -> float:
    """Wall-clock seconds of one call."""
    began = time.perf_counter()
    function()
    return time.perf_counter() - began


def compare(
    name: str,
    ours: Callable[[], object],
    peer: Callable[[], object],
    *,
    runs: int = 5,
    goal: float | None = None,
) -> Comparison:
    """Run both in turn, after one warm-up each, with one BLAS thread.

    Examples
    --------
    >>> compare("nothing", lambda: None, lambda: sum(range(10000)), runs=3).ratio > 1
    True
    """
    with single_threaded_blas():
        ours(), peer()
        pairs = np.array([(seconds(ours), seconds(peer)) for _ in range(runs)])
    ours_seconds, peer_seconds = np.median(pairs, axis=0)
    return Comparison(name, float(ours_seconds), float(peer_seconds), float(np.median(pairs[:, 1] / pairs[:, 0])), goal)
