"""Suites of problems and methods, run cell by cell: ``fmsync bench run SUITE``."""
