"""A disk that is full, and a home that cannot be written."""

import resource
import subprocess
import sys

import pytest

#: Bytes that a file may grow to before the disk is taken for full.
LIMIT = 300_000


def limited() -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (LIMIT, LIMIT))


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the limit on file sizes stands in for a full disk")
def test_full_disk_is_one_message_and_leaves_nothing(drawn, tmp_path, repository):
    """HDF5 raised twice and crashed the interpreter (exit 139)."""
    command = [
        sys.executable,
        "-m",
        "heliogauge",
        "deflectometry",
        "measure",
        str(drawn),
        "-o",
        str(tmp_path / "r"),
        "-q",
    ]
    done = subprocess.run(
        [*command, "--no-report"], cwd=repository, capture_output=True, text=True, preexec_fn=limited, check=False
    )
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith(f"heliogauge: {tmp_path / 'r' / 'slope_map.nc'}: cannot be written (File too large)")
    assert done.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
