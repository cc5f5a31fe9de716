"""Every public function refuses bad arguments in words of its own: found by introspection, tried one by one."""

import collections
import importlib
import inspect
import re
import signal
import time
import traceback
import warnings
from pathlib import Path
from types import FunctionType

import matplotlib.pyplot as plt
import networkx as nx
import numpy as np
import pytest

import data_gen
import fmsync
from fmsync import diagnostics, so
from fmsync.matching import Confidence, ConformalCalibration, SyncedShapes
from fmsync.matching.pairwise import PairMatch
from fmsync.matching.samples import SampledShape
from tests.surfaces import icosphere

ROOT = Path(__file__).resolve().parents[1]
MODULES = """so langevin energy bounds calibration diagnostics oracle functional_maps descriptors shape
    problem estimators samplers matching mesh_io viz""".split()  # noqa: SIM905
SLOW = 2.0  # seconds, of one call

# Public classes that the library makes and users only read: their methods are tried, not their constructors.
RECORDS = """Estimate Trace Draws Posterior Summary ConvergenceWarning Confidence ConformalCalibration SyncedShapes
    SampledShape PairMatch Certificate RectangularEstimate GroundTruth Player Picture Scene Explorer
    Transferred Creature""".split()  # noqa: SIM905
ENGINES = ("RLFM", "HMC", "MALA", "HeatBath", "Tempered")  # constructors are tried; fmsync.sample drives the rest

# Functions that are not tried, with the reason.
KERNELS = {
    "fmsync.so.transpose": "a view, used in every inner loop; any array has one",
    "fmsync.so.sym": "one line of arithmetic for inner loops, defined for any square matrices",
    "fmsync.so.skew": "one line of arithmetic for inner loops, defined for any square matrices",
    "fmsync.samplers.base.Target.only": "samplers call it; it takes no data",
    "fmsync.samplers.base.Target.matched_kappa": "samplers call it; it takes no data",
    "fmsync.registry.Registry.register": "decorates a method when its module is imported; takes no data",
    "fmsync.matching.add.add_shape": "needs a synchronised collection: tests/matching/test_add_shape.py",
    "fmsync.matching.explored.explore": "needs synchronised collections: tests/matching/test_explored.py",
    "fmsync.matching.output.load_synced": "reads what fmsync sync wrote: tests/matching/test_transfer.py",
    "fmsync.matching.synchronize.synchronize_matches": "stages of synchronize_shapes, which checks for it",
    "fmsync.viz.explorer.State": "a record that explorer checks: tests/test_viz.py",
    "fmsync.viz.explorer.explorer": "draws what explore computed: tests/test_viz.py",
}

# Function, argument and kind of what is accepted or not refused in these words, with the reason.
ALLOWED = {
    ("fmsync.langevin.log_normaliser", "kappa", "list"): "concentrations may have any shape",
    ("fmsync.langevin.mean_cosine", "kappa", "list"): "concentrations may have any shape",
    ("fmsync.langevin.matched_kappa", "cosine", "-1"): "mean cosines below 0 have concentration 0, as documented",
    ("fmsync.so.random_uniform", "size", "number"): "a size may be one number",
    ("fmsync.bounds.is_small_error", "squared", "scalar"): "squared errors may have any shape",
    ("fmsync.bounds.is_small_error", "squared", "two axes"): "squared errors may have any shape",
    ("fmsync.diagnostics.ess", "values", "a column less"): "any number of draws",
    ("fmsync.diagnostics.rhat", "values", "a column less"): "any number of draws",
    ("fmsync.energy.transposed_sums", "blocks", "a column less"): "blocks may be (n, m)",
    ("fmsync.shape.Basis.coefficients", "functions", "a column less"): "any number of functions",
    ("fmsync.shape.edges_of_faces", "faces", "-1"): "does not know how many vertices there are",
    ("fmsync.shape.edges_of_faces", "faces", "too large"): "does not know how many vertices there are",
    (
        "fmsync.estimators.base.Estimate.from_absolute",
        "method",
        "unknown",
    ): "whoever makes an estimate names its method",
    ("fmsync.mesh_io.mesh_files", "paths", "of texts"): "the message begins with the name of the file",
    ("fmsync.problem.LangevinPrior", "kappa", "scalar"): "one concentration for all maps",
    ("fmsync.matching.transferred.transfer", "values", "strings"): "labels may be words",
}
FREE_TEXT = {"name", "label", "fitted_on", "titles"}  # any string will do
WORDS = {"vertices": "vertex", "faces": "face"}  # what messages call an item


def _subjects():
    """Public functions and methods by their full name; constructors by the name of their class."""
    found = {}

    def add(thing):
        if inspect.isclass(thing):
            if thing.__module__.split(".")[0] not in ("fmsync", "data_gen") or getattr(thing, "_is_protocol", False):
                return
            name = f"{thing.__module__}.{thing.__qualname__}"
            if thing.__name__ not in RECORDS:
                found[name] = thing
            for key, member in vars(thing).items() if thing.__name__ not in ENGINES else ():
                if not key.startswith("_") and isinstance(member, FunctionType | classmethod):
                    found[f"{name}.{key}"] = getattr(thing, key)
        elif inspect.isroutine(thing):
            found[f"{thing.__module__}.{thing.__qualname__}"] = thing

    for module in [importlib.import_module(f"fmsync.{name}") for name in MODULES]:
        own = [name for name, thing in vars(module).items() if getattr(thing, "__module__", "") == module.__name__]
        own = [name for name in own if not (name.startswith("_") or name.endswith("_unchecked"))]
        for name in getattr(module, "__all__", own):
            add(getattr(module, name))
    for package, names in ((fmsync, [*fmsync.__all__, "synchronize_shapes"]), (data_gen, data_gen.__all__)):
        for name in names:
            add(getattr(package, name))
    for name in re.findall(r"auto(?:function|class):: (\S+)", (ROOT / "book/api.md").read_text(encoding="utf-8")):
        add(_named(name))
    taking = {name for name, thing in found.items() if set(inspect.signature(thing).parameters) - {"self"}}
    return {name: found[name] for name in sorted(taking - set(KERNELS))}


def _named(dotted):
    parts = dotted.split(".")
    for k in range(len(parts) - 1, 0, -1):
        try:
            thing = importlib.import_module(".".join(parts[:k]))
        except ModuleNotFoundError:
            continue
        for part in parts[k:]:
            thing = getattr(thing, part)
        return thing
    raise LookupError(dotted)


class Valid:
    """Arguments that are accepted: by the name of the argument for all functions, and for some functions alone."""

    def __init__(self, folder):
        rng = np.random.default_rng(0)
        self.truth = data_gen.planted(4, 3, rng=1)
        problem = data_gen.perturb(self.truth, sigma2=0.02, rng=2)
        c = so.random_uniform(3, 4, rng=3)
        prior = fmsync.LangevinPrior(c, np.ones(4))
        omega = so.skew(rng.standard_normal((4, 3, 3)))
        vertices, faces = icosphere(1)
        self.shape = fmsync.Shape(vertices * [1.0, 0.8, 0.6], faces, "ball")
        basis = fmsync.laplace_beltrami(self.shape.vertices, faces, 5)
        n_vertices = basis.n_vertices
        with diagnostics.short_run(), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            post = fmsync.sample(problem, "heat-bath", kappa=20.0, n_chains=2, n_draws=8, warmup=4)
        estimate = fmsync.solve(problem)
        kept = np.arange(20)
        one = SampledShape(
            self.shape, basis, kept, rng.random((20, 20)), rng.random((5, 4)), rng.standard_normal((4, 5, 5)), None, 0,
        )  # fmt: skip
        score = rng.random(40)
        known = Confidence(*np.zeros((6, 40)), 0.9, score**2, *np.ones((2, 40)))
        edges = problem.edges
        synced = SyncedShapes(
            (one,) * 4, edges, tuple(PairMatch(np.eye(5), 0.1, 1.0) for _ in edges), np.ones(4), problem,
            estimate, post, so.random_uniform(5, 4, rng=4), (), np.arange(len(edges)),
        )  # fmt: skip
        calibration = ConformalCalibration("these", 1.0, (0.5, 0.9), (1.0, 2.0))
        rectangular = fmsync.RectangularSyncProblem(3, [[0, 1], [1, 2]], [np.eye(4, 3), np.eye(3, 5)])
        file = fmsync.save_problem(problem, folder / "problem.npz")
        calibration.save(folder / "calibration.json")
        mesh = folder / "ball.off"
        rows = [*(" ".join(map(str, v)) for v in self.shape.vertices), *(f"3 {a} {b} {c}" for a, b, c in faces)]
        mesh.write_text(f"OFF\n{n_vertices} {len(faces)} 0\n" + "\n".join(rows) + "\n")
        (folder / "ball.txt").write_text("\n".join(map(str, range(n_vertices))))
        angles = np.linspace(0, 6, 40)
        self.figures = lambda: [plt.subplots(figsize=(1, 1))[0] for _ in range(2)]
        order = np.arange(n_vertices)
        maps = {(i, j): order for i, j in edges.tolist()}
        rotations = so.random_uniform(3, 6, rng=5)
        start = so.random_uniform(3, (2, 4), rng=6)
        self.of_class = {
            "Basis": basis, "Shape": self.shape, "Estimate": estimate, "Posterior": post, "Confidence": known,
            "ConformalCalibration": calibration, "SyncedShapes": synced, "SampledShape": one, "GroundTruth": self.truth,
            "Summary": diagnostics.Summary(("energy",), *np.ones((5, 1))),
            "Target": fmsync.samplers.Target(problem, prior, kappa=2.0), "SyncProblem": problem,
            "RectangularEstimate": fmsync.solve_rectangular(rectangular),
        }  # fmt: skip
        self.common = {
            "problem": problem, "prior": prior, "c": c, "omega": omega, "sums": c + 1.0, "edges": edges, "n_nodes": 4,
            "n": 3, "rng": 0, "callback": lambda *_: None, "basis": basis, "basis_i": basis, "basis_j": basis,
            "kappa": 20.0, "sigma2": 0.1, "tolerance": 1e-6, "max_iterations": 50, "init": "spectral", "group": "SO",
            "post": post, "truth": self.truth, "alt": "What is shown.", "titles": ["a"], "shapes": [self.shape] * 4,
            "bases": [basis] * 4, "point_maps": maps, "pairs": edges[:2], "weights": np.ones(6), "maps": problem.maps,
            "vertices": self.shape.vertices, "faces": faces, "n_basis": 5, "absolute": c, "estimate": estimate,
            "path": file, "method": "mle", "i": 0, "j": 1, "graph": nx.complete_graph(4), "flip": order,
            "first": one, "second": one, "level": 0.8, "known": known, "target": self.of_class["Target"],
            "start": start, "beta": None, "count": 1, "provenance": {"from": "here"},
        }  # fmt: skip
        self.own = {
            "fmsync.so.project": {"a": rng.standard_normal((2, 3, 3))},
            "fmsync.so.qf": {"a": rng.standard_normal((2, 3, 3))},
            "fmsync.so.tangent": {"v": rng.standard_normal((4, 3, 3))},
            "fmsync.so.log": {"r": rotations},
            "fmsync.so.dist": {"a": rotations, "b": rotations[0]},
            "fmsync.so.random_uniform": {"size": (2, 3)},
            "fmsync.so.frechet_mean": {"rotations": so.exp(0.1 * omega)},
            "data_gen.collections.front_paw": {"shape": self.shape},
            "fmsync.langevin.matched_kappa": {"cosine": 0.5},
            "fmsync.energy.transposed_sums": {"blocks": c},
            "fmsync.bounds.recovery_cosine": {"n_observations": 3.0},
            "fmsync.bounds.is_small_error": {"squared": np.array([0.5, 12.6])},
            "fmsync.calibration.rank": {"draws": rng.random((9, 4)), "truth": rng.random(4)},
            "fmsync.calibration.uniformity": {"ranks": np.arange(60) / 59, "n_draws": 59, "bins": 10},
            "fmsync.calibration.ball_level": {"draws": rotations, "truth": rotations[0]},
            "fmsync.calibration.covered": {"draws": start, "truth": c, "levels": np.array([0.5, 0.9])} | {
                "draws": so.random_uniform(3, (6, 4), rng=7)
            },
            "fmsync.calibration.calibration_error": {"shares": np.array([0.5, 0.8]), "levels": np.array([0.5, 0.9])},
            "fmsync.calibration.energy_score": {"draws": rotations, "truth": rotations[0]},
            "fmsync.diagnostics.rhat": {"values": rng.standard_normal((2, 9))},
            "fmsync.diagnostics.ess": {"values": rng.standard_normal((2, 9))},
            "fmsync.oracle.oracle_accuracy": {"draws": start, "truth": c, "counts": np.array([1, 2])},
            "fmsync.oracle.haar_baseline": {"first": c, "n_samples": 3},
            "fmsync.functional_maps.functional_map": {"point_map": order},
            "fmsync.functional_maps.functional_map_from_descriptors": {
                "descriptors_i": rng.random((n_vertices, 6)), "descriptors_j": rng.random((n_vertices, 6)),
            },
            "fmsync.functional_maps.point_map": {"c_ij": np.eye(5), "vertices": order[:3]},
            "fmsync.functional_maps.nearest_rows": {"queries": rng.random((4, 3)), "targets": rng.random((7, 3))},
            "fmsync.descriptors.heat_kernel": {"landmarks": order[:3]},
            "fmsync.shape.Basis": {
                "eigenvalues": basis.eigenvalues, "eigenfunctions": basis.eigenfunctions, "mass": basis.mass,
            },
            "fmsync.shape.Basis.coefficients": {"functions": rng.random((n_vertices, 2))},
            "fmsync.shape.Basis.with_flipped": {"k": 2},
            "fmsync.functional_maps.vertex_images": {"maps": rng.random((6, 5, 5)), "vertex": 3},
            "fmsync.functional_maps.images_both_ways": {
                "maps": rng.random((6, 5, 5)), "bases": [basis, basis], "vertices": [order[:3], order[:2]],
            },
            "fmsync.functional_maps.row_images": {
                "rows": rng.random((4, 3)), "maps": rng.random((6, 3, 5)), "functions": rng.random((7, 5)),
            },
            "fmsync.matching.synchronize.SyncedShapes.confidence": {"point_map": order},
            "fmsync.problem.LangevinPrior": {"mean": c, "kappa": np.ones(4)},
            "fmsync.problem.fix_gauge": {"node": 1},
            "fmsync.estimators.rectangular.RectangularSyncProblem": {
                "n_nodes": 3, "edges": np.array([[0, 1], [1, 2]]), "maps": [np.eye(4, 3), np.eye(3, 5)],
                "weights": np.ones(2),
            },
            "fmsync.estimators.rectangular.RectangularEstimate.relative": {"edges": np.array([[0, 1]])},
            "fmsync.estimators.rectangular.RectangularEstimate.identifiable": {"edges": np.array([[0, 1]])},
            "fmsync.estimators.rectangular.solve_rectangular": {"problem": rectangular, "universe": 5},
            "fmsync.estimators.map.maximum_a_posteriori": {"rng": np.random.default_rng(0)},
            "fmsync.estimators.solve.solve": {"restarts": 2},
            "fmsync.estimators.solve.mean_of_starts": {"n_starts": 2},
            "fmsync.estimators.base.Estimate.from_absolute": {"method": "SO", "group": "SO"},
            "fmsync.samplers.posterior.Posterior.from_arviz": {"data": post.to_arviz()},
            "fmsync.samplers.base.Target": {"kappa": 2.0},
            "fmsync.samplers.rlfm.RLFM": {"rng": np.random.default_rng(0), "step": 0.01},
            "fmsync.samplers.hmc.HMC": {"rng": np.random.default_rng(0), "step": 0.01, "length": 0.1},
            "fmsync.samplers.hmc.MALA": {"rng": np.random.default_rng(0), "step": 0.01, "length": None},
            "fmsync.samplers.heat_bath.HeatBath": {"rng": np.random.default_rng(0)},
            "fmsync.samplers.tempered.Tempered": {"rng": np.random.default_rng(0), "hottest": 0.1},
            "fmsync.samplers.base.Target.matched_kappa": {"name": "kappa", "rng": np.random.default_rng(0)},
            "fmsync.samplers.sample.sample": {
                "method": "rlfm", "n_chains": 2, "n_draws": 4, "warmup": 2, "kappa": 2.0, "callback": lambda *_: None,
            },
            "fmsync.matching.conformal.fit_conformal": {
                "known": [known] * 2, "errors": [score] * 2, "levels": (0.25, 0.5), "collections": [0, 1],
            },
            "fmsync.matching.conformal.ConformalCalibration.save": {"path": folder / "again.json"},
            "fmsync.matching.conformal.ConformalCalibration.load": {"path": folder / "calibration.json"},
            "fmsync.matching.latent.latent_maps": {"n_shapes": 4},
            "fmsync.matching.transferred.transfer": {
                "synced": synced, "values": rng.random(n_vertices), "calibration": calibration,
            },
            "fmsync.matching.transferred.transfer_landmarks": {
                "synced": synced, "vertices": order[:3], "calibration": calibration,
            },
            "fmsync.matching.synchronize.SyncedShapes.shared_functions": {"vertices": order[:4]},
            "fmsync.matching.synchronize.SyncedShapes.vertex_images": {"vertex": 3},
            "fmsync.matching.samples.SampledShape.sampled": {"size": 4},
            "fmsync.matching.samples.SampledShape.light": {"n_basis": 4},
            "fmsync.matching.synchronize.synchronize_shapes": {
                "n_basis": 4, "n_refined": 6, "n_samples": 30, "n_draws": 0, "graph": "complete",
                "landmarks": [[0, 1]] * 4, "checkpoint": folder / "pairs", "maps": None, "bases": None,
            },
            "fmsync.mesh_io.mesh_files": {"paths": [mesh]},
            "fmsync.mesh_io.read_shape": {"path": mesh},
            "fmsync.problem.save_problem": {"path": folder / "again.npz"},
            "fmsync.viz.explorer.glow": {"shape": self.shape, "images": order[:3]},
            "fmsync.viz.figures.heatmaps": {"matrices": [np.eye(3)], "clim": (-1.0, 1.0)},
            "fmsync.viz.figures.picture": {"fig": plt.figure(figsize=(1, 1))},
            "fmsync.viz.players.player": {"figures": self.figures()},
            "fmsync.viz.players.walk_on_sphere": {
                "points": np.stack([np.cos(angles), np.sin(angles), 0 * angles], 1), "frames": 2,
            },
            "fmsync.viz.scenes.facing": {"mesh": self.shape, "vertex": 0},
            "fmsync.viz.scenes.scene": {
                "meshes": [self.shape], "scalars": [self.shape.vertices[:, 0]], "clim": (0.0, 1.0),
                "points": [order[:2]],
            },
            "data_gen.collections.correspondence_maps": {"correspondences": [order] * 4},
            "data_gen.collections.load_collection": {"source": folder / "meshes"},
            "data_gen.collections.load_correspondences": {"folder": folder, "shapes": [self.shape]},
            "data_gen.cats.left_right_flip": {"n_vertices": 1000},
            "data_gen.noise.perturb": {"kappa": None},
            "data_gen.truth.absolute_maps": {"distortion": np.ones(6), "tree": "minimum-distortion"},
            "data_gen.truth.planted": {"graph": nx.complete_graph(4)},
            "data_gen.truth.ground_truth": {"n_basis": 4},
            "data_gen.seeds.seed": {"number": 3},
        }  # fmt: skip
        (folder / "meshes").mkdir()
        (folder / "meshes" / "ball.off").write_text(mesh.read_text())

    def call(self, name, thing):
        """The callable and all its arguments: valid ones of the table, or the defaults."""
        parts = name.split(".")
        if parts[-2] in self.of_class and not inspect.ismethod(thing):
            thing = getattr(self.of_class[parts[-2]], parts[-1])
        given, missing = {}, []
        for parameter in inspect.signature(thing).parameters.values():
            if parameter.kind is parameter.VAR_KEYWORD or parameter.kind is parameter.VAR_POSITIONAL:
                continue
            own = self.own.get(name, {})
            table = {**self.common, **own}
            if parameter.annotation is np.random.Generator:
                table["rng"] = np.random.default_rng(0)
            needed = parameter.default in (None, parameter.empty)
            if parameter.name in own or (parameter.name in table and needed):
                given[parameter.name] = table[parameter.name]
            elif parameter.default is not parameter.empty and parameter.default is not None:
                given[parameter.name] = parameter.default
            else:
                missing.append(parameter.name)
        return thing, given, missing


def _arrays(value, index):
    """Bad arrays of the shape of a good one."""

    def with_entry(entry):
        changed = np.array(value, dtype=float if isinstance(entry, float) else type(entry) if index else float)
        changed[(0,) * changed.ndim] = entry
        return changed

    bad = {
        "complex": value + 1j, "masked": np.ma.masked_array(value, mask=np.zeros(np.shape(value), dtype=bool)),
        "strings": value.astype(str), "objects": np.full(value.shape, None), "text": "text", "None": None,
        "ragged": [[1.0], [1.0, 2.0]], "NaN": with_entry(np.nan), "infinite": with_entry(np.inf),
        "scalar": np.array(value.flat[0]),
    }  # fmt: skip
    if value.ndim >= 2:
        bad["a column less"] = value[..., :-1]
        bad["one axis"] = value.ravel()
    else:
        bad["two axes"] = value[None]
    if index:
        fraction = value + 0.5
        bad |= {"fractions": fraction, "booleans": value > 0, "-1": with_entry(-1), "too large": with_entry(10**6)}
    return bad


NUMBERS = {"text": "x", "list": [1.0, 2.0], "complex": 1j, "NaN": np.nan, "infinite": np.inf, "None": None}
RNG = {"None": None, "text": "x", "-1": -1, "fraction": 0.5, "boolean": True, "module": np.random,
       "old": np.random.RandomState(0)}  # fmt: skip


def bad_values(argument, value, optional):
    """Values that suit the argument as badly as can be, by name; None may suit one that is optional."""
    good = {"None"} if optional else set()
    if argument in FREE_TEXT:
        good |= {"unknown", "of texts"}
    return {kind: bad for kind, bad in _bad_values(argument, value).items() if kind not in good}


def _bad_values(argument, value):
    if argument == "rng":
        return RNG if isinstance(value, int) else {k: v for k, v in RNG.items() if k != "-1"}
    if isinstance(value, bool | np.bool_):
        return {"text": "yes", "two": 2, "list": [True], "None": None, "NaN": np.nan}
    if isinstance(value, int | np.integer):
        return NUMBERS | {"-1": -1, "fraction": 1.5, "boolean": True}
    if isinstance(value, float):
        return NUMBERS | {"-1": -1.0}
    if isinstance(value, str):
        return {"unknown": "no such thing" if argument != "alt" else "  ", "number": 3, "None": None, "list": ["x"]}
    if isinstance(value, np.ndarray):
        return _arrays(value, np.issubdtype(value.dtype, np.integer))
    if isinstance(value, Path):
        return {"number": 3, "None": None, "list": [1]}
    if isinstance(value, dict):
        return {"number": 3, "text": "x", "list": [1]}
    if isinstance(value, list | tuple):
        bad = {"number": 3, "None": None, "text": "x", "of None": [None] * len(value), "of texts": ["?"] * len(value)}
        return bad | ({"NaN": [np.nan] * len(value)} if not isinstance(value[0], Path) else {})
    if callable(value):
        return {"number": 3, "text": "x"}
    return {"None": None, "number": 3, "text": "x", "object": object(), "array": np.eye(3), "list": [1, 2]}


def _late(*_):
    raise TimeoutError


def outcome(thing, arguments, name, kind):
    """How a call with one bad argument ends: "refused" in our words, "foreign", "accepted" or "slow", and details.

    A message names the argument or, where sizes of several arguments disagree, another one of these.
    """
    signal.setitimer(signal.ITIMER_REAL, SLOW)
    try:
        thing(**arguments)
    except TimeoutError:
        return "slow", ""
    except Exception as error:
        frame = traceback.extract_tb(error.__traceback__)[-1]
        said = str(error)
        ours = any(Path(frame.filename).is_relative_to(ROOT / package) for package in ("fmsync", "data_gen"))
        sizes = kind in ("a column less", "one axis", "two axes", "scalar")
        names = "|".join(arguments if sizes else [name, WORDS.get(name, name)])
        named = re.search(rf"^({names})\b|\b({names})(\[[^\]]*\])*( =|:| must| is | has | \d)", said)
        if isinstance(error, ValueError | TypeError) and ours and named:
            return "refused", said
        return "foreign", f"{type(error).__name__}: {said[:150]} ({Path(frame.filename).name}:{frame.lineno})"
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
    return "accepted", ""


def _allowed(name, argument, kind):
    return any((who, what, how) in ALLOWED for who in (name, "*") for what in (argument, "*") for how in (kind, "*"))


@pytest.fixture(scope="module")
def valid(tmp_path_factory):
    return Valid(tmp_path_factory.mktemp("valid"))


def test_every_public_function_has_a_valid_call(valid):
    lacking = []
    for name, thing in _subjects().items():
        call, given, missing = valid.call(name, thing)
        if missing:
            lacking.append(f"{name}: add {', '.join(missing)} to Valid.own[{name!r}]")
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                call(**given)
            except Exception as error:
                lacking.append(f"{name}: {type(error).__name__} {error}; mend Valid.own[{name!r}]")
    assert not lacking, "\n".join(lacking)


def test_every_public_function_refuses_bad_arguments_in_words(valid, capsys):
    handler = signal.signal(signal.SIGALRM, _late)
    counts, wrong = collections.Counter(), []
    began = time.perf_counter()
    try:
        for name, thing in _subjects().items():
            call, given, _ = valid.call(name, thing)
            parameters = inspect.signature(call).parameters
            for argument, value in given.items():
                optional = "None" in str(parameters[argument].annotation) or parameters[argument].default is None
                if value is None:
                    continue
                for kind, bad in bad_values(argument, value, optional).items():
                    with warnings.catch_warnings(), np.errstate(all="ignore"):
                        warnings.simplefilter("ignore")
                        if name.startswith("fmsync.viz"):
                            plt.close("all")
                        result, detail = outcome(call, {**given, argument: bad}, argument, kind)
                    counts[result] += 1
                    if result != "refused" and not _allowed(name, argument, kind):
                        wrong.append(f"{name}({argument} {kind}): {result} {detail}")
    finally:
        signal.signal(signal.SIGALRM, handler)
    total = sum(counts.values())
    with capsys.disabled():
        shares = ", ".join(f"{number} {kind} ({number / total:.1%})" for kind, number in counts.most_common())
        print(f"\n{total} bad arguments of {len(_subjects())} functions: {shares}; {time.perf_counter() - began:.0f} s")
    assert not wrong, "\n".join(wrong)
    assert counts["refused"] >= 0.95 * total


def test_matrices_that_are_no_rotations_are_refused():
    for bad in (2 * np.eye(3), np.diag([1.0, 1.0, -1.0]), np.ones((2, 3, 3))):
        for call in (
            so.log,
            lambda x: so.dist(np.eye(3), x),
            lambda x: so.tangent(x, x),
            lambda x: so.frechet_mean(x[None]),
        ):
            with pytest.raises(ValueError, match="is not a rotation; project it first"):
                call(bad)
    for call in (so.exp, so.cayley):
        with pytest.raises(ValueError, match="omega: not skew-symmetric"):
            call(np.eye(3))


def test_options_that_a_method_ignores_are_refused(valid, tmp_path):
    problem, c = valid.common["problem"], valid.common["c"]
    calls = {
        "tolerance": lambda: fmsync.solve(problem, "mle-unconstrained", tolerance=1e-3),
        "max_iterations": lambda: so.frechet_mean(c, distance="chordal", max_iterations=5),
        "kappa": lambda: fmsync.solve(problem, "map", kappa=3.0),
        "retraction": lambda: fmsync.sample(problem, "rlfm", constrained=False, retraction="qf"),
        "length": lambda: fmsync.sample(problem, "mala", kappa=2.0, length=1.0),
        "init": lambda: fmsync.estimators.mean_of_starts(problem, 2, init="spectral"),
        "count": lambda: data_gen.load_collection(valid.own["data_gen.collections.load_collection"]["source"], count=3),
    }
    for name, call in calls.items():
        with pytest.raises(ValueError, match=f"^{name}: "):
            call()


def test_what_is_valid_stays_valid():
    turn = [[0, -1], [1, 0]]
    np.testing.assert_array_equal(so.project(turn), turn)  # lists, and integers for numbers
    assert so.dist(np.eye(2), [turn] * 3).shape == (3,)
    assert so.log(np.empty((0, 3, 3))).shape == (0, 3, 3)
    assert so.exp(np.zeros((2, 3, 3), dtype=np.float32)).dtype == np.float32
    assert so.random_uniform(3.0, [2, 1], np.int64(0)).shape == (2, 1, 3, 3)
    assert fmsync.bounds.relative_error_bound(2, [(0, 1)], 3, np.float32(1)).shape == (1,)


def test_robust_ends_when_no_step_helps(valid):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for loss in ("mixture", "geman-mcclure", "l1"):
            fmsync.solve(valid.common["problem"], "robust", loss=loss, tolerance=0, max_iterations=60)
