"""Mutation testing: single-line changes of the formulas, and whether the tests that execute them notice."""
