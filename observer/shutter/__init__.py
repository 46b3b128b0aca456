"""Cameras that read one row after the other while they fly: how far they get during a frame, and what that moves."""
