"""Robust adjustment of the kinematic model: priors, model choice, splits, prediction with its expected error."""
