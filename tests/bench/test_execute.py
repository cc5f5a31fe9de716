"""One run: limits, status, and metrics that agree with their own functions."""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import data_gen
from bench import methods
from bench import runner as executing
from bench.metrics import frobenius_errors, measure
from bench.problems import Planted
from bench.runner import execute, isolated
from bench.suites import Run
from fmsync import diagnostics
from fmsync.shape import Basis
from tests.bench.helpers import TIMING, TRICKS, untimed, values

SMALL = {"n_nodes": 5, "n": 4, "sigma2": 0.05}


def run(method, options=None, seed=0, problem=SMALL, **limits):
    generator = "bench.problems:rotations"
    return Run(generator, problem, seed, method, method, options or {}, file=TRICKS, **limits)


def test_a_sound_run():
    record = execute(run("mle"), "abc")
    assert record["status"] == "ok"
    assert record["commit"] == "abc"
    found = values(record)
    assert 0 < found["edge_error"] <= found["edge_rms"]
    assert found["edge_error"] == pytest.approx(found["pair_error"])  # complete graph
    assert found["cycle_error"] < 1e-9
    assert 0 < found["floor_rms"] < found["expected_rms"]
    assert 0 < found["cpu_seconds"] < 10


def test_the_same_run_gives_the_same_numbers():
    options = {"n_draws": 50, "warmup": 20, "n_chains": 2}
    first, second = (execute(run("rlfm", options)) for _ in range(2))
    assert untimed(first) == untimed(second)
    assert {"energy_score", "coverage_90", "oracle_accuracy", "calibration_error", *TIMING} <= set(values(first))


@pytest.mark.parametrize("seed", range(3))
def test_methods_do_not_draw_the_numbers_of_the_truth(seed):
    """A random answer is as far from the truth as strangers are; from the truth's own stream it would be near."""
    found = values(execute(run("random", seed=seed, problem={"n_nodes": 8, "n": 12, "sigma2": 0.1})))
    assert found["pair_rms"] == pytest.approx(np.sqrt(24), rel=0.1)


def test_a_worker_gives_the_same_numbers():
    assert untimed(execute(run("mle"))) == untimed(isolated(run("mle")))


def test_a_slow_method_is_stopped_and_said_to_be_slow():
    """Even one that swallows all exceptions."""
    began = time.perf_counter()
    record = isolated(run("trick-sleep", seconds=0.3))
    assert record["status"] == "timeout"
    assert "0.3 s" in record["traceback"]
    assert record["metrics"] == []
    assert time.perf_counter() - began < 40
    assert isolated(run("mle", seconds=30.0))["status"] == "ok"


def test_the_limit_is_of_the_method_alone():
    """The toy on which the method is tried first takes none of its time, and no alarm is left behind."""
    records = [isolated(run("trick-count", {"log": "/dev/null", "seconds": 0.5}, seed, seconds=0.9)) for seed in (0, 1)]
    assert [record["status"] for record in records] == ["ok", "ok"]


def test_a_crash_is_recorded():
    record = isolated(run("trick-die"))
    assert record["status"] == "crashed"
    assert "exit code 9" in record["traceback"]
    assert isolated(run("mle"))["status"] == "ok"


def test_what_a_method_prints_does_not_come_between_the_records():
    assert isolated(run("trick-print"))["status"] == "ok"


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the memory limit needs /proc")
def test_a_greedy_method_is_stopped_and_said_to_be_greedy():
    record = isolated(run("trick-hog", memory=500.0))
    assert record["status"] == "memory"
    assert "500 MB" in record["traceback"]
    assert isolated(run("mle"))["status"] == "ok"


def test_peak_memory_is_the_method_s_own():
    @methods.method("trick-memory")
    def take(problem, *, rng):
        if problem.n_nodes > 3:
            np.ones(2**23).sum()  # 64 MB
        return methods.Answer.from_absolute(np.stack([np.eye(problem.n)] * problem.n_nodes))

    try:
        assert 60 < values(execute(run("trick-memory")))["peak_memory"] < 80
    finally:
        methods._REGISTRY.pop("trick-memory")


def test_a_run_has_one_thread():
    assert isolated(run("trick-threads"))["status"] == "ok"


def test_seconds_and_cpu_seconds_are_those_of_the_method_alone(tmp_path):
    """A loop of .3 seconds on one core; neither the making of the problem nor the measuring counts."""
    options = {"log": str(tmp_path / "log"), "seconds": 0.3}
    found = values(execute(run("trick-count", options)))
    assert found["seconds"] >= 0.3
    assert 0 < found["cpu_seconds"] <= found["seconds"] + 0.05  # the clock of the processor may tick in 10 ms


def test_ess_per_second_by_hand(monkeypatch):
    """The least ESS over the seconds that the call of the sampler took, on a clock of our own."""
    clock, made = iter([100.0, 102.5]), []
    monkeypatch.setattr(methods.time, "perf_counter", lambda: next(clock, 102.5))
    sample = methods.samplers.sample

    def kept(*arguments, **options):
        made.append(sample(*arguments, **options))
        return made[-1]

    monkeypatch.setattr(methods.samplers, "sample", kept)
    p = data_gen.perturb(data_gen.planted(4, 3, rng=0), 0.05, 1)
    answer = methods.sampled(p, "heat-bath", rng=np.random.default_rng(2), n_chains=2, n_draws=60, warmup=20, kappa=5.0)
    least = min(diagnostics.ess(values) for values in diagnostics.scalars(made[0]).values())
    assert answer.numbers()["ess_per_second"] == pytest.approx(least / 2.5)


def test_a_failure_keeps_its_traceback():
    record = execute(run("trick-raise"))
    assert record["status"] == "error"
    assert "RuntimeError: the trick failed" in record["traceback"]
    assert "in fail" in record["traceback"]
    assert record["metrics"] == []


def test_metrics_of_an_answer_worked_out_by_hand(planted):
    problem = planted(n_nodes=4, n=4)
    shifted = methods.Answer(lambda pairs: problem.relative(pairs) + np.eye(4) * 0.5)
    found = {name: value for name, at, value in measure(problem, shifted)}
    assert found["edge_error"] == pytest.approx(1.0)  # ||I / 2||_F
    assert found["pair_rms"] == pytest.approx(1.0)
    assert found["cycle_error"] > 0.1


def test_edges_alone_when_an_answer_knows_no_other_pair(planted):
    full = planted(n_nodes=5, n=4)
    keep = np.array([0, 1, 2, 3, 4, 5])
    from fmsync.problem import SyncProblem

    sparse = Planted(SyncProblem(5, full.problem.edges[keep], full.problem.maps[keep]), full.truth)
    answer = methods.get("observed").run(sparse, np.random.default_rng(0), {})
    found = {name: value for name, at, value in measure(sparse, answer)}
    assert "pair_error" not in found
    expected = frobenius_errors(sparse.problem.maps, sparse.relative(sparse.problem.edges)).mean()
    assert found["edge_error"] == pytest.approx(expected)


def test_large_problems_show_a_fixed_sample_of_pairs():
    truth = np.broadcast_to(np.eye(2), (200, 2, 2))
    from fmsync.problem import SyncProblem

    edges = np.array([(0, k) for k in range(1, 200)])
    problem = Planted(SyncProblem(200, edges, np.broadcast_to(np.eye(2), (199, 2, 2))), truth)
    pairs = problem.pairs()
    assert len(pairs) == 2000
    assert (pairs[:, 0] < pairs[:, 1]).all()
    assert len(np.unique(pairs, axis=0)) == 2000
    np.testing.assert_array_equal(pairs, problem.pairs())
    assert pairs[:, 0].max() > 100


def test_replicas_show_how_much_an_answer_varies():
    """Another chain on the same problem; another rounding of the observations for a method that is no chain."""
    chain = run("heat-bath", {"n_chains": 1, "n_draws": 30, "warmup": 5})
    for one, low, high in ((chain, 1e-4, 1.0), (run("mle"), 1e-16, 1e-11)):
        first, again, same, other = (values(execute(one, replica=k)) for k in (0, 1, 1, 2))
        assert again["edge_error"] == same["edge_error"]
        assert again["floor_rms"] == first["floor_rms"]
        for a, b in ((first, again), (first, other), (again, other)):
            assert low < abs(a["edge_error"] - b["edge_error"]) < high


def test_a_replica_rounds_the_bases_of_shapes_too(planted):
    made = planted(n_nodes=3, n=2)
    bases = (Basis([0.0, 2.0], [[1.0, 1.0], [1.0, -1.0]], [0.5, 0.5]),) * 3
    replica, _ = executing._replicated(replace(made, bases=bases), 0, "estimator", 1)
    assert 0 < np.abs(replica.problem.maps - made.problem.maps).max() < 1e-12
    for before, after in zip(bases, replica.bases):
        assert 0 < np.abs(after.eigenfunctions - before.eigenfunctions).max() < 1e-12
