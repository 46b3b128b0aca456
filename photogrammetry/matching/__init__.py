"""Targets without a code: matched between photos, named, followed from photo to photo."""
