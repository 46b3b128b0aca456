"""The observation equation and its joint solution: slopes of all rows, cameras and tube in one adjustment."""
