"""``fmsync info``: what is in a file or folder, whether it is well posed, and what would run on it."""

import argparse
import time
import warnings
from pathlib import Path

import networkx as nx
import numpy as np

import fmsync
from fmsync import bounds, langevin
from fmsync.mesh_io import SUFFIXES, mesh_files, read_shape
from fmsync.problem_cli import as_json, print_summary
from fmsync.samplers.base import Target
from fmsync.samplers.heat_bath import HeatBath
from fmsync.samplers.sample import starts

_STEPS, _DEFAULT_STEPS = 3, 2000  # of the heat bath: timed, and those of fmsync sample without options


def run(options: argparse.Namespace) -> int:
    """Describe every file; the status is 2 if one of them cannot be used."""
    path: Path = options.path
    if not path.exists():
        raise ValueError(f"{path}: there is no such file or folder")
    problems = [path] if path.suffix == ".npz" else sorted(path.glob("*.npz")) if path.is_dir() else []
    only = bool(problems) and (path.is_file() or not any(file.suffix.lower() in SUFFIXES for file in path.iterdir()))
    meshes = [] if only else mesh_files([path])
    told = [_of_problem(file) for file in problems] + [_of_mesh(file) for file in meshes]
    usable = [part for part in told if "refused" not in part]
    shapes = sum(part["kind"] != "problem" for part in usable)
    would = [f"fmsync sync: {shapes} shapes, {shapes * (shapes - 1) // 2} pairs"] * (shapes > 1)
    would += ["fmsync solve, fmsync sample: each problem on its own"] * (len(usable) > shapes)
    if options.json:
        print(as_json({"files": told, "would_run": would}))
    else:
        for part in told:
            print_summary(part)
            print()
        print(*would, sep="\n")
    return 0 if len(usable) == len(told) else 2


def _of_problem(file: Path) -> dict[str, object]:
    """Counts, what the graph allows, and the noise that the observations show."""
    told: dict[str, object] = {"file": str(file), "kind": "problem"}
    try:
        problem = fmsync.load_problem(file)
    except ValueError as error:
        return told | {"refused": str(error)}
    n, n_nodes, n_edges = problem.n, problem.n_nodes, problem.n_edges
    cycles = n_edges - n_nodes + 1
    told |= {"shapes": n_nodes, "observations": n_edges, "map_size": n, "connected": True, "cycles": cycles}
    told["bipartite"] = nx.is_bipartite(nx.Graph(problem.edges.tolist()))
    told["worst_orthogonality_error"] = float(problem.orthogonality_error.max())
    told["recorded_noise"] = problem.provenance.get("noise")
    if cycles == 0:
        return told | {"kappa": None, "noise": "no cycle: nothing tells how noisy the maps are; give sample --kappa"}
    with warnings.catch_warnings(action="ignore"):
        relative = fmsync.solve(problem, "spectral").relative()
    agreement = float(np.einsum("eab,eab->e", relative, problem.maps).mean()) / n
    cosine = 1 - (1 - agreement) * n_edges / cycles  # the fit takes its part of the noise
    kappa = langevin.matched_kappa(n, min(cosine, float(langevin.mean_cosine(n, 1e5))))
    threshold = langevin.matched_kappa(n, bounds.recovery_cosine(n_nodes, n_edges))
    told |= {"kappa": kappa, "kappa_threshold": threshold, "recoverable": kappa > threshold}
    if kappa > 0:
        squared = bounds.langevin_error_bound(n_nodes, problem.edges, n, kappa)
        told["rms_error_bound"] = float(np.sqrt(squared.mean()))
        told["bound_holds"] = bool(bounds.is_small_error(n, squared).all())
    rng = np.random.default_rng(0)
    chains = HeatBath(Target(problem), starts(problem, "spectral", 4, rng), rng)
    chains.step(warmup=True)  # compiles
    began = time.perf_counter()
    for _ in range(_STEPS):
        chains.step(warmup=True)
    return told | {"sample_seconds": (time.perf_counter() - began) * _DEFAULT_STEPS / _STEPS}


def _of_mesh(file: Path) -> dict[str, object]:
    """Counts, what the reader repaired, and what will make matching hard."""
    told: dict[str, object] = {"file": str(file), "kind": "mesh"}
    with warnings.catch_warnings(record=True, action="always") as caught:
        try:
            shape = read_shape(file, manifold=False)
        except ValueError as error:
            return told | {"refused": str(error)}
    told |= {"vertices": shape.n_vertices, "repaired": "; ".join(str(w.message) for w in caught) or None}
    if shape.faces is None:
        told["kind"] = "point cloud"
    else:
        _, faces_at = np.unique(fmsync.shape.edges_of_faces(shape.faces), axis=0, return_counts=True)
        told |= {"faces": len(shape.faces), "pieces": 1, "closed": bool((faces_at > 1).all())}
        told |= {"boundary_edges": int((faces_at == 1).sum()), "edges_of_many_faces": int((faces_at > 2).sum())}
    basis = fmsync.laplace_beltrami(shape.vertices, shape.faces, min(21, shape.n_vertices - 1))
    return told | {"surface_of_revolution": basis.has_continuous_symmetry}
