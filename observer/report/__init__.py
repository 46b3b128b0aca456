"""Figures and sections of the reports of troughs."""
