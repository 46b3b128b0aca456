"""What finished measurements are for: panels aligned, orientations compared, modules side by side."""
