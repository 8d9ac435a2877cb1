"""A part: one process of tests, as it is started, and as it is started again for some of its tests."""

import dataclasses
import os
import signal
import subprocess
import time
from typing import Callable, Optional

import libtest

# When a part runs.
GATE, ALL, TIMES = "gate", "all", "times"
# The longest test takes some minutes; one that waits in vain ends by itself after five.
MOST_SILENT_S = 15 * 60
POLL_S = 0.02


@dataclasses.dataclass
class Part:
    """One process of a suite."""

    suite: str
    command: list
    again: Optional[
        Callable
    ]  # names of tests -> the command that runs exactly these; `None`: it is played again as a whole
    name: str = ""  # tells the parts of a suite apart
    when: str = GATE
    alone: bool = False  # it counts cycles: nothing else runs beside it
    heavy: bool = False  # it keeps a processor busy: no other such part runs beside it
    env: dict = dataclasses.field(default_factory=dict)
    cwd: str = "."
    cannot_run: str = ""  # why it is skipped
    show: str = ""  # lines of the log that match this are printed when it ends

    @property
    def title(self):
        return f"{self.suite}.{self.name}" if self.name else self.suite


@dataclasses.dataclass
class Ran:
    """What one process came to."""

    outcome: libtest.Outcome
    seconds: float
    cpu: float
    log: str
    skips: dict  # test -> why it did not run here


class Runner:
    """Starts processes, each in a process group of its own, and ends those that are left."""

    def __init__(self, logs, most_silent_s=MOST_SILENT_S):
        self.logs = logs
        self.most_silent_s = most_silent_s
        self.running = {}

    def run(self, part, command, log_name):
        """Runs a command of a part to its end. A test it calls skipped is no longer counted as passed."""
        log, skips = self.logs / f"{log_name}.log", self.logs / f"{log_name}.skips"
        skips.unlink(missing_ok=True)
        env = {**os.environ, **part.env, "TROCAR_SKIPS": str(skips)}
        began = time.monotonic()
        with open(log, "wb") as out:
            try:
                child = subprocess.Popen(
                    command,
                    stdin=subprocess.DEVNULL,
                    stdout=out,
                    stderr=subprocess.STDOUT,
                    env=env,
                    cwd=part.cwd,
                    start_new_session=True,
                )
            except OSError as error:
                return Ran(
                    libtest.Outcome(broken=f"{command[0]} cannot be started: {error}"), 0, 0, str(log), {}
                )
            self.running[child.pid] = part.title
            try:
                stood_still, status, usage = self._wait(child.pid, log)
                child.returncode = os.waitstatus_to_exitcode(status)
            finally:
                self.running.pop(child.pid, None)
        outcome = libtest.read(log.read_text(errors="replace"), child.returncode)
        if stood_still:
            outcome.broken = f"printed nothing for {self.most_silent_s / 60:.0f} minutes, and was ended"
        told = (
            [line.split(": ", 1) for line in skips.read_text(errors="replace").splitlines()]
            if skips.exists()
            else []
        )
        skipped = {one[0]: one[-1] for one in told}
        outcome.passed -= len(skipped)
        return Ran(outcome, time.monotonic() - began, usage.ru_utime + usage.ru_stime, str(log), skipped)

    def _wait(self, pid, log):
        """Waits for the end of a process. One that prints nothing for too long hangs, and is ended."""
        size, since, stood_still = -1, time.monotonic(), False
        while True:
            ended, status, usage = os.wait4(pid, os.WNOHANG)
            if ended:
                return stood_still, status, usage
            now, printed = time.monotonic(), log.stat().st_size
            if printed != size:
                size, since = printed, now
            if now - since > self.most_silent_s and not stood_still:
                stood_still = True
                os.killpg(pid, signal.SIGKILL)
            time.sleep(POLL_S)

    def skipped(self, part):
        """A part that cannot run on this machine."""
        return Ran(libtest.Outcome(cannot_run=part.cannot_run), 0, 0, "", {})

    def end(self):
        """Ends whatever still runs."""
        for group in list(self.running):
            try:
                os.killpg(group, signal.SIGKILL)
            except ProcessLookupError:
                pass
