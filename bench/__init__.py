"""Suites of problems and methods, run by run: ``python -m bench run SUITE``."""
