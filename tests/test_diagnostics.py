import numpy as np
import pytest

import data_gen
import fmsync
from fmsync import diagnostics, so


def autoregressive(rho, n_chains=4, n_draws=4000, rng=0):
    noise = np.random.default_rng(rng).standard_normal((n_chains, n_draws))
    x = noise.copy()
    for t in range(1, n_draws):
        x[:, t] = rho * x[:, t - 1] + np.sqrt(1 - rho**2) * noise[:, t]
    return x


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_ess_of_an_autoregressive_chain(rho):
    """Known: draws times (1 - ρ) / (1 + ρ) for the mean."""
    expected = 16_000 * (1 - rho) / (1 + rho)
    assert abs(diagnostics.ess(autoregressive(rho)) / expected - 1) < 0.15
    assert diagnostics.ess(autoregressive(rho), "tail") > 0.5 * expected


def test_rhat_sees_a_chain_that_sits_elsewhere():
    x = autoregressive(0.5)
    assert diagnostics.rhat(x) < 1.005
    x[0] += 1.0
    assert diagnostics.rhat(x) > 1.05


def test_what_cannot_be_judged_is_nan():
    assert np.isnan(diagnostics.rhat(np.ones((2, 10))))
    assert np.isnan(diagnostics.ess(np.zeros((2, 3))))


def test_bad_values_are_named():
    with pytest.raises(ValueError, match=r"\(chains, draws\)"):
        diagnostics.rhat(np.zeros(5))
    with pytest.raises(ValueError, match=r"values: entry \[1, 2\] is not finite"):
        diagnostics.ess(np.array([[1.0, 2, 3, 4], [1, 2, np.nan, 4]]))
    with pytest.raises(ValueError, match="kind"):
        diagnostics.ess(np.zeros((2, 9)), "middle")


@pytest.mark.filterwarnings("ignore::fmsync.diagnostics.ConvergenceWarning")
def test_summary_does_not_depend_on_the_gauge():
    p = data_gen.perturb(data_gen.planted(6, 3, rng=0), 0.1, 1)
    post = fmsync.sample(p, n_chains=2, n_draws=50, warmup=50, rng=0)
    turns = so.random_uniform(3, (2, 50, 1), rng=1)  # every draw by another one
    turned = fmsync.Posterior(p, "rlfm", turns @ post.absolute, post.energy, post.kappa, False, {})
    table = diagnostics.summary(post)
    for name, values in diagnostics.scalars(turned).items():
        np.testing.assert_allclose(values, diagnostics.scalars(post)[name], atol=1e-12)
    assert len(table) == 21  # the energy and two numbers for ten of 15 pairs
    assert len(diagnostics.summary(post, [[0, 1]])) == 3
    relative = post.relative([[0, 1]])[:, :, 0]
    assert table["tr C[0,1]"]["mean"] == pytest.approx(np.trace(relative.mean((0, 1))))
    assert table["C[0,1][0,0]"]["sd"] == pytest.approx(relative[..., 0, 0].std())


def test_chains_that_disagree_are_warned_of_with_advice():
    p = data_gen.perturb(data_gen.planted(6, 3, rng=0), 0.1, 1)
    with pytest.warns(diagnostics.ConvergenceWarning, match=r"R-hat of energy is .* lengthen warmup"):
        fmsync.sample(p, n_chains=4, n_draws=100, warmup=0, init="dispersed", step=1e-4)
    with pytest.warns(diagnostics.ConvergenceWarning, match="effective draws of energy .* raise n_draws"):
        fmsync.sample(p, "heat-bath", kappa=5.0, n_draws=50)


def test_summaries_warn_of_what_the_energy_does_not_show():
    p = fmsync.SyncProblem(2, [[0, 1]], np.eye(3)[None])
    post = fmsync.sample(p, "heat-bath", kappa=5.0, n_draws=500)
    turned = post.absolute.copy()
    turned[0, :, 1] = turned[0, :, 1] @ np.diag([-1.0, -1.0, 1.0])  # one chain sits elsewhere
    moved = fmsync.Posterior(p, "heat-bath", turned, post.energy, post.kappa, False, {})
    with pytest.warns(diagnostics.ConvergenceWarning, match=r"R-hat of .*C\[0,1\]"):
        moved.summary()


@pytest.mark.filterwarnings("error::fmsync.diagnostics.ConvergenceWarning")
def test_good_chains_are_not_warned_of():
    p = data_gen.perturb(data_gen.planted(6, 3, rng=0), 0.1, 1)
    post = fmsync.sample(p, "heat-bath", n_draws=1000, init="dispersed", warmup=300)
    assert "log kappa" in post.summary()


def test_a_summary_reads_as_a_table():
    names, two = ("energy", "tr C[<0>,1]"), np.array([1.0, 2.0])
    table = diagnostics.Summary(names, 100 * two, 0.03 * two, 1 + 0.001 * two, two * 400.4, np.array([np.nan, 7]))
    lines = str(table).splitlines()
    assert [len(line) for line in lines] == [len(lines[0])] * 3
    assert lines[0].split() == ["mean", "sd", "r_hat", "ess_bulk", "ess_tail"]
    assert lines[1].split() == ["energy", "100.000", "0.030", "1.001", "400", "nan"]
    assert repr(table) == str(table)
    page = table._repr_html_()
    assert page.count("<tr>") == 3
    assert "<th>tr C[&lt;0&gt;,1]</th><td>200.000</td><td>0.060</td>" in page
    assert table[names[1]] == {"mean": 200, "sd": 0.06, "r_hat": 1.002, "ess_bulk": 800.8, "ess_tail": 7}
    assert "energy" in table
    assert "log kappa" not in table
    assert table.head(1).names == ("energy",)
    assert len(table.head(9)) == 2
    with pytest.raises(KeyError, match="entropy: no scalar has this name; there are energy, tr"):
        table["entropy"]
