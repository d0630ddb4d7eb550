"""Penalties on K - prior: |K - prior|^2 in closed form, |K - prior|_1 by coordinate descent or cvxpy."""

PENALTIES = ("ridge", "lasso")
