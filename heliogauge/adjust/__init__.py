"""Least-squares adjustment with robust loss, constraints, covariance; its statistical tests."""
