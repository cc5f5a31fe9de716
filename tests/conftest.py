"""What every test file shares."""

import os
import sys
from pathlib import Path

import pytest

# Importing nbformat imports jsonschema, which would build forty parsers of web addresses: ten seconds in every worker.
# No test checks such an address, and jsonschema goes without the package.
sys.modules.setdefault("rfc3987_syntax", None)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests marked ``tosca`` run where FMSYNC_DATA has the TOSCA cats."""
    folder = Path(os.environ.get("FMSYNC_DATA") or os.devnull) / "tosca_cat"
    if (folder / "cat0.off").is_file():
        return
    skip = pytest.mark.skip(reason="no TOSCA cats: FMSYNC_DATA names no folder that holds tosca_cat")
    for item in items:
        if item.get_closest_marker("tosca"):
            item.add_marker(skip)
