"""Results of a batch: a folder that fills measurement by measurement and can be taken up again at any time."""

import shutil

from heliogauge.batch.rows import BATCH, INDEX_FILE, MEASURED
from heliogauge.errors import InputError
from heliogauge.files.on_disk import put_on_disk
from heliogauge.results.folder import SUMMARY_FILE, read_json
from heliogauge.results.growing_folder import Finished, GrowingFolder

#: What is finished, one line each: what its results were made from, and its row.
JOURNAL_FILE = "index.jsonl"
#: Where the traces of unexpected failures are.
FAILURES = "failures"
#: Names that no measurement's results can have.
RESERVED = (INDEX_FILE, JOURNAL_FILE, FAILURES, SUMMARY_FILE, "report.html", "report.ipynb", "measurement.toml")


class BatchFolder(GrowingFolder):
    """A folder of results with one folder for each measurement; its journal stays, for the next run."""

    journal_file = JOURNAL_FILE

    def refuse(self, names: set[str]) -> None:
        """Refuse the results of a single measurement."""
        if JOURNAL_FILE not in names and read_json(self.path / SUMMARY_FILE).get("kind") != BATCH:
            raise InputError(
                f"{self.path}: holds the results of one measurement; choose another folder or give force=True to "
                "replace results"
            )

    def is_kept(self, done: Finished) -> bool:
        """Return whether a measurement has results: one that failed is tried again."""
        return done.row.get("status") == MEASURED

    def remove(self, name: str) -> None:
        """Remove what an earlier run left of a measurement that now failed: its numbers are of other inputs."""
        if name in self.before or name in self.spoiled:
            shutil.rmtree(self.path / name, ignore_errors=True)

    def keep_trace(self, name: str, trace: str) -> str:
        """Write where an unexpected failure happened.

        Returns: The file, relative to the folder.
        """
        (self.path / FAILURES).mkdir(exist_ok=True)
        (self.path / FAILURES / f"{name}.txt").write_text(trace, encoding="utf-8")
        return f"{FAILURES}/{name}.txt"

    def rewrite_journal(self, names: list[str]) -> None:
        """Write the journal anew, without what later lines have replaced.

        names: What stays in it, in this order.
        """
        self.close_journal()
        partial = self.path / f".{JOURNAL_FILE}.partial"
        partial.write_text("".join(self.journal_line(name) for name in names), encoding="utf-8")
        put_on_disk([partial])
        partial.replace(self.path / JOURNAL_FILE)
        put_on_disk([self.path])
