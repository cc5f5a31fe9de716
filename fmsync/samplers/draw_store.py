"""Where draws go while a sampler runs."""

import os
from pathlib import Path
from types import TracebackType

import numpy as np


class DrawStore:
    """Room for (K, T, N, n, n) draws in memory, in a file that appears when complete, or nowhere.

    A context manager: on leaving it ``result`` holds the first ``done`` draws, and after an error nothing half-written
    stays on disk.
    """

    def __init__(self, store: str | Path | None, n_draws: int, state_shape: tuple[int, ...]) -> None:
        shape = (state_shape[0], n_draws, *state_shape[1:])
        self.done = 0
        self._array: np.ndarray | None = None  # a memory map where draws go to a file
        if store is None:
            self._empty = np.empty((shape[0], 0, *shape[2:]))
        elif store == "memory":
            self._array = np.empty(shape)
        else:
            self._path = Path(store)
            if self._path.suffix != ".npy":
                raise ValueError(f"store: 'memory', None or a path that ends in .npy, not {str(store)!r}")
            if not self._path.parent.is_dir():
                raise ValueError(f"store: the folder {self._path.parent} does not exist; make it first")
            self._part = self._path.with_name(self._path.name + ".part")
            self._array = np.lib.format.open_memmap(self._part, mode="w+", dtype=float, shape=shape)

    def put(self, draw: int, rotations: np.ndarray) -> None:
        """Keep the (K, N, n, n) of one draw."""
        if self._array is not None:
            self._array[:, draw] = rotations

    def __enter__(self) -> "DrawStore":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._array is None:
            self.result = self._empty
        elif not isinstance(self._array, np.memmap):
            self.result = self._array[:, : self.done]
        elif kind is not None:
            self._array = None
            self._part.unlink()
        else:
            self._finish(self._array)

    def _finish(self, array: np.memmap) -> None:
        """Cut the file to the draws made, put it in place and open it to read."""
        array.flush()
        if self.done < array.shape[1]:  # draws are the second axis: the rest is copied, one chain at a time
            cut = self._part.with_name(self._part.name + ".cut")
            shape = (array.shape[0], self.done, *array.shape[2:])
            shorter = np.lib.format.open_memmap(cut, mode="w+", dtype=float, shape=shape)
            for chain in range(shape[0]):
                shorter[chain] = array[chain, : self.done]
            shorter.flush()
            del shorter
            os.replace(cut, self._part)
        self._array = None
        os.replace(self._part, self._path)
        self.result = np.load(self._path, mmap_mode="r")
