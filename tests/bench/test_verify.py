"""Whether a table can be trusted: runs repeated, by the rule that fits, and false rows that have to be found."""

from functools import partial
from operator import mul

import numpy as np
import pandas as pd
import pytest

from bench import methods, results
from bench import verify as verifier
from bench.__main__ import main
from bench.metrics import METRICS
from bench.runner import execute
from bench.suites import Run
from fmsync import estimators

PROBLEM = {"n_nodes": 5, "n": 4, "sigma2": 0.1}
NOISY = {"n_nodes": 5, "n": 12, "sigma2": 0.4}
CHAIN = {"n_chains": 1, "n_draws": 150, "warmup": 50}
TOGETHER = "heat-bath: runs together"
ANSWERS = ("edge_error", "edge_rms", "pair_error", "pair_rms", "cycle_error")


def run(method, seed, problem=PROBLEM, **options):
    return Run("bench.problems:rotations", problem, seed, method, method, options)


def table(runs, **how):
    return results.to_frame("s", [repeat(c, **how) for c in runs])


@pytest.fixture(scope="module")
def frame():
    runs = [run("mle", seed) for seed in range(3)]
    runs += [run("heat-bath", seed, n_chains=1, n_draws=100, warmup=20) for seed in range(3)]
    return table(runs)


@pytest.fixture(scope="module")
def chains():
    """Rows of three chains that took another path than the runs here will: they drew other random numbers."""
    return elsewhere(table([run("heat-bath", seed, NOISY, **CHAIN) for seed in range(3)], replica=99))


_RUNS = {}


def repeat(again, **how):
    """Many tests need the same runs."""
    key = again.key, *how.values()
    if key not in _RUNS:
        _RUNS[key] = execute(again, **how)
    return _RUNS[key]


def verify(*given, **how):
    return verifier.verify(*given, **{"execute": repeat, "n_replicas": 12} | how)


def elsewhere(frame):
    return frame.assign(machine="Z80, 1 cores, CP/M")


def changed(frame, metrics, change, label=None):
    """The table with other values of some metrics."""
    chosen = frame.metric.isin(metrics) & (True if label is None else frame.label == label)
    return frame.assign(value=frame.value.where(~chosen, change(frame.value)))


def swapped(frame, method, metrics):
    """The table with the values that another method has on the same problems."""
    runs = [run(method, int(seed), NOISY) for seed in frame.seed.unique()]
    others = table(runs).dropna(subset="metric").set_index(["seed", "metric"]).value
    keys = pd.MultiIndex.from_frame(frame[["seed", "metric"]])
    values = others.groupby(level=[0, 1]).first().reindex(keys).to_numpy()
    return frame.assign(value=np.where(frame.metric.isin(metrics), values, frame.value))


def of(found, metric):
    return {one.run.partition(" ")[0]: one.verdict for one in found if one.metric == metric}


def doubted(found):
    return {one.run for one in found if not one.agrees}


def test_the_same_arithmetic_gives_the_same_bits(frame):
    found = list(verify(frame, 6, rng=0, execute=execute))
    assert len({one.run for one in found}) == 6
    assert {(one.rule, one.verdict, one.reason) for one in found} == {("bits", "equal", "")}
    compared = {one.metric for one in found}
    assert {"edge_error", "cycle_error", "energy_score", "coverage_90", "accuracy_at_draws"} <= compared
    assert not compared & {"seconds", "cpu_seconds", "peak_memory", "ess_per_second"}


def test_one_bit_is_found_where_bits_are_demanded_and_there_alone(frame):
    moved = changed(frame, ["edge_error"], lambda v: np.nextafter(v, 9.0))
    here, there = list(verify(moved, 6, rng=0)), list(verify(elsewhere(moved), 6, rng=0))
    assert of(here, "edge_error") == {"mle": "differs", "heat-bath": "differs"}
    assert of(here, "edge_rms") == {"mle": "equal", "heat-bath": "equal"}
    assert {one.rule for one in here} == {"bits"}
    assert of(there, "edge_error") == {"mle": "agrees", "heat-bath": "agrees"}
    assert {(one.rule, one.reason) for one in there} == {("tolerance", "made on another processor: Z80")}


@pytest.mark.parametrize(
    ("column", "value", "reason"),
    [
        ("machine", "Z80, 1 cores, CP/M", "another processor"),
        ("versions", "numpy 1.0", "other versions"),
        ("arithmetic", "Nehalem-0", "other arithmetic: Nehalem-0"),
        ("code", "0", "other code"),
        ("arithmetic", None, "does not say"),
    ],
)
def test_when_bits_are_not_demanded(frame, column, value, reason):
    (other,) = {one.reason for one in verify(frame.assign(**{column: value}), 2, rng=0)}
    assert reason in other
    older = frame.drop(columns=["arithmetic", "code"])
    assert all(one.rule == "tolerance" and one.verdict == "equal" for one in verify(older, 2, rng=0))


@pytest.mark.parametrize("name", sorted(set(ANSWERS) - {"cycle_error"}))
def test_other_processors_have_the_tolerance_of_the_metric(frame, name, monkeypatch):
    mine = elsewhere(frame[frame.label == "mle"])
    within, without = (changed(mine, [name], partial(mul, factor)) for factor in (1 + 0.9e-6, 1 + 1.1e-6))
    assert of(verify(within, 3, rng=0), name) == {"mle": "agrees"}
    found = list(verify(without, 3, rng=0))
    assert {one.metric for one in found if not one.agrees} == {name}
    monkeypatch.setitem(METRICS, name, METRICS[name].__class__(name, "Frobenius", "lower", tolerance=2e-6))
    assert of(verify(without, 3, rng=0), name) == {"mle": "agrees"}


def test_every_metric_but_time_memory_and_batch_size_has_a_tolerance():
    without = {name for name, metric in METRICS.items() if metric.tolerance is None}
    assert without == {"seconds", "cpu_seconds", "peak_memory", "ess_per_second", "at_once"}
    assert {metric.tolerance for name, metric in METRICS.items() if name not in without} == {1e-6}


def test_a_zero_may_be_rounded(frame):
    moved = changed(elsewhere(frame), ["cycle_error"], lambda v: v + 5e-10, label="mle")
    assert of(verify(moved[moved.label == "mle"], 3, rng=0), "cycle_error") == {"mle": "agrees"}


@pytest.mark.parametrize("how", ["point", "missing"])
def test_curves_are_compared_point_by_point(how):
    """The mean of a curve says less than its points; a curve of other points is another one."""
    mine = elsewhere(table([run("convergence", 0, init="random")]))
    steps = mine.metric == "error_at_step"
    assert steps.sum() > 4
    assert {one.verdict for one in verify(mine, 1, rng=0)} == {"equal"}
    if how == "missing":
        moved = mine[~(steps & (mine["at"] == 2))]
    else:
        shift = np.where(steps, (mine["at"] == 2) * 1e-3 - (mine["at"] == 3) * 1e-3, 0.0)
        moved = mine.assign(value=mine.value + shift)
    found = [one for one in verify(moved, 1, rng=0, n_replicas=3) if not one.agrees]
    assert [(one.metric, one.verdict) for one in found] == [("error_at_step", "differs")]


def test_a_chain_that_took_another_path_agrees(chains):
    found = list(verify(chains, 3, rng=0))
    assert doubted(found) == set()
    compared = {one.metric: one.rule for one in found if one.run != TOGETHER}
    assert compared["edge_error"] == compared["energy_score"] == compared["accuracy_at_draws"] == "Monte Carlo"
    assert compared["floor_rms"] == "tolerance"
    together = [one for one in found if one.run == TOGETHER]
    assert {"edge_error", "coverage_90"} <= {one.metric for one in together}
    assert {one.rule for one in together} == {"Monte Carlo together"}


def test_the_answers_of_another_method_are_found_in_every_run(chains):
    """The maximum of the likelihood in the place of the mean of the posterior: its cycles close."""
    found = list(verify(swapped(chains, "mle", ANSWERS), 3, rng=0))
    assert len(doubted(found) - {TOGETHER}) == 3


@pytest.mark.parametrize("method", ["mle", "spectral"])
def test_errors_of_another_method_are_found_among_all_runs(chains, method):
    """The errors alone, which differ from those of the chains by far less than between problems."""
    table = swapped(chains, method, ["edge_error"])
    found = [one for one in verify(table, 3, rng=0) if one.metric == "edge_error"]
    assert found[-1].run == TOGETHER
    assert not found[-1].agrees
    between_seeds = chains[chains.metric == "edge_error"].value.std()
    assert all(abs(one.before - one.now) < 0.02 * one.before + 3 * between_seeds for one in found)


def test_another_sampler_is_found_in_every_run(chains):
    """All metrics of a chain with another concentration, which the rows do not tell."""
    other = elsewhere(table([run("heat-bath", seed, NOISY, **CHAIN, kappa=30.0) for seed in range(3)]))
    other = other.assign(options=chains.options.iloc[0])
    assert len(doubted(verify(other, 3, rng=0)) - {TOGETHER}) == 3


@pytest.fixture
def two_minima(monkeypatch):
    """A method whose answer the last bits of the data choose among two."""

    def function(problem, *, rng):
        low = np.modf(problem.maps.sum() * 2.0**45)[0] % 1 < 0.4
        return methods.Answer(estimators.solve(problem, "spectral" if low else "mle", rng=rng).relative)

    monkeypatch.setitem(methods._REGISTRY, "two-minima", methods.Method("two-minima", function))


def test_another_minimum_is_told_from_a_false_value(two_minima):
    """Repetitions with other last digits find both; a value that lies far from both stays false."""
    ends = [elsewhere(table([run("two-minima", 0)], replica=k)) for k in range(10)]
    ends = list({round(one[one.metric == "edge_error"].value.item(), 6): one for one in ends}.values())
    assert len(ends) == 2
    rules = []
    for one in ends:
        found = list(verify(one, 1, rng=0))
        assert doubted(found) == set()
        rules += [each.rule for each in found if each.metric == "edge_error"]
    assert sorted(rules) == ["rounding", "tolerance"]
    gap = abs(np.subtract(*[one[one.metric == "edge_error"].value.item() for one in ends]))
    found = list(verify(changed(ends[0], ["edge_error"], lambda v: v + 5 * gap), 1, rng=0))
    assert of(found, "edge_error") == {"two-minima": "differs"}


def test_a_method_that_keeps_its_digits_gets_no_wider_interval(frame):
    mine = changed(elsewhere(frame[frame.label == "mle"]), ["edge_error"], lambda v: v * (1 + 1e-5))
    found = [one for one in verify(mine, 1, rng=0) if one.metric == "edge_error"]
    assert [(one.rule, one.verdict) for one in found] == [("rounding", "differs")]
    assert found[0].interval < 1e-5 * found[0].before


def test_a_share_of_few_edges_is_not_certain_after_equal_runs():
    metric = METRICS["coverage_90"]
    alike = verifier._deviation(np.ones(17), metric)
    assert alike == pytest.approx(np.sqrt((17 * (0.5 / 18) ** 2 + 0.5 * (17.5 / 18) ** 2 + 0.5 * (0.5 / 18) ** 2) / 17))
    seen = verifier.Repeated(metric.name, 0.5, [1.0] * 17)
    assert 0.5 < seen.interval < 1.0
    assert verifier._deviation(np.array([1.0, 2.0, 3.0]), METRICS["edge_error"]) == 1.0


def test_how_often_right_chains_are_doubted():
    """Normal metrics, 17 runs: intervals are left as rarely as four standard deviations."""
    draws = np.random.default_rng(0).standard_normal((4000, 18))
    repeated = [verifier.Repeated("edge_error", one[0], one[1:]) for one in draws]
    assert sum(one.excess > 0 for one in repeated) <= 4  # 0.25 expected
    groups = [verifier.together("a", "edge_error", repeated[k : k + 4]) for k in range(0, 4000, 4)]
    assert sum(not one.agrees for one in groups) <= 3  # 0.06 expected of a normal sum


def test_a_metric_that_a_seed_does_not_have_is_left_out(frame):
    without = frame[~((frame.metric == "cycle_error") & (frame.seed == 1) & (frame.label == "mle"))]
    found = list(verify(without, 6, rng=0))
    assert {one.verdict for one in found} == {"equal"}
    told = {one.run for one in found if one.metric == "cycle_error"}
    assert len({one.run for one in found}) - len(told) == 1


def test_a_metric_that_is_missing_here_differs(frame):
    more = frame[frame.metric == "edge_error"].assign(metric="expected_rms")
    found = list(verify(pd.concat([frame[frame.metric != "expected_rms"], more]), 6, rng=0, n_replicas=3))
    assert set(of(found, "expected_rms").values()) == {"differs"}
    more = frame[frame.metric == "edge_error"].assign(metric="point_error")
    for rows in (frame, elsewhere(frame)):
        found = list(verify(pd.concat([rows, more.assign(machine=rows.machine)]), 6, rng=0, n_replicas=3))
        assert set(of(found, "point_error").values()) == {"differs"}


def test_a_run_that_fails_now_is_told(frame):
    def failing(again):
        return {**execute(again), "status": "timeout"}

    (found,) = verify(frame, 1, rng=0, execute=failing)
    assert found.verdict == "timeout"
    assert not found.agrees


def test_runs_without_their_data_are_left_out(frame, monkeypatch):
    monkeypatch.delenv("FMSYNC_DATA", raising=False)
    absent = frame.assign(problem='{"collection": "not-here"}', label="mle on shapes")
    assert {one.run.split()[0] for one in verify(pd.concat([frame, absent]), 9, rng=0)} == {
        "mle",
        "heat-bath",
    }


def test_bad_counts(frame):
    with pytest.raises(ValueError, match="7 of a table of 6"):
        list(verify(frame, 7, rng=0))
    with pytest.raises(ValueError, match="n_replicas"):
        list(verify(frame, 1, rng=0, n_replicas=2))


def test_command(frame, tmp_path, capsys):
    results.write(frame, tmp_path / "mine.parquet")
    assert main(["verify", "--runs", "3", "--results", str(tmp_path)]) == 0
    told = capsys.readouterr().out
    assert "all agree; compared: " in told
    assert "by bits" in told
    results.write(changed(elsewhere(frame), ["edge_error"], lambda v: v + 1, "mle"), tmp_path / "mine.parquet")
    arguments = ["verify", "mine", "--runs", "6", "--replicas", "4", "--results", str(tmp_path)]
    assert main(arguments) == 1
    told = capsys.readouterr().out
    assert "differs (rounding): edge_error" in told
    assert "rows made on another processor: Z80; bits need not be equal" in told
    assert "by tolerance (" in told
    assert main(["verify", "--results", str(tmp_path / "nowhere")]) == 2
    assert "--results" in capsys.readouterr().err
