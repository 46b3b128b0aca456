"""Centres of targets with covariance, to hundredths of a pixel."""
