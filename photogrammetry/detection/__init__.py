"""Targets, markers and features found in photos and identified; false codes refused with a reason."""
