"""Threads for compiled loops that leave the interpreter: parts of one piece of work, the first done by the caller.

Plain threads rather than those of numba: its portable layer stops the process when two callers meet in it, and GNU
OpenMP when it is used before and after a fork. How many is numba's own number, ``NUMBA_NUM_THREADS``, by default the
processors this process may use; joblib sets it to its share in every worker.
"""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait

import numba
import numpy as np


class ThreadPool:
    """Up to ``NUMBA_NUM_THREADS`` threads, or the caller ``alone``; they start when needed, and end with the object."""

    def __init__(self, alone: bool = False) -> None:
        self.size: int = 1 if alone else numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]
        self._pool: ThreadPoolExecutor | None = None

    def parallel_for(self, work: Callable[[int, int], None], count: int) -> None:
        """Call ``work(first, last)`` for parts of 0 .. count, at least one, at the same time.

        No part is still running when it returns, nor when it is left by Ctrl-C.
        """
        parts = min(self.size, count)
        ends = np.arange(parts + 1) * count // parts
        others: list[Future[None]] = []
        if parts > 1:
            if self._pool is None:
                self._pool = ThreadPoolExecutor(self.size - 1, thread_name_prefix="fmsync")
            others = [self._pool.submit(work, ends[k], ends[k + 1]) for k in range(1, parts)]
        try:
            work(ends[0], ends[1])
        finally:
            wait(others)
        for other in others:
            other.result()
