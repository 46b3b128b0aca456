"""Folders of results that fill part by part: their journal is a file of their own."""

import os
import threading
from pathlib import Path

import pytest

from heliogauge.batch.batch_folder import BatchFolder
from heliogauge.errors import InputError


def test_a_pipe_in_place_of_the_journal_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / BatchFolder.journal_file)
    said: list[str] = []

    def enter() -> None:
        try:
            with BatchFolder(tmp_path):
                said.append("entered")
        except InputError as error:
            said.append(str(error))

    thread = threading.Thread(target=enter, daemon=True)
    thread.start()
    thread.join(20)
    assert [one.partition(": ")[2] for one in said] == ["is no regular file, and no journal; remove it"]


def test_a_journal_that_leads_elsewhere_is_not_written_to(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / BatchFolder.journal_file).symlink_to(tmp_path / "notes.txt")
    with pytest.raises(InputError, match="is no regular file"), BatchFolder(tmp_path / "out"):
        pass
    assert (tmp_path / "notes.txt").read_text() == "mine"
