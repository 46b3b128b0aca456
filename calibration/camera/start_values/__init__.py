"""Intrinsics and poses to start the adjustment from."""
