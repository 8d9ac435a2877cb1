"""What the tests share: libtest's lines for ``tests/run``, and waits whose measure is progress.

Invariant: the name in a line ``test NAME ... ok`` is what ``--exact NAME`` takes, and names that test alone.
"""

import asyncio
import os
import re
import time

import pytest

from trocar import TrocarError

STANDSTILL_S = 60
"""A wait fails when what it observes has not changed for so long, whatever it takes in all."""


def _heard(look):
    """The answer of ``look``, or why there is none: an assertion does not hold yet, or a process is thought
    lost, as it may be for a moment on a busy machine.
    """
    try:
        return look(), None
    except AssertionError as e:
        return None, e
    except TrocarError as e:
        if e.reason != "PROCESS_LOST":
            raise
        return None, e


class _Watchdog:
    """Ends a wait whose observation stands still."""

    def __init__(self, what):
        self.what, self.last, self.since = what, None, time.monotonic()

    def look(self, look, progress):
        """What ``look`` answered where that is true, else nothing."""
        seen, problem = _heard(look)
        if seen:
            return seen
        now = (repr(problem or seen), repr(_heard(progress)) if progress else "")
        if now != self.last:
            self.last, self.since = now, time.monotonic()
        elif time.monotonic() - self.since > STANDSTILL_S:
            pytest.fail(f"{self.what}: nothing has changed for {STANDSTILL_S} s; last seen: {problem or seen!r} {now[1]}")
        return None


def eventually(what, look, progress=None):
    """Looks until ``look()`` is true, and answers it. ``progress()`` is observed beside it: a count, a size,
    a state on the way there.
    """
    watchdog = _Watchdog(what)
    while True:
        if seen := watchdog.look(look, progress):
            return seen
        time.sleep(0.01)


def reaches(what, count, least):
    """Waits until ``count()`` is ``least`` or more; each change of it is progress."""
    eventually(what, lambda: count() >= least, progress=count)


async def eventually_in_loop(what, look, progress=None):
    """The same within a running loop, which goes round between two looks."""
    watchdog = _Watchdog(what)
    while True:
        if seen := watchdog.look(look, progress):
            return seen
        await asyncio.sleep(0)


def name_of(nodeid):
    """A test's name in its line: pytest's, without what would need quotes in a shell."""
    return re.sub(r"[^\w./:\[\]+-]", "_", nodeid)


def pytest_addoption(parser):
    group = parser.getgroup("tests/run")
    group.addoption("--exact", action="append", default=[], metavar="NAME", help="only the test of this name, as its line says it")
    group.addoption("--times", action="store_true", help="only tests that judge durations, which are left out otherwise")


def pytest_configure(config):
    config.addinivalue_line("markers", "times: judges durations; runs only with --times, on a machine that does nothing else")
    config.pluginmanager.register(Lines(config), "lines")


def pytest_collection_modifyitems(config, items):
    times, exact = config.getoption("--times"), config.getoption("--exact")
    names = [name_of(item.nodeid) for item in items]
    if twice := {name for name in names if names.count(name) > 1}:
        raise pytest.UsageError(f"two tests are called {', '.join(sorted(twice))}")
    if unknown := set(exact) - set(names):
        raise pytest.UsageError(f"no test is called {', '.join(sorted(unknown))}")

    def chosen(item):
        return name_of(item.nodeid) in exact if exact else (item.get_closest_marker("times") is not None) == times

    config.hook.pytest_deselected(items=[item for item in items if not chosen(item)])
    items[:] = [item for item in items if chosen(item)]


class Lines:
    """What libtest prints, in place of pytest's letters: a line for each test as soon as it is over, and one
    with the counts.
    """

    def __init__(self, config):
        self.config, self.over, self.bad, self.skipped = config, 0, set(), {}
        # Where skipped tests are named in a file, they passed as far as libtest knows; `tests/run` takes them
        # off by that list.
        self.told = os.environ.get("TROCAR_SKIPS")

    def write(self, line):
        self.config.pluginmanager.get_plugin("terminalreporter").write_line(line)

    def pytest_report_teststatus(self, report):
        if report.when == "call":
            return report.outcome, "", ""
        return {"failed": "error", "skipped": "skipped"}.get(report.outcome, ""), "", ""

    def pytest_runtest_logreport(self, report):
        if report.failed:
            self.bad.add(report.nodeid)
        if report.skipped:
            self.skipped[report.nodeid] = report.longrepr[2] if isinstance(report.longrepr, tuple) else report.longrepr

    def pytest_runtest_logfinish(self, nodeid):
        self.over += 1
        well = "ignored" if nodeid in self.skipped and not self.told else "ok"
        self.write(f"test {name_of(nodeid)} ... {'FAILED' if nodeid in self.bad else well}")

    @pytest.hookimpl(trylast=True)
    def pytest_terminal_summary(self, terminalreporter, exitstatus):
        if exitstatus == pytest.ExitCode.USAGE_ERROR:
            return
        # A file that cannot be imported failed without a test of its own.
        broken = [report.nodeid for report in terminalreporter.stats.get("error", []) if report.nodeid not in self.bad]
        for nodeid in broken:
            self.write(f"test {name_of(nodeid)} ... FAILED")
        if self.told:
            with open(self.told, "a") as file:
                file.writelines(f"{name_of(nodeid)}: {why}\n" for nodeid, why in self.skipped.items())
        bad, ignored = len(self.bad) + len(broken), 0 if self.told else len(self.skipped)
        word, passed = "FAILED" if bad else "ok", self.over - len(self.bad) - ignored
        self.write(f"test result: {word}. {passed} passed; {bad} failed; {ignored} ignored")
