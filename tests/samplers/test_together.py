"""Chains of several problems as one batch against the same chains alone."""

import numpy as np
import pytest

import data_gen
import fmsync
from fmsync.samplers.together import sample_together


def problems(n_nodes, density, two_way=False):
    made = []
    for seed in range(3):  # other graphs, other maps
        edges = data_gen.random_graph(n_nodes, density, seed)
        made.append(data_gen.perturb(data_gen.planted(n_nodes, 5, edges, rng=seed), 0.2, seed + 1, two_way=two_way))
    return made


@pytest.mark.parametrize(
    ("n_nodes", "density", "two_way", "options"),
    [
        (4, 1.0, False, {}),
        (4, 0.667, False, {}),  # graphs with other largest degrees, so with other steps
        (4, 1.0, True, {"constrained": False}),
        (4, 0.833, False, {"energy": "geodesic", "init": "random"}),
        (12, 0.2, False, {"retraction": "qf", "kappa": 5.0}),  # too sparse for dense products
    ],
)
def test_every_chain_is_the_one_it_would_be_alone(n_nodes, density, two_way, options):
    different = problems(n_nodes, density, two_way)
    run = {"n_draws": 30, "warmup": 120, "thin": 2, **options}  # long enough for a repair of orthogonality
    together = sample_together(different, rngs=[10, 11, 12], **run)
    for k, (problem, post) in enumerate(zip(different, together)):
        with pytest.warns(fmsync.diagnostics.ConvergenceWarning):
            alone = fmsync.sample(problem, "rlfm", n_chains=1, rng=10 + k, **run)
        np.testing.assert_array_equal(post.absolute, alone.absolute)
        np.testing.assert_array_equal(post.energy, alone.energy)
        assert post.settings == alone.settings
        assert post.problem is problem


def test_what_cannot_be_one_batch_is_refused():
    few, more = problems(4, 1.0), problems(5, 1.0)
    with pytest.raises(ValueError, match=r"sizes \(n_nodes, n\) \[\(4, 5\), \(5, 5\)\]"):
        sample_together([few[0], more[0]], rngs=[0, 1])
    with pytest.raises(ValueError, match="2 problems .* and 1 generators"):
        sample_together(few[:2], rngs=[0])
    with pytest.raises(ValueError, match="n_draws: an integer >= 1, got 0"):
        sample_together(few, rngs=[0, 1, 2], n_draws=0)
    with pytest.raises(ValueError, match="n_chains: 'rlfm' has no such option"):
        sample_together(few, rngs=[0, 1, 2], n_chains=2)


def test_a_chain_that_diverges_is_named():
    with pytest.raises(RuntimeError, match="chain 0 diverged"):
        sample_together(problems(4, 1.0), rngs=[0, 1, 2], constrained=False, step=3.0, n_draws=400)
