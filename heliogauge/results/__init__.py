"""Results on disk: folders that appear whole or not at all, tables, arrays, slope maps."""
