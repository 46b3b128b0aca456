"""Synthetic measurements with known truth, drawn by code that no estimator shares."""
