"""Runs the tests of trocar on a machine that has a Rust toolchain, a C and C++ compiler and python3, and sets
up the rest under the target directory by itself.

  ./tests/run                 the gate: everything deterministic, closed by one summary
  ./tests/run NAME...         only these suites, whole; workspace.PACKAGE: the unit tests of one crate
  ./tests/run --all           everything: also conformance_cross, tsan whole, python_oldest, generated, the long torture, five
                              times as many seeds
  ./tests/run --times         only what judges durations; it wants the machine for itself
  ./tests/run --torture [ROW...]   torture with the counts of the acceptance, or these rows of it
  ./tests/run --list          the names of the suites, and what each is
  ./tests/run --strict ...    an unsteady test is a failure
  ./tests/run --until-failure ...  ends with the first test that fails twice

A test that fails is run once more, alone, at once. Passed then it is *unsteady*: named at the end and in
target/outer/unsteady.log. Failed twice, or more than five unsteady ones: the run has failed. Ends with "N
unsteady" and "N passed, N failed, N skipped".

Logs are in target/outer/logs. tests/README.md says which kinds of tests there are and how to run one of them.
"""

import argparse
import os
import pathlib
import signal
import sys
import threading
import time

import etcd
import grpcurl
import suites
from building import Workshop
from lanes import Lanes
from opinion import MOST_UNSTEADY, Judge
from parts import ALL, GATE, TIMES, Runner
from summary import Screen, Suites, Times, count

ROOT = pathlib.Path(__file__).resolve().parents[2]
# --all plays so many times the seeds of the gate.
ALL_SEEDS = "5"


def parse(arguments):
    parser = argparse.ArgumentParser(
        prog="tests/run",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        usage=argparse.SUPPRESS,
    )
    parser.add_argument("names", nargs="*", help=argparse.SUPPRESS)
    for word in ("all", "times", "torture", "list", "strict", "until-failure"):
        parser.add_argument(f"--{word}", action="store_true", help=argparse.SUPPRESS)
    return parser.parse_args(arguments)


def wanted_parts(said):
    """Which kinds of parts run: those of the gate, of --all, of --times."""
    if said.times:
        return {TIMES}
    return {GATE, ALL} if said.all or said.names else {GATE}


class Run:
    """One run of the tests."""

    def __init__(self, said):
        target = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
        self.workshop = Workshop(ROOT, target if target.is_absolute() else ROOT / target)
        rows = said.names if said.torture else []
        self.said = said
        self.stage = suites.Stage(ROOT, self.workshop, everything=said.all)
        names, self.workshop.packages = (["torture"], []) if said.torture else suites.apart(said.names)
        if said.torture or said.all:
            self.stage.torture_args = ["--full", *rows]
        kinds = wanted_parts(said)
        self.suites = [
            suite
            for suite in suites.SUITES
            if suite.name in names or not names and (not suite.only or suite.only in kinds)
        ]
        self.workshop.drives = any(suite.drives for suite in self.suites)
        self.runner = Runner(self.workshop.logs)
        self.screen = Screen(sys.stdout, self.now)
        self.judge = Judge(self.runner, self.workshop.work / "unsteady.log")
        self.times = Times(self.workshop.work / "times.json")
        self.results = Suites(self.times.of, self.screen)
        self.broken_builds = []
        self.began = time.monotonic()

    def now(self):
        """The line of what runs at the moment."""
        running = list(self.runner.running.values()) + self.workshop.running
        minutes, seconds = divmod(int(time.monotonic() - self.began), 60)
        return f"{minutes}:{seconds:02} {', '.join(running)}" if running else ""

    def play(self):
        """Builds and runs what was asked for; answers whether all is well."""
        os.environ |= {
            "TROCAR_BIN_DIR": str(self.workshop.programs),
            "TROCAR_CPP_DIR": str(self.workshop.cpp),
        }
        os.environ.setdefault("CARGO_TARGET_DIR", str(self.workshop.target))
        if self.stage.everything:
            os.environ.setdefault("TROCAR_SEEDS", ALL_SEEDS)
        lanes = self.lanes = Lanes(max(2, os.cpu_count() or 2), self._play, self._ended, self._began)
        ticking = threading.Thread(target=self._tick, daemon=True)
        ticking.start()
        lanes.run(self._builds())
        self.times.keep(self.results.rows)
        return self._close()

    # -- builds ----------------------------------------------------------------------------------------------

    def _builds(self):
        """(name, function that answers the parts that can run when it is done), in the order in which they
        are built.
        """
        kinds = {suite.build for suite in self.suites}
        if any(suite.drives for suite in self.suites):
            yield from [("programs", self._programs)]
        elif "programs" in kinds:
            yield from [("tools", lambda: self._parts("programs"))]
        for kind in ("tests", "loom", "tsan", "bench"):
            if kind in kinds:
                yield kind, lambda kind=kind: self._build(kind, getattr(self.workshop, f"build_{kind}"))

    def _programs(self):
        self.stage.no_grpcurl = grpcurl.set_up(self.workshop.work, self.workshop.logs / "grpcurl.log")
        if any(suite.name == "etcd" for suite in self.suites):
            self.stage.no_etcd = etcd.set_up(self.workshop.work, self.workshop.logs / "etcd.log")
        worked = self._build("programs", lambda: self.workshop.build_programs() and self.workshop.build_cpp())
        self.stage.no_cpp = os.environ.get("TROCAR_NO_CPP", "")
        return worked

    def _build(self, kind, build):
        """The parts of the suites that this build makes executables for; none where it failed, which is told."""
        began = time.monotonic()
        if not self.screen.live:
            # A first build takes minutes: whoever reads a file or a pipe sees that something happens.
            self.screen.line(f"builds  {kind}")
        if not build():
            log = self.workshop.logs / f"{self.workshop.last}.log"
            self.broken_builds.append(kind)
            if self.said.until_failure:
                self.lanes.stop()
                self.runner.end()
            self.screen.line(f"FAILED  build of {kind}")
            self.screen.tail(log)
            return None
        self.screen.line(f"built   {kind:<21} {'':<34} {time.monotonic() - began:6.0f} s")
        return self._parts(kind)

    def _parts(self, kind):
        kinds = wanted_parts(self.said)
        parts = []
        for suite in self.suites:
            if suite.build == kind:
                made = suite.parts(self.stage)
                # A suite that was asked for by name and only judges durations, or is only for --all, runs
                # all the same.
                asked = [part for part in made if part.when in kinds] or (made if self.said.names else [])
                self.results.expect(suite.name, asked)
                parts += asked
        return parts

    # -- parts -----------------------------------------------------------------------------------------------

    def _began(self, part):
        self.screen.tick()

    def _play(self, part, quiet):
        if part.cannot_run:
            return self.runner.skipped(part)
        ran = self.runner.run(part, part.command, part.title)
        if not ran.outcome.good and not ran.outcome.cannot_run:
            with quiet:
                self.judge.judge(part, ran)
        return ran

    def _ended(self, part, ran):
        unsteady = sum(one.part == part.title for one in self.judge.unsteady)
        self.results.ends(part, ran, unsteady)
        if self.said.until_failure and self.results.total("failed"):
            self.lanes.stop()
            self.runner.end()

    def _tick(self):
        while True:
            time.sleep(1)
            self.screen.tick()

    # -- the end ---------------------------------------------------------------------------------------------

    def _close(self):
        results, unsteady = self.results, self.judge.unsteady
        self.screen.now = lambda: ""
        self.screen.line()
        for line in results.table():
            self.screen.line(line)
        self.screen.line(f"{'all':<21} {time.monotonic() - self.began:.0f} s")
        self.screen.line()
        # Whatever went wrong in the runner itself: a part without a result is a failure.
        unheard = results.unfinished()
        for title in unheard:
            self.screen.line(f"FAILED  {title}: it did not end")
        failed = results.total("failed") + len(self.broken_builds) + len(unheard)
        many = len(unsteady) > MOST_UNSTEADY
        for one in unsteady:
            self.screen.line(f"unsteady: {one.test} ({one.suite}), log: {one.log}")
            for line in one.said:
                self.screen.line(f"          {line}")
        for line in results.reasons():
            self.screen.line(line)
        if many:
            self.screen.line(
                f"more than {MOST_UNSTEADY} unsteady tests are a fault of the change or of the tests: the run has failed"
            )
        self.screen.line(f"{len(unsteady)} unsteady")
        self.screen.line(
            f"{results.total('passed')} passed, {failed} failed, {results.total('skipped')} skipped"
        )
        return not failed and not many and not (self.said.strict and unsteady) and results.total("passed") > 0


def main():
    said = parse(sys.argv[1:])
    if said.list:
        for suite in suites.SUITES:
            print(f"{suite.name:<21} {suite.about}")
        return 0
    unknown = [] if said.torture else [name for name in said.names if not suites.known(name)]
    if unknown:
        print(f"tests/run: there is no suite '{unknown[0]}'; ./tests/run --list names them", file=sys.stderr)
        return 2
    forgotten = suites.forgotten(ROOT)
    if forgotten:
        print(
            f"tests/run: tests/it/main.rs has {count(len(forgotten), 'suite')} that tests/gate/suites.py does not name, so it would never run: {', '.join(forgotten)}",
            file=sys.stderr,
        )
        return 2
    os.chdir(ROOT)
    run = Run(said)
    # Whoever breaks it off leaves no process behind.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    try:
        return 0 if run.play() else 1
    except KeyboardInterrupt:
        return 130
    finally:
        run.runner.end()


if __name__ == "__main__":
    # Threads of lanes wait for processes that were ended above; nothing of theirs is left to say.
    status = main()
    sys.stdout.flush()
    os._exit(status)
