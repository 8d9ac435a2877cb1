"""Reads the lines that libtest prints, and every suite of ours with it: which tests passed, which failed, how
many were ignored.

Invariant: a process that ended badly without naming a test has failed as a whole; a run in which no test ran
has failed.
"""

import dataclasses
import re

LINE = re.compile(r"^test (.+?) \.\.\. (ok|FAILED|ignored)\b")
RESULT = re.compile(r"^test result: \w+\. (\d+) passed; (\d+) failed; (\d+) ignored")
# A suite that cannot run on this machine ends with this status and says why in its last line.
CANNOT_RUN = 77


@dataclasses.dataclass
class Outcome:
    """The result of one process of tests."""

    passed: int = 0
    failed: list = dataclasses.field(
        default_factory=list
    )  # names; empty although `broken` says that something is wrong
    ignored: int = 0
    broken: str = ""  # why the process as a whole failed
    cannot_run: str = ""

    @property
    def good(self):
        return not self.failed and not self.broken


def read(text, status):
    """The outcome of a process that printed `text` and ended with `status`."""
    if status == CANNOT_RUN:
        lines = text.strip().splitlines()
        return Outcome(cannot_run=lines[-1] if lines else "no reason given")
    results = [tuple(map(int, found.groups())) for found in map(RESULT.match, text.splitlines()) if found]
    names = [
        found.group(1) for found in map(LINE.match, text.splitlines()) if found and found.group(2) == "FAILED"
    ]
    # A doc test's name is followed by its mode: "path - item (line 3) - compile".
    failed = list(dict.fromkeys(names))
    outcome = Outcome(sum(r[0] for r in results), failed, sum(r[2] for r in results))
    told = sum(r[1] for r in results)
    if told > len(failed):
        outcome.broken = f"{told} tests failed, and only {len(failed)} are named"
    elif status and not failed:
        outcome.broken = (
            f"ended by signal {-status}"
            if status < 0
            else f"ended with status {status}, and no failed test is named"
        )
    elif not results:
        outcome.broken = "no test ran"
    return outcome


# The first lines of a failure help; the log has the rest.
MOST_SAID = 8


def _after(lines, failure):
    """What a suite printed between the line of a failure and that of its next test; its duration says nothing."""
    if failure not in lines:
        return []
    rest = lines[lines.index(failure) + 1 :]
    end = next((at for at, line in enumerate(rest) if LINE.match(line) or line.startswith("test result: ")), None)
    said = [line for line in rest[:end] if not re.fullmatch(r" *\d+(\.\d+)? s", line)]
    return said if any(line.strip() for line in said) else []


def said_of(text, test):
    """The lines of a log that say why a test failed: its own output as libtest shows it, or every line that
    begins with its name, or what follows the line of its failure, or else every line that has its name.
    """
    lines = text.splitlines()
    heading = f"---- {test} stdout ----"
    if heading in lines:
        rest = lines[lines.index(heading) + 1 :]
        end = next((at for at, line in enumerate(rest) if line.startswith("---- ") or line == "failures:"), None)
        said = [line for line in rest[:end] if not line.startswith("note: run with")]
    else:
        others = [line for line in lines if not LINE.match(line)]
        said = (
            [line for line in others if line.startswith(f"{test}: ")]
            or _after(lines, f"test {test} ... FAILED")
            or [line for line in others if test in line]
        )
    return [line.rstrip() for line in said if line.strip()][:MOST_SAID]
