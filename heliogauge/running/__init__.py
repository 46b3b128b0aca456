"""Terminal, progress, work side by side, command line, demonstration."""
