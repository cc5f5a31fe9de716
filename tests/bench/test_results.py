"""Tables: tidy rows, intervals, comparisons, and Table 1 beside the paper's."""

import numpy as np
import pandas as pd
import pytest

from bench import figures, report, results


def record(
    label="mle", seed=0, status="ok", problem=None, metrics=(("edge_error", None, 1.0), ("cpu_seconds", None, 0.1))
):
    return {
        "generator": "g:f",
        "problem": problem or {"n_nodes": 4, "n": 20, "sigma2": 0.2},
        "seed": seed,
        "label": label,
        "method": label,
        "options": {"a": 1},
        "status": status,
        "metrics": [list(row) for row in metrics] if status == "ok" else [],
        "traceback": "" if status == "ok" else "Traceback\nValueError: no",
        "commit": "abc",
        "machine": "m",
        "versions": "v",
    }


def errors_of(error):
    return ("edge_error", None, error), ("edge_rms", None, error)


def frame(errors, label="mle", suite="s", **problem):
    kind = {"n_nodes": 4, "n": 20, "sigma2": 0.2, **problem}
    rows = [
        record(label, seed, problem=kind, metrics=(*errors_of(error), ("cpu_seconds", None, 0.1)))
        for seed, error in enumerate(errors)
    ]
    return results.to_frame(suite, rows)


def test_tidy_rows_survive_the_disk(tmp_path):
    before = results.to_frame(
        "s",
        [record(metrics=(("edge_error", None, 0.5), ("error_at_step", 3.0, 0.25))), record(seed=1, status="timeout")],
    )
    results.write(before, tmp_path / "deep" / "s.parquet")
    after = results.read(tmp_path / "deep" / "s.parquet")
    assert after.metric.tolist()[:2] == ["edge_error", "error_at_step"]
    assert after["at"].tolist()[1] == 3.0
    assert after.unit.tolist()[:2] == ["Frobenius"] * 2
    assert after.direction.tolist()[:2] == ["lower"] * 2
    assert after.status.tolist() == ["ok", "ok", "timeout"]
    assert after.detail.tolist()[2] == "ValueError: no"
    assert np.isnan(after.value.iloc[2])
    assert not list(tmp_path.rglob("*.part"))


def test_missing_results_say_how_to_make_them(tmp_path):
    with pytest.raises(ValueError, match="python -m bench run paper"):
        results.read(tmp_path / "paper.parquet")


def test_bootstrap_covers_the_mean_about_as_often_as_it_says():
    rng = np.random.default_rng(0)
    hits = [low <= 0 <= high for low, high in (results.bootstrap(rng.standard_normal(30)) for _ in range(400))]
    assert 0.89 < np.mean(hits) < 0.98


def test_bootstrap_of_one_seed_claims_nothing():
    assert np.isnan(results.bootstrap([1.0])).all()


def test_a_planted_regression_is_found_and_noise_is_not():
    rng = np.random.default_rng(1)
    errors = 2 + 0.3 * rng.standard_normal(20)
    before = pd.concat([frame(errors), frame(errors, "spectral")])
    after = pd.concat([frame(errors * 1.03), frame(errors + 1e-4 * rng.standard_normal(20), "spectral")])
    found = results.compare(before, after)
    assert sorted(found[["label", "metric", "verdict"]].to_numpy().tolist()) == [
        ["mle", "edge_error", "worse"],
        ["mle", "edge_rms", "worse"],
    ]
    assert found.change.iloc[0] == pytest.approx(0.03)
    assert results.compare(after, before).verdict.tolist() == ["better"] * 2
    assert results.compare(before, before).empty


def test_new_failures_are_regressions():
    before, after = (results.to_frame("s", [record(status=status)]) for status in ("ok", "timeout"))
    assert results.compare(before, after).verdict.tolist() == ["ok -> timeout"]


def test_the_paper_s_cells():
    table = report.paper_table().set_index(["label", "density", "sigma2"]).paper
    assert len(table) == 75
    assert table["MLE (2)", 1.0, 0.6] == 3.67
    assert table["MC (2) geodesic", 0.667, 1.0] == 5.01
    assert table["MLE (1)", 0.833, 0.4] == 3.19
    assert table["MC (1)", 0.667, 0.2] == 2.43


@pytest.fixture(scope="module")
def paper(tmp_path_factory):
    """Through the disk, as the commands read it; some problems name what others leave to the default."""
    parts = []
    for label in ("MLE (1)", "MLE (2)", "spectral"):
        for sigma2 in (0.2, 1.0):
            errors = {0.2: [2.0, 2.1, 2.2], 1.0: [5.0, 5.1, 5.2]}[sigma2]
            parts.append(frame(errors, label, "paper", sigma2=sigma2, density=1.0, two_way=False))
    extra = {"n_nodes": 4, "n": 20, "sigma2": 0.2}
    steps = tuple(("error_at_step", float(k), 5.0 / (k + 1)) for k in range(5))
    draws = tuple(("accuracy_at_draws", float(k), 0.2 + 0.01 * k) for k in range(1, 5))
    lines = (("floor_rms", None, 1.9), ("expected_rms", None, 2.0))
    level = {**extra, "density": 1.0, "two_way": False}
    parts.append(
        results.to_frame(
            "paper",
            [
                record("way of MLE (1)", problem=extra, metrics=steps),
                record("way of MLE (2)", problem=extra, metrics=steps),
                record("MC (2)", problem=level, metrics=draws),
                record("haar-baseline", problem=extra, metrics=draws),
                record("observed", problem=level, metrics=(("edge_error", None, 4.8), *lines)),
                record("observed", problem={**level, "sigma2": 1.0}, metrics=(("edge_error", None, 5.7), *lines)),
            ],
        )
    )
    parts.append(frame([4.0, 4.2], "MLE (2)", "paper", density=1.0, two_way=False, around="measured"))
    path = tmp_path_factory.mktemp("paper") / "paper.parquet"
    results.write(pd.concat(parts, ignore_index=True), path)
    return results.read(path)


def test_table1_puts_ours_beside_the_paper_s(paper):
    table = report.table1(paper, n_nodes=4)
    row = table[(table.label == "MLE (2)") & (table.sigma2 == 0.2)].iloc[0]
    assert row["mean"] == pytest.approx(2.1)
    assert row.paper == 2.08
    assert row.agrees
    assert row.floor == 1.9
    assert row.bound_valid  # 1.9² is less than a tenth of 2n = 40
    assert row.seeds == 3
    far = table[(table.label == "MLE (1)") & (table.sigma2 == 1.0)].iloc[0]
    assert not far.agrees
    assert not far.recoverable
    assert table[table.label == "spectral"].paper.isna().all()


def test_variants_that_were_not_run_are_refused(paper):
    variant = {"n_nodes": 4, "two_way": False}
    assert report.protocol_variants(paper) == [{**variant, "around": "consistent"}, {**variant, "around": "measured"}]
    with pytest.raises(ValueError, match="python -m bench run paper"):
        report.table1(paper, n_nodes=11)


def test_report_text(paper):
    text = report.report(paper)
    assert "2.10 [2.00, 2.20] / 2.08*" in text
    assert "2.08'" in text  # beyond the recovery threshold of this density
    assert "abc" in text
    failed = report.report(results.to_frame("s", [record(), record(seed=1, status="memory")]))
    assert "memory: mle" in failed


def test_scoreboard_ranks_and_counts_failures():
    rows = pd.concat(
        [frame([1.0, 2.0], "good"), frame([3.0, 4.0], "bad"), results.to_frame("s", [record("none", status="error")])]
    )
    board = report.scoreboard(rows)
    assert board.label.tolist() == ["good", "bad", "none"]
    assert board.error.tolist()[:2] == [1.5, 3.5]
    assert board.failed.tolist() == [0, 0, 1]
    assert report.bracketed(board).isna().all()  # nothing is known of the bound
    bounds = report.bracketed(board.assign(floor=[1.0, 3.0, np.nan], bound_valid=[True, False, False]))
    assert bounds.tolist()[:2] == ["1.00", "(3.00)"]
    drawn = figures.error_against_seconds(board).axes[0]
    np.testing.assert_allclose(drawn.lines[0].get_data(), [[0.1, 0.1], [2.5**0.5, 12.5**0.5]])  # roots of mean squares
    heights = {text.get_text(): text.get_position()[1] for text in drawn.texts}
    assert list(heights) == ["good", "bad"]  # who failed has no place
    assert 0 <= heights["good"] < heights["bad"] <= 1


def test_names_beside_a_figure_stay_apart_and_in_order():
    board = report.scoreboard(pd.concat([frame([1.0 + 1e-3 * k], f"m{k}") for k in range(12)]))
    texts = figures.error_against_seconds(board).axes[0].texts
    heights = np.array([text.get_position()[1] for text in texts])
    assert len(heights) == 12
    assert (np.diff(heights) > 0.05).all()
    assert heights.min() >= 0
    assert heights.max() <= 1


def test_figures_show_the_tables(paper):
    figure = figures.table1({"one": report.table1(paper, n_nodes=4)})
    mle = next(axis for axis in figure.axes if axis.get_title() == "MLE (2)")
    drawn = {line.get_label(): line.get_ydata() for line in mle.lines}
    np.testing.assert_allclose(drawn["the paper"], [2.08, 4.82])
    assert list(mle.containers[0].lines[0].get_ydata()) == pytest.approx([2.1, 5.1])
    for drawn in (figures.density({"one": report.table1(paper)}), figures.convergence(paper), figures.oracle(paper)):
        assert any(len(axis.lines) for axis in drawn.axes)


@pytest.mark.parametrize("name", ["robust.parquet", "calibration_coverage.csv", "speed.json"])
def test_committed_results_are_read_by_their_names(name):
    assert len(results.committed(name)) > 0
