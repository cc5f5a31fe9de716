"""Runs here are short on purpose: their convergence warnings are looked at where they are the subject."""

import pytest


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Ignore convergence warnings in this folder."""
    for item in items:
        if "samplers" in item.path.parts:
            item.add_marker(pytest.mark.filterwarnings("ignore::fmsync.diagnostics.ConvergenceWarning"))
