"""pyFM on the bases, descriptors, samples and sizes of the pipeline for own shapes."""

import time

import numpy as np

from fmsync.matching import SyncedShapes
from fmsync.matching.pairwise import FINE
from fmsync.threads import single_threaded_blas

_STEP = 5


def pyfm_stages(synced: SyncedShapes, judge, pairs, matches) -> tuple[dict, dict]:
    """Errors and CPU seconds: fit, ZoomOut of it, and Consistent ZoomOut of it and of what our pipeline has.

    ``matches`` are our pairwise maps before any synchronisation; ``synced`` holds those after it.
    """
    from pyFM.FMN import FMN
    from pyFM.functional import FunctionalMapping
    from pyFM.mesh import TriMesh
    from pyFM.refine.zoomout import zoomout_refine
    from scipy import sparse

    n, clock = synced.problem.n, time.process_time
    samples, meshes = np.array([s.samples for s in synced.shapes]), []
    for s in synced.shapes:
        mesh = TriMesh(s.shape.vertices, s.shape.faces)
        mesh.eigenvalues, mesh.eigenvectors = np.array(s.basis.eigenvalues), np.array(s.basis.eigenfunctions)
        mesh.A = sparse.dia_matrix((s.basis.mass[None], [0]), shape=(len(s.basis.mass),) * 2).tocsc()
        meshes.append(mesh)

    def consistent(start, size):
        network = FMN(meshes)
        network.set_maps({(j, i): c.copy() for (i, j), c in start.items()})
        network.set_subsample(samples)
        network.M = n
        while size > network.M:
            network.zoomout_iteration(int(0.9 * network.M), network.M, network.M + _STEP, weight_type="icsm")
        return {(i, j): np.array(c) for (j, i), c in network.maps.items()}

    errors, seconds, fitted, refined = {}, {}, {}, {}
    with single_threaded_blas():
        began = clock()
        for i, j in [*synced.edges.tolist(), *synced.edges[:, ::-1].tolist()]:
            model = FunctionalMapping(meshes[j], meshes[i])  # pyFM maps from its first mesh: our C_ij has j first
            model.add_descriptors(synced.shapes[j].descriptors, synced.shapes[i].descriptors)
            model.fit(K=(n, n))  # its own default weights
            fitted[i, j] = model.FM_12
        seconds["pyFM fit, every pair both ways"] = clock() - began
        began = clock()
        for i, j in pairs:
            at_j, at_i = (synced.shapes[k].basis.eigenfunctions for k in (j, i))
            steps, subsample = (FINE - n) // _STEP, (samples[j], samples[i])
            refined[i, j] = zoomout_refine(fitted[i, j], at_j, at_i, nit=steps, step=_STEP, subsample=subsample)
        seconds["pyFM ZoomOut, every pair both ways"] = (clock() - began) / len(pairs) * 2 * len(synced.edges)
        errors["pyFM pairwise"] = judge.mean(pairs, lambda i, j: fitted[i, j])
        errors["pyFM pairwise + ZoomOut"] = judge.mean(pairs, lambda i, j: refined[i, j])
        runs = (
            ("its own fit", fitted, FINE),
            ("our pairwise maps", _both_ways(synced.edges, matches, n), FINE),
            ("our pairwise maps", _both_ways(synced.edges, matches, n), synced.refined.shape[-1]),
            ("our pairs after proposals", _both_ways(synced.edges, synced.matches, n), FINE),
        )
        for name, start, size in runs:
            key = f"pyFM Consistent ZoomOut to {size} from {name}"
            began = clock()
            maps = consistent(start, size)
            seconds[key] = clock() - began
            errors[key] = judge.mean(pairs, lambda i, j, maps=maps: maps[i, j])
    return errors, seconds


def _both_ways(edges, matches, n) -> dict:
    one_way = {tuple(e): m.c_ij[:n, :n] for e, m in zip(edges.tolist(), matches)}
    return one_way | {(j, i): c.T for (i, j), c in one_way.items()}
