"""``python -m heliogauge`` is the same as ``heliogauge``."""

from heliogauge.running.cli import main

if __name__ == "__main__":
    main()
