"""The viewer: pages of results, made when they are asked for and served to this machine alone.

A page of a result is its report at full resolution: the same notebook, with the numbers kept beside the page.
"""
