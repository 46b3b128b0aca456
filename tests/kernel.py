"""Run a notebook as its reader does: in a real kernel of this Python."""

import os
from pathlib import Path
from typing import Any

import nbformat
import pytest
from nbclient import NotebookClient


def run_in_jupyter(notebook: Any, folder: Path, repository: Path) -> Any:
    """Return the notebook as it is after all its cells have run in a kernel that was started in a folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("JUPYTER_PREFER_ENV_PATH", "1")
        patch.setenv("IPYTHONDIR", str(folder.parent / ".ipython"))
        patch.setenv("PYTHONPATH", os.pathsep.join(filter(None, (str(repository), os.environ.get("PYTHONPATH")))))
        client = NotebookClient(
            notebook, timeout=600, startup_timeout=120, resources={"metadata": {"path": str(folder)}}
        )
        return client.execute()


def read(file: Path) -> Any:
    """Read a notebook; nbformat checks it."""
    notebook = nbformat.read(file, as_version=4)
    nbformat.validate(notebook)
    return notebook
