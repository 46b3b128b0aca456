"""The Observer: photos of the absorber's reflection in a parabolic trough to slope errors and absorber position."""
