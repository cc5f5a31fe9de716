"""Meshes from files, for the command line: what can be used, or words that say why not."""

from pathlib import Path

import numpy as np
import potpourri3d as pp3d

from fmsync.shape import Shape

SUFFIXES = (".off", ".obj", ".ply", ".stl")


def mesh_files(paths: list[str | Path]) -> list[Path]:
    """Files named or found in folders that are named, each once and in order; ValueError when one is missing."""
    files = []
    for path in map(Path, paths):
        if path.is_dir():
            found = sorted(f for f in path.iterdir() if f.suffix.lower() in SUFFIXES)
            if not found:
                raise ValueError(f"{path}: no meshes in it; known are {', '.join(SUFFIXES)}")
            files += found
        elif path.is_file():
            files.append(path)
        else:
            raise ValueError(f"{path}: there is no such file")
    files = list(dict.fromkeys(files))
    stems = [file.stem for file in files]
    for stem in stems:
        if stems.count(stem) > 1:
            raise ValueError(f"several files are called {stem}: rename them, the names are used for the output")
    return files


def read_mesh(path: str | Path) -> Shape:
    """Mesh, or point cloud where a PLY has no faces, of a file; named after it, vertices in the order of the file.

    Raises
    ------
    ValueError
        The file cannot be read, is empty, or holds what :class:`fmsync.Shape` refuses.
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise ValueError(f"{path}: unknown format {path.suffix!r}; known are {', '.join(SUFFIXES)}")
    if path.stat().st_size == 0:
        raise ValueError(f"{path}: the file is empty")
    try:
        vertices, faces = pp3d.read_mesh(str(path))
    except Exception as error:
        try:
            vertices, faces = pp3d.read_point_cloud(str(path)), None
        except Exception:
            raise ValueError(f"{path}: it cannot be read as a triangle mesh ({error})") from error
    faces = None if faces is None or len(faces) == 0 else np.asarray(faces, dtype=np.int64)
    return Shape(vertices, faces, path.stem)
