"""The one guarded way to files: they are data, none is executed, followed elsewhere, or read before its size fits.

Only regular files are opened; a pipe, a device, a folder or a drive that does not answer ends in a message. Sizes are
checked against documented limits and the memory that is free, from the header where a small file can stand for large
data. Whatever a library raises on a damaged file becomes an `heliogauge.errors.InputError` that names the file.
"""
