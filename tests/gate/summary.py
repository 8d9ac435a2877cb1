"""What people see: a line for each suite as it ends, at a terminal what runs now, and the closing counts.

Invariant: the last line is "N passed, N failed, N skipped", and the line before it "N unsteady"; the end of a
log is shown for failures only, and what failed is said once more, with its reason, where a reader looks: at the end.
"""

import json
import re
import shutil
import threading

import libtest

TAIL = 60
WIDTH = 21


def count(number, noun):
    """Number and noun: 1 test, 2 tests."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


class Suites:
    """Results by suite, in the order in which their first parts ended.

    The time of a suite is that of its parts together: they may run at different times, or beside each other.
    """

    def __init__(self, times, out):
        self.times = times  # suite -> seconds of the last run
        self.rows = {}
        self.left = {}  # suite -> its parts that have not ended
        self.failures = []  # (name, lines that say why), in the order in which they were seen
        self.out = out
        self.lock = threading.Lock()

    def expect(self, suite, parts):
        """The suite has ended when these parts have."""
        with self.lock:
            self.left[suite] = {part.title for part in parts}

    def ends(self, part, ran, unsteady):
        """Adds a part to its suite, and tells the suite when all its parts are done."""
        with self.lock:
            row = self.rows.setdefault(
                part.suite,
                {
                    "passed": 0,
                    "failed": 0,
                    "skipped": 0,
                    "seconds": 0.0,
                    "cpu": 0.0,
                    "unsteady": 0,
                    "why": [],
                },
            )
            outcome = ran.outcome
            if not outcome.good and not outcome.cannot_run:
                self._failure(part, ran)
            elif part.show and ran.log:
                self.out.matching(ran.log, part.show)
            row["seconds"] += ran.seconds
            row["passed"] += outcome.passed
            row["failed"] += len(outcome.failed) or bool(outcome.broken)
            row["skipped"] += outcome.ignored + len(ran.skips) + bool(outcome.cannot_run)
            row["cpu"] += ran.cpu
            row["unsteady"] += unsteady
            row["why"] += [f"{test}: {why}" for test, why in ran.skips.items()]
            row["why"] += [outcome.cannot_run] if outcome.cannot_run else []
            self.left[part.suite].discard(part.title)
            if not self.left[part.suite]:
                self.out.line(self._line(part.suite, row))
                for why in row["why"]:
                    self.out.line(f"       skipped: {why}")

    def _line(self, suite, row):
        word = "FAILED" if row["failed"] else "skipped" if not row["passed"] and row["skipped"] else "ok"
        said = [
            count(row["passed"], "test")
            if not row["failed"]
            else f"{row['passed']} passed, {row['failed']} failed"
        ]
        said += [f"{row['skipped']} skipped"] if row["skipped"] else []
        said += [f"{row['unsteady']} unsteady"] if row["unsteady"] else []
        last = f" (last run {self.times[suite]:.0f} s)" if suite in self.times else ""
        return f"{word:<7} {suite:<{WIDTH}} {', '.join(said):<34} {row['seconds']:6.0f} s{last}"

    def _failure(self, part, ran):
        told = ran.outcome.failed or [f"{part.title}: {ran.outcome.broken}"]
        for name in told[:40]:
            self.out.line(f"FAILED  {name}")
        self.out.tail(ran.log)
        text = self.out.text(ran.log)
        self.failures += [(name, libtest.said_of(text, name)) for name in told]

    def table(self):
        """Rows for people who compare runs."""
        lines = [
            f"{'suite':<{WIDTH}} {'passed':>7} {'failed':>7} {'skipped':>8} {'unsteady':>9} {'time':>8} {'processor':>10}"
        ]
        for suite, row in self.rows.items():
            seconds = row["seconds"]
            lines.append(
                f"{suite:<{WIDTH}} {row['passed']:>7} {row['failed']:>7} {row['skipped']:>8} {row['unsteady']:>9} {seconds:>6.0f} s {row['cpu']:>8.0f} s"
            )
        return lines

    def reasons(self):
        """Each failed test once more, and why."""
        lines = []
        for name, said in self.failures:
            lines += [f"FAILED  {name}", *(f"        {line}" for line in said)]
        return lines

    def unfinished(self):
        """Parts that were to run and of which nothing was heard."""
        return sorted(title for titles in self.left.values() for title in titles)

    def total(self, word):
        return sum(row[word] for row in self.rows.values())


class Screen:
    """Standard output, with one changing line at its end where it is a terminal."""

    def __init__(self, stream, now=lambda: ""):
        self.stream = stream
        self.now = now  # what runs at the moment
        self.live = stream.isatty()
        self.shown = False
        self.lock = threading.RLock()

    def line(self, text=""):
        with self.lock:
            self._wipe()
            print(text, file=self.stream, flush=True)
            self.tick()

    def tick(self):
        """Renews the line of what runs now."""
        with self.lock:
            text = self.now() if self.live else ""
            self._wipe()
            if text:
                width = shutil.get_terminal_size().columns
                self.stream.write(text[: width - 1])
                self.stream.flush()
                self.shown = True

    def _wipe(self):
        if self.shown:
            self.stream.write("\r\033[K")
            self.shown = False

    def text(self, log):
        """A log, or why there is none."""
        try:
            with open(log, errors="replace") as file:
                return file.read()
        except OSError as error:
            return f"it cannot be read: {error}"

    def tail(self, log):
        self.line(f"-- the end of {log}")
        # cargo's messages for programs would hide what it says to people.
        lines = [line for line in self.text(log).splitlines() if not line.startswith('{"reason":')]
        for line in lines[-TAIL:]:
            self.line(f"   {line}")

    def matching(self, log, pattern):
        """Figures of a suite, which it printed among other things."""
        with open(log, errors="replace") as file:
            for line in file:
                if re.search(pattern, line):
                    self.line(f"        {line.rstrip()}")


class Times:
    """Seconds of each suite in the last run, kept under the target directory."""

    def __init__(self, path):
        self.path = path
        try:
            self.of = {suite: float(seconds) for suite, seconds in json.loads(path.read_text()).items()}
        except (OSError, ValueError, AttributeError):
            self.of = {}

    def keep(self, rows):
        self.of |= {suite: round(row["seconds"], 1) for suite, row in rows.items()}
        self.path.write_text(json.dumps(self.of, indent=1, sort_keys=True))
