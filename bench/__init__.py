"""Suites of problems and methods, run cell by cell: ``python -m bench run SUITE``."""
