"""Photos of a screen to its geometry: the stages in a row; the file of a measured screen."""
