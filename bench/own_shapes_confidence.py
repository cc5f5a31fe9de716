"""Are the regions of the pipeline for own shapes as likely as they say, and do they find the wrong vertices?"""

from dataclasses import asdict, replace

import numpy as np

import fmsync
from bench.own_shapes import Judge, accuracy, judged, some_pairs
from bench.suites import generator_function
from fmsync import so
from fmsync.functional_maps import nearest_rows
from fmsync.matching import Confidence, ConformalCalibration, SyncedShapes, fit_conformal
from fmsync.matching.confidence import two_modes
from fmsync.matching.conformal import default_calibration
from fmsync.matching.synchronize import basis_signs
from fmsync.problem import SyncProblem

LEVELS = (0.5, 0.8, 0.9, 0.95)
KEPT = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1)
_GROSS = 0.05  # errors above it are called gross
_NUMBERS = ("radius", "entropy", "spread", "local_distortion", "distortion")  # what a confidence says of a vertex


def collections(loaded: dict) -> dict:
    """Errors, coverage and selective use on every collection, recalibrated on each and as the package ships it."""
    observed = {name: observe(shapes) for name, shapes in loaded.items()}
    fitted = {name: fit_conformal(o["known"], o["errors"], name) for name, o in observed.items()}
    found = {}
    for k, (name, o) in enumerate(observed.items()):
        others = {f"recalibrated on {other}": r for other, r in fitted.items()} | {"as shipped": default_calibration()}
        strange = next((r for other, r in fitted.items() if other != name), default_calibration())
        peers = k == 0  # on the first collection alone: they take most of the time
        found[name] = accuracy(o["synced"], o["judge"], peers) | {
            "kappa": float(o["synced"].posterior.kappa.mean()),
            "map error over posterior spread": misspecified(o["synced"]),
            "coverage": {"as it comes": {str(q): _covered(o, q) for q in LEVELS}}
            | {how: {str(q): _covered(o, q, r) for q in LEVELS} for how, r in others.items()},
            "mean radius at 0.9": {
                how: float(np.mean([r.radius(k, 0.9) for k in o["known"]])) for how, r in others.items()
            },
            "recalibration": asdict(fitted[name]),
            "ranked by the recalibration of": strange.fitted_on,
            "selective": selective(o, strange),
        }
    return found


def refit(loaded: dict) -> ConformalCalibration:
    """ConformalCalibration from all collections together."""
    observed = [observe(shapes) for shapes in loaded.values()]
    known, errors = ([x for o in observed for x in o[part]] for part in ("known", "errors"))
    words = " and ".join(f"{len(x)} {n.replace('_', ' ')}" for n, x in loaded.items())
    return fit_conformal(known, errors, words.replace("cats", "synthetic cats"))


def observe(shapes) -> dict:
    """The pipeline run on shapes of one order, what it says of the judged vertices, and their true errors."""
    synced, places = fmsync.synchronize_shapes(shapes, rng=0), judged(shapes)
    judge, pairs = Judge(synced, places), some_pairs(len(shapes), 16)
    at_samples = [synced.confidence(i, j) for i, j in pairs]
    known = [at_vertices(judge, i, k) for (i, _), k in zip(pairs, at_samples)]
    errors = [judge.shared(i, j, synced.refined[i], synced.refined[j]).astype(float) for i, j in pairs]
    raw = [quantiles(synced, i, j, k.image) for (i, j), k in zip(pairs, at_samples)]
    draws = {q: [judge.at(i, r[n]) for (i, _), r in zip(pairs, raw)] for n, q in enumerate(LEVELS)}
    cheap = [alternatives(synced, places, i, j) for i, j in pairs]
    return {"synced": synced, "judge": judge, "known": known, "errors": errors, "draws": draws, "cheap": cheap}


def quantiles(synced: SyncedShapes, i: int, j: int, image: np.ndarray) -> np.ndarray:
    """(levels, S_i) radii about ``image`` that hold each of ``LEVELS`` of the posterior draws."""
    n, a, b = synced.problem.n, synced.shapes[i], synced.shapes[j]
    hits = [nearest_rows(a.sampled()[:, :n] @ c, b.sampled()[:, :n]) for c in synced.draws(i, j, 100)]
    return np.quantile(b.geodesics[np.array(hits), image], LEVELS, axis=0)


def at_vertices(judge: Judge, i: int, known: Confidence) -> Confidence:
    """The lengths of a confidence carried from samples of shape i to the judged vertices."""
    return replace(known, **{name: judge.at(i, getattr(known, name)) for name in _NUMBERS})


def _covered(o: dict, level: float, recalibration: ConformalCalibration | None = None) -> float:
    radii = o["draws"][level] if recalibration is None else [recalibration.radius(k, level) for k in o["known"]]
    return float(np.mean(np.concatenate(o["errors"]) <= np.concatenate(radii)))


def alternatives(synced: SyncedShapes, places: np.ndarray, i: int, j: int) -> dict:
    """What is cheaper than a posterior: distance in the embedding, and the error of cycles through the pair."""
    at_i, at_j = synced.shared_functions(i, places[i]), synced.shared_functions(j)
    distance = np.linalg.norm(at_i - at_j[nearest_rows(at_i, at_j)], axis=1)
    return {"embedding distance": distance, "cycle error": np.full(len(at_i), cycle_errors(synced)[i, j])}


def cycle_errors(synced: SyncedShapes) -> np.ndarray:
    """(N, N) mean Frobenius distance of an observed map from its detours through every third shape."""
    count, n = len(synced.shapes), synced.problem.n
    maps = np.full((count, count, n, n), np.nan)
    for (i, j), c in zip(synced.edges, synced.problem.maps):
        maps[i, j], maps[j, i] = c, c.T
    gaps = np.linalg.norm(np.einsum("ikab,kjbc->ijkac", maps, maps) - maps[:, :, None], axis=(3, 4))
    known = np.isfinite(gaps)
    return np.where(known.any(axis=2), np.where(known, gaps, 0).sum(axis=2) / np.maximum(known.sum(axis=2), 1), np.inf)


def selective(o: dict, recalibration: ConformalCalibration) -> dict:
    """Errors of the vertices kept when the least certain are dropped: curves, areas and shares of gross errors."""
    errors = np.concatenate(o["errors"])
    scores = {"expected error": [recalibration.expected(k) for k in o["known"]]}
    scores |= {name: [getattr(k, name) for k in o["known"]] for name in _NUMBERS}
    scores |= {name: [c[name] for c in o["cheap"]] for name in o["cheap"][0]}
    scores["learnt here"] = learnt(list(scores.values()), o["errors"])
    found = {"kept": KEPT, "curve": {}, "area": {}, "gross at 0.5 over gross of all": {}}
    for name, values in {**scores, "oracle": o["errors"]}.items():
        ranked = errors[np.argsort(np.concatenate(values), kind="stable")]
        running = ranked.cumsum() / np.arange(1, len(ranked) + 1) / ranked.mean()  # 1 where all are kept
        found["curve"][name] = [float(running[max(0, round(share * len(ranked)) - 1)]) for share in KEPT]
        found["area"][name] = float(running.mean())
        gross = (ranked[: len(ranked) // 2] > _GROSS).mean() / max((ranked > _GROSS).mean(), 1e-12)
        found["gross at 0.5 over gross of all"][name] = float(gross)
    return found


def learnt(signs: list[list[np.ndarray]], errors: list[np.ndarray], parts: int = 4) -> list[np.ndarray]:
    """Errors that a random forest expects from all signs, given the truth of other pairs of the same shapes.

    No method: it has seen truths of the collection that it is judged on. About what these signs can tell at all.
    """
    from sklearn.ensemble import RandomForestRegressor

    rows = [np.column_stack(of_pair) for of_pair in zip(*signs)]
    expected: list[np.ndarray] = [np.empty(0)] * len(rows)
    for part in range(parts):
        others = [k for k in range(len(rows)) if k % parts != part]
        forest = RandomForestRegressor(300, min_samples_leaf=8, max_features=0.5, random_state=0)
        forest.fit(np.concatenate([rows[k] for k in others]), np.concatenate([errors[k] for k in others]))
        for k in range(part, len(rows), parts):
            expected[k] = forest.predict(rows[k])
    return expected


def misspecified(synced: SyncedShapes) -> float:
    """Root mean square distance of the true maps from the posterior mean, over that of the draws; 1 if all is well."""
    apart, spread = [], []
    n = synced.problem.n
    for i, j in some_pairs(len(synced.shapes)):
        a, b = synced.shapes[i].basis.truncated(n), synced.shapes[j].basis.truncated(n)
        turn = basis_signs(synced.signs, n)
        truth = so.project(turn[i][:, None] * a.coefficients(b.eigenfunctions) * turn[j])  # one vertex order
        draws = turn[i][:, None] * synced.draws(i, j, 100) * turn[j]
        mean = so.project(draws.mean(axis=0))
        apart.append(((truth - mean) ** 2).sum())
        spread.append(((draws - mean) ** 2).sum(axis=(1, 2)).mean())
    return float(np.sqrt(np.mean(apart) / np.mean(spread)))


def planted(loaded: dict) -> dict:
    """Regions under noise that the model is right about, and the flag of two modes under flips that are known."""
    found = {}
    for name, shapes in loaded.items():
        synced = fmsync.synchronize_shapes(shapes[:5], rng=0, n_refined=60, n_samples=600, n_draws=200)
        found[name] = {
            "coverage under planted noise": planted_noise(synced),
            "two modes under planted flips": {
                str(share): dict(zip(("precision", "recall"), planted_flips(synced, share)))
                for share in (0.1, 0.2, 0.3)
            },
        }
    return found


def planted_noise(synced: SyncedShapes, kappas=(50.0, 200.0, 800.0), seeds: int = 2) -> dict:
    """Share of samples whose image under the true map lies in its region, at every concentration and level."""
    count, n, edges = len(synced.shapes), synced.problem.n, synced.edges
    noise = generator_function("data_gen.langevin:langevin_noise")
    truth, found = synced.estimate.absolute, {}
    for kappa in kappas:
        inside = {q: [] for q in LEVELS}
        for seed in range(seeds):
            maps = so.transpose(truth[edges[:, 0]]) @ truth[edges[:, 1]] @ noise(n, kappa, len(edges), seed)
            problem = SyncProblem(count, edges, maps)
            estimate = fmsync.solve(problem, "mle")
            options = {"kappa": "auto", "n_draws": 250, "warmup": 300, "thin": 4, "rng": seed}
            posterior = fmsync.sample(problem, "heat-bath", init=estimate, **options)
            turn = basis_signs(synced.signs, n)[:, None]
            other = replace(synced, problem=problem, posterior=posterior, refined=estimate.absolute * turn)
            for i, j in some_pairs(count, 6):
                a, b = synced.shapes[i], synced.shapes[j]
                true = (truth[i] * turn[i]).T @ (truth[j] * turn[j])
                place = nearest_rows(a.sampled()[:, :n] @ true, b.sampled()[:, :n])
                image = other.sample_images(i, j)
                for q, radius in zip(LEVELS, quantiles(other, i, j, image)):
                    inside[q].append(b.geodesics[place, image] <= radius)
        found[str(kappa)] = {str(q): float(np.mean(x)) for q, x in inside.items()}
    return found


def planted_flips(synced: SyncedShapes, share: float, far: float = 0.16) -> tuple[float, float]:
    """Precision and recall of the flag of two modes when left and right are swapped on a share of the pairs.

    For shapes of ``data_gen.load_collection("cats")``, whose mirror images are known. A sample truly has two modes if
    it is farther than ``far`` from its mirror image and its votes split; those nearly on the mirror plane are left out.
    """
    count, n_vertices = len(synced.shapes), synced.shapes[0].shape.n_vertices
    mirror = generator_function("data_gen:left_right_flip")(n_vertices)
    chosen = np.random.default_rng(0).permutation(len(synced.edges)) < round(share * len(synced.edges))
    flipped = {tuple(e): bool(f) for e, f in zip(synced.edges.tolist(), chosen)}
    matches = []
    for (_, j), found, turned in zip(synced.edges, synced.matches, chosen):
        basis = synced.shapes[j].basis.truncated(len(found.c_ij))
        turn = basis.coefficients(basis.eigenfunctions[mirror])
        matches.append(replace(found, c_ij=found.c_ij @ turn) if turned else found)
    other = replace(synced, matches=tuple(matches))
    hits = np.zeros(3)  # flagged rightly, flagged wrongly, missed
    for i, j in synced.edges.tolist():
        others = [k for k in range(count) if k not in (i, j)]
        votes = [flipped[i, j]] + [flipped[min(i, k), max(i, k)] ^ flipped[min(k, j), max(k, j)] for k in others]
        support = min(np.mean(votes), 1 - np.mean(votes))
        points, own = synced.shapes[j].shape.vertices, synced.shapes[i].samples
        apart = np.linalg.norm(points[own] - points[mirror[own]], axis=1)
        clear = (apart < far / 2) | (apart > far)
        true = (apart > far) & (support >= 0.2)
        flagged = two_modes(other.votes(i, j), synced.shapes[j].geodesics)
        hits += [(clear & a & b).sum() for a, b in ((flagged, true), (flagged, ~true), (~flagged, true))]
    return float(hits[0] / max(hits[0] + hits[1], 1)), float(hits[0] / max(hits[0] + hits[2], 1))
