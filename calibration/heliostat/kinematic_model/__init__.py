"""The chain of steps from actuators to the mirror normal, forward and back, with derivatives."""
