"""Threads for compiled loops that leave the interpreter: parts of one piece of work, the first done by the caller.

Plain threads rather than those of numba: its portable layer stops the process when two callers meet in it, and GNU
OpenMP when it is used before and after a fork. How many is numba's own number, ``NUMBA_NUM_THREADS``, by default the
processors this process may use; joblib sets it to its share in every worker.
"""

import threading
import weakref
from collections.abc import Callable
from queue import SimpleQueue

import numba
import numpy as np

Work = Callable[[int, int], None]
_Part = tuple[Work, int, int, "SimpleQueue[BaseException | None]"]  # what to do, and where to say that it is done


class ThreadPool:
    """Up to ``NUMBA_NUM_THREADS`` threads, or the caller ``alone``; they start when needed, and end with the object.

    Handing a part over takes a third of the time that a pool of ``concurrent.futures`` takes for it.
    """

    def __init__(self, alone: bool = False) -> None:
        self.size: int = 1 if alone else numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]
        self._parts: SimpleQueue[_Part | None] | None = None

    def parallel_for(self, work: Work, count: int) -> None:
        """Call ``work(first, last)`` for parts of 0 .. count, at least one, at the same time.

        No part is still running when it returns, nor when it is left by Ctrl-C.
        """
        parts = min(self.size, count)
        ends = np.arange(parts + 1) * count // parts
        done: SimpleQueue[BaseException | None] = SimpleQueue()
        if parts > 1 and self._parts is None:
            self._parts = SimpleQueue()
            for _ in range(self.size - 1):
                threading.Thread(target=_serve, args=(self._parts,), name="fmsync", daemon=True).start()
            weakref.finalize(self, _end, self._parts, self.size - 1)
        for k in range(1, parts):
            self._parts.put((work, ends[k], ends[k + 1], done))  # type: ignore[union-attr]
        try:
            work(ends[0], ends[1])
        finally:
            errors = [_got(done) for _ in range(1, parts)]
        for error in errors:
            if error is not None:
                raise error


def _serve(parts: "SimpleQueue[_Part | None]") -> None:
    while (part := parts.get()) is not None:
        work, first, last, done = part
        error: BaseException | None = None
        try:
            work(first, last)
        except BaseException as raised:  # the caller raises it
            error = raised
        done.put(error)
        del work, part, done, error  # what waits here must not keep the pool alive


def _got(done: "SimpleQueue[BaseException | None]") -> BaseException | None:
    """What the next part to end says, or Ctrl-C, if it came meanwhile."""
    try:
        return done.get()
    except KeyboardInterrupt as interrupted:
        done.get()
        return interrupted


def _end(parts: "SimpleQueue[_Part | None]", threads: int) -> None:
    for _ in range(threads):
        parts.put(None)
