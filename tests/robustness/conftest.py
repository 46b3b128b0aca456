"""A measurement drawn once, copied and spoilt by each test."""

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from data_synth.fringes.dataset import DatasetOptions, write_dataset
from data_synth.fringes.knowledge import Knowledge
from data_synth.fringes.presets import preset_scene


@pytest.fixture(scope="session")
def drawn(tmp_path_factory) -> Path:
    """The standard small facet: no test may change it."""
    folder = tmp_path_factory.mktemp("drawn") / "measurement"
    write_dataset(folder, preset_scene("small"), DatasetOptions(0, Knowledge()))
    return folder


@pytest.fixture
def folder(drawn, tmp_path) -> Path:
    """A copy to spoil."""
    return shutil.copytree(drawn, tmp_path / "measurement")


@pytest.fixture(scope="session")
def rewrite() -> Callable[..., None]:
    """Replace what matches a pattern in a measurement.toml; something must match."""

    def replace(folder: Path, *changes: tuple[str, str]) -> None:
        file = folder / "measurement.toml"
        text = file.read_text()
        for pattern, new in changes:
            text, count = re.subn(pattern, new, text, flags=re.MULTILINE)
            assert count, pattern
        file.write_text(text)

    return replace


@pytest.fixture(scope="session")
def start(repository) -> Callable[..., subprocess.Popen]:
    """Start the command line as a process of its own session."""

    def begin(*arguments: object, env_extra: dict[str, str] | None = None) -> subprocess.Popen:
        command = [sys.executable, "-m", "heliogauge", *map(str, arguments)]
        environment = {**os.environ, "PYTHONPATH": str(repository), **(env_extra or {})}
        return subprocess.Popen(
            command,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            # A test run started in the background hands down an ignored SIGINT.
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509
        )

    return begin
