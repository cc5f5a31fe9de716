"""Are the regions of the pipeline for own shapes as likely as they say, and do they find the wrong vertices?"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

import fmsync
from bench.metrics import LEVELS
from bench.own_shapes.stages import Evaluation, evaluation_vertices, some_pairs, stages
from data_gen import GroundTruth, perturb
from fmsync.functional_maps import nearest_rows
from fmsync.matching import Confidence, ConformalCalibration, SyncedShapes, fit_conformal
from fmsync.matching.conformal import default_calibration
from fmsync.matching.network import basis_signs, trusted_part
from fmsync.shape import Shape

RETAINED = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1)
_INDICATORS = ("radius", "entropy", "spread", "local_distortion", "distortion")  # what a confidence says of a vertex


@dataclass(frozen=True, eq=False)
class Observed:
    """What the pipeline says of the evaluation vertices, and their true errors: a list entry (P,) for each pair.

    ``radii`` are those of the draws, by level; ``cheap`` are rankings that need no posterior, by name.
    """

    synced: SyncedShapes
    evaluation: Evaluation
    known: list[Confidence]
    errors: list[np.ndarray]
    radii: dict[float, list[np.ndarray]]
    cheap: dict[str, list[np.ndarray]]

    def covered(self, calibration: ConformalCalibration | None = None) -> dict[str, float]:
        """Share of the true images inside the regions of every level: as they come, or calibrated."""
        found = {}
        for q in LEVELS:
            radii = self.radii[q] if calibration is None else [calibration.radius(k, q) for k in self.known]
            found[str(q)] = float(np.mean(np.concatenate(self.errors) <= np.concatenate(radii)))
        return found


def collections(loaded: dict[str, list[Shape]], **options) -> dict:
    """Errors, coverage and risk–coverage curves of every collection, calibrated on each and as the package ships it."""
    observed = {name: observe(shapes, **options) for name, shapes in loaded.items()}
    fitted = {name: fit_conformal(o.known, o.errors, name) for name, o in observed.items()}
    found = {}
    for k, (name, o) in enumerate(observed.items()):
        coverage = {"as it comes": o.covered()}
        coverage |= {f"recalibrated on {other}": o.covered(r) for other, r in fitted.items()}
        coverage["as shipped"] = o.covered(default_calibration())
        elsewhere = next((r for other, r in fitted.items() if other != name), default_calibration())
        found[name] = stages(o.synced, o.evaluation, peers=k == 0)  # peers take most of the time
        found[name] |= {"coverage": coverage, "risk_coverage": risk_coverage(o, elsewhere)}
    return found


def observe(
    shapes: list[Shape], levels: tuple[float, ...] = LEVELS, vertices: np.ndarray | None = None, **options
) -> Observed:
    """Run the pipeline on shapes of one order, or on creatures, and see; radii of the draws at these levels and 0.9."""
    synced = fmsync.synchronize_shapes(shapes, rng=0, **options)
    vertices = evaluation_vertices(shapes) if vertices is None else vertices
    evaluation, pairs = Evaluation(synced.shapes, vertices), some_pairs(len(shapes), 16)
    at_samples = {q: [synced.confidence(i, j, q) for i, j in pairs] for q in {*levels, 0.9}}
    radii = {q: [evaluation.at(i, k.radius) for (i, _), k in zip(pairs, known)] for q, known in at_samples.items()}
    known = []
    for (i, _), k in zip(pairs, at_samples[0.9]):
        carried = {name: evaluation.at(i, getattr(k, name)) for name in (*_INDICATORS, "fullness", "symmetry_radius")}
        known.append(replace(k, **carried))
    errors = [evaluation.errors(i, j, synced.refined[i], synced.refined[j]).astype(float) for i, j in pairs]
    cycles, cheap = cycle_errors(synced), {"embedding distance": [], "cycle error": []}
    for i, j in pairs:
        at_i, at_j = synced.shared_functions(i, vertices[i]), synced.shared_functions(j)
        cheap["embedding distance"].append(np.linalg.norm(at_i - at_j[nearest_rows(at_i, at_j)], axis=1))
        cheap["cycle error"].append(np.full(len(at_i), cycles[i, j]))
    return Observed(synced, evaluation, known, errors, radii, cheap)


def likelihoods(loaded: dict[str, list[Shape]], **options) -> dict:
    """Mean error of the half of the vertices with the smallest radii of draws, over that of all, by likelihood."""
    found, run = {}, {"warmup": 300, "n_draws": 250, "thin": 4, "rng": 0}
    for name, shapes in loaded.items():
        o = observe(shapes, levels=(), n_draws=40, **options)
        part, errors = trusted_part(o.synced.problem, o.synced.estimate, o.synced.used), np.concatenate(o.errors)
        found[name] = {}
        for likelihood in ("langevin", "by-edge", "by-frequency"):
            posterior = fmsync.sample(part, "heat-bath", likelihood=likelihood, init=o.synced.estimate, **run)
            drawn = replace(o.synced, posterior=posterior)
            radii = [o.evaluation.at(i, drawn.confidence(i, j).radius) for i, j in some_pairs(len(shapes), 16)]
            surer = np.argsort(np.concatenate(radii), kind="stable")[: len(errors) // 2]
            found[name][likelihood] = errors[surer].mean() / errors.mean()
    return found


def cycle_errors(synced: SyncedShapes) -> np.ndarray:
    """(N, N) mean Frobenius distance of an observed map from its compositions through every third shape."""
    count, n = len(synced.shapes), synced.problem.n
    maps = np.full((count, count, n, n), np.nan)
    for (i, j), c in zip(synced.edges, synced.problem.maps):
        maps[i, j], maps[j, i] = c, c.T
    gaps = np.linalg.norm(np.einsum("ikab,kjbc->ijkac", maps, maps) - maps[:, :, None], axis=(3, 4))
    known = np.isfinite(gaps)
    return np.where(known.any(axis=2), np.where(known, gaps, 0).sum(axis=2) / np.maximum(known.sum(axis=2), 1), np.inf)


def risk_coverage(o: Observed, calibration: ConformalCalibration) -> dict:
    """Mean errors, relative to all, of the vertices retained when the least certain are dropped: curves and areas."""
    errors = np.concatenate(o.errors)
    scores = {"expected error": [calibration.expected(k) for k in o.known]}
    scores |= {name: [getattr(k, name) for k in o.known] for name in _INDICATORS} | o.cheap
    scores["learnt here"] = learnt(list(scores.values()), o.errors)
    found = {"kept": RETAINED, "curve": {}, "area": {}}
    for name, values in {**scores, "oracle": o.errors}.items():
        ranked = errors[np.argsort(np.concatenate(values), kind="stable")]
        risk = ranked.cumsum() / np.arange(1, len(ranked) + 1) / ranked.mean()  # 1 where all are retained
        found["curve"][name] = [float(risk[max(0, round(share * len(ranked)) - 1)]) for share in RETAINED]
        found["area"][name] = float(risk.mean())
    return found


def learnt(indicators: list[list[np.ndarray]], errors: list[np.ndarray], parts: int = 4) -> list[np.ndarray]:
    """Errors that a random forest expects from all indicators, given the truth of other pairs of the same shapes.

    No method: it has seen truths of the collection that it is evaluated on. It shows what the indicators can tell.
    """
    from sklearn.ensemble import RandomForestRegressor

    rows = [np.column_stack(of_pair) for of_pair in zip(*indicators)]
    forests = []
    for part in range(parts):
        others = [k for k in range(len(rows)) if k % parts != part]
        forest = RandomForestRegressor(300, min_samples_leaf=8, max_features=0.5, random_state=0)
        forests.append(forest.fit(*(np.concatenate([x[k] for k in others]) for x in (rows, errors))))
    return [forests[k % parts].predict(row) for k, row in enumerate(rows)]


def planted(loaded: dict[str, list[Shape]]) -> dict:
    """Coverage of regions under noise that the model is right about."""
    options = {"rng": 0, "n_refined": 60, "n_samples": 600, "n_draws": 200}
    synced = {name: fmsync.synchronize_shapes(shapes[:5], **options) for name, shapes in loaded.items()}
    return {name: {"coverage under planted noise": planted_noise(found)} for name, found in synced.items()}


def planted_noise(synced: SyncedShapes, kappas: Sequence[float] = (50.0, 200.0, 800.0), seeds: int = 2) -> dict:
    """Share of samples whose image under the true map lies in its region, by concentration and level."""
    truth = GroundTruth(synced.estimate.absolute, synced.edges, np.empty(0))
    turn, found = basis_signs(synced.signs, truth.n)[:, None], {}
    true = truth.absolute * turn  # in the bases of the shapes
    options = {"kappa": "auto", "n_draws": 250, "warmup": 300, "thin": 4}
    for kappa in kappas:
        inside = {str(q): [] for q in LEVELS}
        for seed in range(seeds):
            problem = perturb(truth, noise="langevin", kappa=kappa, rng=seed)
            estimate = fmsync.solve(problem, "mle")
            posterior = fmsync.sample(problem, "heat-bath", init=estimate, rng=seed, **options)
            other = replace(synced, problem=problem, posterior=posterior, refined=estimate.absolute * turn)
            for i, j in some_pairs(truth.n_nodes, 6):
                at_i, at_j = (synced.shapes[k].sampled()[:, : truth.n] for k in (i, j))
                place = nearest_rows(at_i @ true[i].T @ true[j], at_j)
                for q in LEVELS:
                    known = other.confidence(i, j, q)
                    inside[str(q)].append(synced.shapes[j].geodesics[place, known.image] <= known.radius)
        found[str(kappa)] = {q: float(np.mean(x)) for q, x in inside.items()}
    return found
