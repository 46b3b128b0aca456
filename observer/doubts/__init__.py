"""Contradictions between photos, collector and statements, named before they spoil the result."""
