"""What a reader explores is what the synchronised shapes say of the same vertices."""

from dataclasses import replace

import numpy as np
import pytest

import fmsync
from fmsync import diagnostics, so
from fmsync.matching import explored, synchronize_matches
from fmsync.matching.conformal import default_calibration
from tests.matching.conftest import OPTIONS


@pytest.fixture
def asked(monkeypatch):
    """Explores, and gives what would be drawn: shapes, vertices to choose from, states, and options."""
    monkeypatch.setattr(explored, "explorer", lambda *given, **options: (*given, options))
    return lambda worlds, pair, **more: explored.explore(worlds, pair, default_calibration(), alt="Cats.", **more)


def test_the_last_stages_alone_give_the_same_maps(synced):
    again = synchronize_matches(synced.shapes, synced.edges, synced.matches, 12, OPTIONS["n_refined"], 0, 0)
    np.testing.assert_allclose(again.refined, synced.refined, atol=1e-10)
    np.testing.assert_allclose(again.problem.maps, synced.problem.maps, atol=1e-12)
    assert again.posterior is None


def test_every_view_agrees_with_the_synchronised_shapes(synced, asked):
    noisy = [replace(m, c_ij=so.project(m.c_ij[:12, :12] + 0.2)) for m in synced.matches]
    with diagnostics.short_run():
        other = synchronize_matches(synced.shapes, synced.edges, noisy, 12, 30, 100, 0)
        hot = replace(synced, posterior=fmsync.sample(synced.problem, "heat-bath", beta=1.0, n_draws=50, warmup=20))
    worlds = {(0.0, "β = 1"): hot, (0.0, "κ inferred"): synced, (0.1, "κ inferred"): other}
    shapes, choice, states, options = asked(worlds, (2, 1), common_order=True, vertex=int(synced.shapes[2].samples[7]))
    assert options["vertex"] == 7
    assert [s.name for s in shapes] == [synced.names[2], synced.names[1]]
    np.testing.assert_array_equal(choice[0], synced.shapes[2].samples[:160])
    assert options["truth"] is choice
    assert [(s.view, s.noise, s.temperature) for s in states] == [
        ("observed", 0.0, ""),
        ("observed", 0.1, ""),
        ("synchronised", 0.0, ""),
        ("synchronised", 0.1, ""),
        ("posterior", 0.0, "β = 1"),
        ("posterior", 0.0, "κ inferred"),
        ("posterior", 0.1, "κ inferred"),
        ("calibrated", 0.0, ""),
        ("calibrated", 0.1, ""),
    ]
    assert options["start"] == 5
    for k, (i, j) in enumerate([(2, 1), (1, 2)]):
        c = synced.observed[i, j]
        bases = [synced.shapes[m].basis.truncated(len(c)) for m in (i, j)]
        np.testing.assert_array_equal(states[0].images[k][:, 0], fmsync.point_map(c, *bases, choice[k]))
        np.testing.assert_array_equal(states[4].images[k][7], hot.vertex_images(i, j, int(choice[k][7])))
        np.testing.assert_array_equal(states[6].images[k][7], other.vertex_images(i, j, int(choice[k][7])))
        known = synced.confidence(i, j)
        np.testing.assert_array_equal(states[2].images[k][:, 0], synced.shapes[j].samples[known.image[:160]])
        np.testing.assert_array_equal(states[5].radius[k], known.radius[:160])
        np.testing.assert_array_equal(states[7].radius[k], default_calibration().radius(known)[:160])


def test_a_pair_that_was_not_matched_has_no_observed_map(synced, asked):
    far = [k for k, edge in enumerate(synced.edges.tolist()) if edge != [0, 1]]
    without = replace(
        synced, edges=synced.edges[far], matches=tuple(synced.matches[k] for k in far), used=np.arange(len(far))
    )
    states = asked({(0.0, "κ inferred"): without}, (0, 1))[2]
    assert [s.view for s in states] == ["synchronised", "posterior", "calibrated"]
