"""The contract that every method of the benchmark keeps, and what single controls and peers must do."""

import warnings

import numpy as np
import pytest

from bench import methods
from bench.metrics import frobenius_errors
from bench.problems import Planted
from fmsync import so
from fmsync.problem import SyncProblem, relative_maps

QUICK = {"sampler": {"n_chains": 2, "n_draws": 40, "warmup": 20}}  # a contract, not a contest
NEEDS_SHAPES = {"consistent-zoomout"}
NAMES = [
    name
    for name in methods.names()
    if name not in NEEDS_SHAPES
    and methods.get(name).module.startswith(("fmsync.", "bench."))  # other tests register tricks
]


def answer(name, problem, seed=0, **options):
    entry = methods.get(name)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # some peers stop early, and say so
        return entry.run(problem, np.random.default_rng(seed), {**QUICK.get(entry.kind, {}), **options})


@pytest.mark.parametrize("name", NAMES)
def test_contract(name, planted):
    """Shapes, finite numbers, determinism, no change of the problem, and indifference to the gauge of the truth."""
    if name == "pyfm-network":
        pytest.importorskip("pyFM")
    problem = planted(n_nodes=5, n=4)
    before = problem.problem.maps.copy()
    pairs = problem.pairs()
    first = answer(name, problem)
    maps = first.relative(pairs)
    assert maps.shape == (len(pairs), 4, 4)
    assert np.isfinite(maps).all()
    np.testing.assert_array_equal(answer(name, problem).relative(pairs), maps)
    np.testing.assert_array_equal(problem.problem.maps, before)
    np.testing.assert_allclose(maps @ first.relative(pairs[:, ::-1]), np.broadcast_to(np.eye(4), maps.shape), atol=1e-6)
    turned = Planted(problem.problem, so.random_uniform(4, rng=9) @ problem.truth)
    np.testing.assert_allclose(answer(name, turned).relative(pairs), maps, atol=1e-12)
    if first.draws is not None:
        assert first.draws.ndim == 4
        assert first.draws.shape[1:] == (5, 4, 4)


@pytest.mark.parametrize("name", [name for name in NAMES if name not in ("identity", "random")])
def test_consistent_maps_are_recovered_by_all_who_look(name, planted):
    if name == "pyfm-network":
        pytest.importorskip("pyFM")
    problem = planted(n_nodes=5, n=4, sigma2=0.0)
    errors = frobenius_errors(answer(name, problem).relative(problem.pairs()), problem.relative(problem.pairs()))
    if methods.get(name).kind == "sampler":
        assert errors.mean() < 0.8 * np.sqrt(8)  # a posterior at its own temperature, not a point
    else:
        assert errors.max() < 1e-5


def test_oracle_is_exact_and_strangers_are_far(planted):
    problem = planted(n_nodes=6, n=10, sigma2=0.3)
    pairs = problem.pairs()
    error = {
        k: frobenius_errors(answer(k, problem).relative(pairs), problem.relative(pairs))
        for k in ("oracle", "random", "identity", "observed")
    }
    assert error["oracle"].max() == 0.0
    assert abs((error["random"] ** 2).mean() - 20) < 2  # 2 n
    assert abs((error["identity"] ** 2).mean() - 20) < 2
    np.testing.assert_allclose(error["observed"], frobenius_errors(problem.problem.maps, problem.relative(pairs)))


def test_observed_says_nothing_about_other_pairs():
    maps = np.stack([np.eye(3)] * 2)
    problem = Planted(SyncProblem(3, [[0, 1], [2, 1]], maps), np.stack([np.eye(3)] * 3))
    relative = answer("observed", problem).relative(np.array([[1, 0], [0, 2]]))
    assert np.isfinite(relative[0]).all()
    assert np.isnan(relative[1]).all()


def test_mean_of_starts_is_the_estimate_where_all_starts_agree(planted):
    problem = planted(n_nodes=6, n=5, sigma2=0.02)
    pairs = problem.pairs()
    np.testing.assert_allclose(
        answer("mean-of-starts", problem, n_starts=3).relative(pairs), answer("mle", problem).relative(pairs), atol=1e-4
    )


def test_confidence_balls_report_what_they_hold(planted):
    problem = planted(n_nodes=6, n=4, sigma2=0.01)
    found = answer("confidence-balls", problem)
    np.testing.assert_array_equal(found.relative(problem.pairs()), answer("mle", problem).relative(problem.pairs()))
    shares = [found.numbers()[f"coverage_{level}"] for level in (50, 80, 90, 95)]
    assert shares == sorted(shares)
    assert 0 <= shares[0] < 1
    assert shares[-1] > 0.5


def test_truncated_least_squares_and_cycles_leave_the_outliers_out(planted):
    problem = planted(n_nodes=12, n=8, sigma2=0.01, outliers=0.3)
    pairs = problem.pairs()
    error = {name: frobenius_errors(answer(name, problem).relative(pairs), problem.relative(pairs)).mean()
             for name in ("cemp", "gnc-tls", "mle", "robust")}  # fmt: skip
    assert error["gnc-tls"] < 0.7 * error["mle"]
    assert error["gnc-tls"] < 1.1 * error["robust"]
    assert error["cemp"] < 0.8 * error["mle"]


def test_convergence_ends_at_the_answer(planted):
    problem = planted(n_nodes=5, n=4)
    pairs = problem.pairs()
    for of, on_group, options in (
        ("mle", True, {"init": "random"}),
        ("mle-unconstrained", False, {"solver": "iterative"}),
    ):
        found = answer("convergence", problem, of=of, on_group=on_group, **options)
        steps = [step for step, _ in found.path]
        assert steps == sorted(steps)
        assert len(steps) > 3
        np.testing.assert_allclose(found.path[-1][1](pairs), found.relative(pairs), atol=1e-5)


def test_pyfm_cycles_vanish_only_in_the_right_order(planted):
    pytest.importorskip("pyFM")
    from bench.methods.pyfm_network import has_cycles, shape_network

    consistent = planted(n_nodes=5, n=4, sigma2=0.0).problem
    for fixed in (True, False):
        network = shape_network(consistent, fixed)
        assert has_cycles(network)
        errors = [network.get_cycle_weight(cycle, M=consistent.n) for cycle in network.cycles]
        assert (max(errors) < 1e-12) if fixed else (max(errors) > 0.5)


def test_pyfm_variants(planted):
    pytest.importorskip("pyFM")
    problem = planted(n_nodes=6, n=5, sigma2=0.05)
    pairs, truth = problem.pairs(), problem.relative(problem.pairs())
    projected = answer("pyfm-network", problem, projected=True).relative(pairs)
    spectral = answer("spectral", problem).relative(pairs)
    np.testing.assert_allclose(projected, spectral, atol=0.05)  # complete graph: the same relaxation
    fixed = answer("pyfm-network", problem, projected=True, weights="icsm-fixed").relative(pairs)
    assert frobenius_errors(fixed, truth).mean() < 1.3 * frobenius_errors(projected, truth).mean()
    tree = Planted(SyncProblem(3, [[0, 1], [1, 2]], np.stack([np.eye(3)] * 2)), np.stack([np.eye(3)] * 3))
    with pytest.raises(ValueError, match="3-cycle"):
        answer("pyfm-network", tree, weights="icsm")
    with pytest.raises(ValueError, match="weights"):
        answer("pyfm-network", tree, weights="isometric")


def test_unknown_method_offers_near_ones():
    with pytest.raises(ValueError, match="did you mean .*spectral"):
        methods.get("spectrl")


def test_options_of_each_kind():
    assert {"step", "n_draws", "warmup"} <= methods.get("rlfm").option_names
    assert {"init", "restarts", "tolerance"} <= methods.get("mle").option_names
    assert methods.get("mean-of-starts").option_names == {"of", "n_starts", "distance"}


def test_a_file_adds_a_method(tmp_path, planted):
    file = tmp_path / "average.py"
    file.write_text(
        "from fmsync import so\nfrom bench.methods import Answer, method\n\n"
        '@method("first-edge-only-for-a-test")\n'
        "def f(problem, *, rng):\n    return Answer.from_absolute(so.random_uniform(problem.n, problem.n_nodes, rng))\n"
    )
    try:
        assert methods.load(file) == ["first-edge-only-for-a-test"]
        assert methods.load(file) == ["first-edge-only-for-a-test"]  # again, e.g. in a worker
        assert answer("first-edge-only-for-a-test", planted()).relative(np.array([[0, 1]])).shape == (1, 4, 4)
    finally:
        methods._REGISTRY.pop("first-edge-only-for-a-test")


def test_files_that_add_nothing_or_take_a_name(tmp_path):
    with pytest.raises(ValueError, match="no such file"):
        methods.load(tmp_path / "missing.py")
    (tmp_path / "empty_for_a_test.py").write_text("")
    with pytest.raises(ValueError, match="registers no method"):
        methods.load(tmp_path / "empty_for_a_test.py")
    (tmp_path / "thief_for_a_test.py").write_text(
        'from bench.methods import method\n@method("oracle")\ndef f(problem, *, rng): ...\n'
    )
    kept = methods._REGISTRY["oracle"]
    try:
        with pytest.raises(ValueError, match="'oracle' is taken by bench.methods.controls"):
            methods.load(tmp_path / "thief_for_a_test.py")
    finally:
        methods._REGISTRY["oracle"] = kept


def test_relative_maps_of_absolute(planted):
    absolute = so.random_uniform(3, 4, rng=1)
    pairs = np.array([[0, 1], [3, 2]])
    np.testing.assert_array_equal(
        methods.Answer.from_absolute(absolute).relative(pairs), relative_maps(absolute, pairs)
    )


@pytest.fixture(scope="module")
def on_shapes():
    from bench.problems import shapes

    return shapes(seed=0, n_nodes=4, n=14, n_vertices=1000, sigma2=0.01, around="measured", points=100)


def test_consistent_zoomout_refines_and_needs_shapes(on_shapes, planted):
    pytest.importorskip("pyFM")
    pairs = on_shapes.pairs()
    first = answer("consistent-zoomout", on_shapes).relative(pairs)
    np.testing.assert_allclose(answer("consistent-zoomout", on_shapes).relative(pairs), first, atol=1e-8)
    error = frobenius_errors(first, on_shapes.relative(pairs)).mean()
    assert error < frobenius_errors(answer("random", on_shapes).relative(pairs), on_shapes.relative(pairs)).mean() / 2
    with pytest.raises(ValueError, match="no shapes"):
        answer("consistent-zoomout", planted())
