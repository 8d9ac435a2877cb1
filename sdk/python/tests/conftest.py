"""What the tests share: libtest's lines for ``tests/run``, waiting under a watchdog, a fake host, and a built one."""

import os
import time

import pytest

WATCHDOG_S = 90


def eventually(what, look):
    """Looks until ``look()`` is true, and answers it; the watchdog ends it with what was seen last."""
    end = time.monotonic() + WATCHDOG_S
    while True:
        try:
            seen, problem = look(), None
        except AssertionError as e:
            seen, problem = None, e
        if seen:
            return seen
        if time.monotonic() > end:
            pytest.fail(f"{what}: not within {WATCHDOG_S} s; last seen: {problem or seen!r}")
        time.sleep(0.01)


def pytest_terminal_summary(terminalreporter, exitstatus):
    stats = terminalreporter.stats
    count = {word: len(stats.get(word, [])) for word in ("passed", "failed", "error", "skipped")}
    bad = count["failed"] + count["error"]
    terminalreporter.write_line("")
    for report in [*stats.get("failed", []), *stats.get("error", [])]:
        terminalreporter.write_line(f"test {report.nodeid} ... FAILED")
    # Those that said they cannot run passed as far as libtest knows; `tests/run` takes them off by the list.
    told = os.environ.get("TROCAR_SKIPS")
    ran = count["passed"] + (count["skipped"] if told else 0)
    if told:
        with open(told, "a") as f:
            for report in stats.get("skipped", []):
                why = report.longrepr[2] if isinstance(report.longrepr, tuple) else report.longrepr
                f.write(f"{report.nodeid}: {why}\n")
    word = "FAILED" if bad else "ok"
    ignored = 0 if told else count["skipped"]
    terminalreporter.write_line(f"test result: {word}. {ran} passed; {bad} failed; {ignored} ignored")
