"""The slope map: the common product of all instruments, its statistics, removals and heights."""
