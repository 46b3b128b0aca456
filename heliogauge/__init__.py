"""The kernel shared by all instruments of heliogauge: cameras, rays, surfaces, slope maps, files, reports."""

__version__ = "0.1.0"
