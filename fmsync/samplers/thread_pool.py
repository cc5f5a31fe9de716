"""Threads for compiled loops that leave the interpreter: parts of one piece of work, the first done by the caller.

Plain threads rather than those of numba: its portable layer stops the process when two callers meet in it, and GNU
OpenMP when it is used before and after a fork. How many is numba's own number, ``NUMBA_NUM_THREADS``, by default the
processors this process may use; joblib sets it to its share in every worker.
"""

import contextlib
import threading
import weakref
from collections.abc import Callable
from queue import Empty, SimpleQueue

import numba
import numpy as np

Work = Callable[[int, int], None]
_Part = tuple[Work, int, int, list[BaseException | None], "SimpleQueue[None]"]  # ..., how parts ended, wakes the caller
_LOOK = 0.1  # seconds after which a caller looks by itself, should Ctrl-C have taken what wakes it


class ThreadPool:
    """Up to ``NUMBA_NUM_THREADS`` threads, or the caller ``alone``; they start when needed, and end with the object.

    Parts are small, and a queue hands one over sooner than a pool of ``concurrent.futures`` does.
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
        ended: list[BaseException | None] = []
        done: SimpleQueue[None] = SimpleQueue()
        if parts > 1 and self._parts is None:
            self._parts = SimpleQueue()
            for _ in range(self.size - 1):
                threading.Thread(target=_serve, args=(self._parts,), name="fmsync", daemon=True).start()
            weakref.finalize(self, _end, self._parts, self.size - 1)
        for k in range(1, parts):
            self._parts.put((work, ends[k], ends[k + 1], ended, done))  # type: ignore[union-attr]
        try:
            work(ends[0], ends[1])
        finally:
            interrupted = _wait(ended, parts - 1, done)
        for error in (interrupted, *ended):
            if error is not None:
                raise error


def _wait(ended: list[BaseException | None], count: int, done: "SimpleQueue[None]") -> KeyboardInterrupt | None:
    """Until so many parts have ended; returns Ctrl-C, if it came meanwhile."""
    interrupted = None
    while True:
        try:
            while len(ended) < count:
                with contextlib.suppress(Empty):
                    done.get(timeout=_LOOK)
            return interrupted
        except KeyboardInterrupt as told:
            interrupted = told


def _serve(parts: "SimpleQueue[_Part | None]") -> None:
    while (part := parts.get()) is not None:
        work, first, last, ended, done = part
        error: BaseException | None = None
        try:
            work(first, last)
        except BaseException as raised:  # the caller raises it
            error = raised
        ended.append(error)
        done.put(None)
        del work, part, ended, done, error  # what waits here must not keep the pool alive


def _end(parts: "SimpleQueue[_Part | None]", threads: int) -> None:
    for _ in range(threads):
        parts.put(None)
