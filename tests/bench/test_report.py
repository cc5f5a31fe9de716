"""Methods of a suite, best first."""

import numpy as np
import pandas as pd

from bench import report
from tests.bench.test_results import frame


def test_errors_are_relative_to_the_best_of_each_problem():
    rows = [frame([2.0], "mle", sigma2=0.1), frame([8.0], "observed", sigma2=0.1), frame([0.0], "oracle", sigma2=0.1)]
    rows += [frame([3.0], "mle", sigma2=0.2), frame([1.5], "observed", sigma2=0.2)]
    table = report.relative_performance(pd.concat(rows).assign(method=lambda rows: rows.label))
    assert table.label.tolist() == ["mle", "observed"]  # the oracle sees the truth
    np.testing.assert_allclose(table[["ratio", "low", "high"]], [[2**0.5, 1, 2], [2, 1, 4]])
    assert table.file.tolist() == ["fmsync/estimators/mle.py", "bench/methods/controls.py"]
    shown = report.as_list(table, "A < B")
    assert shown.count("<details") == 2
    assert "A &lt; B" in shown
    assert 'fm-performance fm-control"><summary><span>the observed maps as they are' in shown
