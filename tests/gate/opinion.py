"""A second opinion: a test that failed is run once more, alone, at once.

Passed then, it is *unsteady*: named, written down with date and load, and no reason to refuse a change,
unless there are many of them. Failed again, it is wrong. Both logs are kept.

Invariant: nothing that failed is forgotten; each failed test ends as failed or as unsteady.
"""

import dataclasses
import datetime
import os
import shutil
import threading

import libtest

# More unsteady tests than this in one run are a fault of the change or of the tests, not of the moment.
MOST_UNSTEADY = 5


@dataclasses.dataclass
class Unsteady:
    """A test that failed and then passed."""

    suite: str
    part: str
    test: str
    log: str
    said: list  # why it failed, in the lines of its log


class Judge:
    """Runs failed tests again and keeps the list of unsteady ones."""

    def __init__(self, runner, book, load=os.getloadavg):
        self.runner = runner
        self.book = book  # the file that keeps unsteady tests of all runs
        self.load = load
        self.unsteady = []
        self.lock = threading.Lock()

    def judge(self, part, ran):
        """Settles the failures of `ran`: its outcome afterwards holds those that failed twice, and no others."""
        outcome = ran.outcome
        if outcome.good or outcome.cannot_run:
            return
        if outcome.broken or not part.again:
            self._again_as_a_whole(part, ran)
            return
        # So many failures are no chance; running each again would only hide when the gate could have said so.
        if len(outcome.failed) > MOST_UNSTEADY:
            return
        twice = []
        for number, test in enumerate(outcome.failed):
            again = self.runner.run(part, part.again([test]), f"{part.title}.again{number or ''}")
            if again.outcome.good and again.outcome.passed == 1:
                outcome.passed += 1
                self._note(part, test, ran.log)
            else:
                twice.append(test)
        outcome.failed = twice

    def _again_as_a_whole(self, part, ran):
        """The process said nothing of single tests (it died, or did not begin): all of it is played again."""
        again = self.runner.run(part, part.command, f"{part.title}.again")
        if again.outcome.good:
            self._note(
                part,
                f"{part.title} as a whole ({ran.outcome.broken or ', '.join(ran.outcome.failed)})",
                ran.log,
            )
            ran.outcome, ran.skips = again.outcome, again.skips

    def _note(self, part, test, log):
        with self.lock:
            now = datetime.datetime.now().astimezone()
            # The next run writes a new log under the old name; a part that failed in several tests has one
            # log.
            kept = self.book.parent / "unsteady" / f"{now:%Y%m%dT%H%M%S}-{part.title}.log"
            kept.parent.mkdir(exist_ok=True)
            shutil.copyfile(log, kept)
            said = libtest.said_of(kept.read_text(errors="replace"), test)
            self.unsteady.append(Unsteady(part.suite, part.title, test, str(kept), said))
            one, five, _ = self.load()
            with open(self.book, "a") as book:
                book.write(
                    f"{now.isoformat(timespec='seconds')}  load {one:.1f} (1 min) {five:.1f} (5 min)  {part.suite}  {test}  {kept}\n"
                )
