"""Measurements of other programs become measurement folders."""
