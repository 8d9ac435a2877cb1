#!/usr/bin/env python3
"""Tests of the runner itself: how output is read, what a second opinion does, what runs beside what, what
people see.

python3 tests/gate/tests.py [--exact NAME...]      prints libtest's lines
"""

import io
import os
import pathlib
import sys
import tempfile
import threading
import types
import unittest

import building
import libtest
import planted
import suites
from lanes import Lanes
from opinion import Judge
from parts import Part, Runner
from summary import Screen, Suites

OK = "test a::b ... ok\ntest result: ok. 1 passed; 0 failed; 0 ignored\n"


class WhatLibtestPrints(unittest.TestCase):
    def test_a_good_run_counts_its_tests(self):
        seen = libtest.read(OK, 0)
        self.assertTrue(seen.good)
        self.assertEqual((seen.passed, seen.failed, seen.ignored), (1, [], 0))

    def test_several_results_are_added(self):
        seen = libtest.read(OK + "test result: ok. 4 passed; 0 failed; 2 ignored; 0 measured\n", 0)
        self.assertEqual((seen.passed, seen.ignored), (5, 2))

    def test_failed_tests_are_named_once(self):
        text = "test a::b ... FAILED\ntest src/x.rs - y (line 3) - compile ... FAILED\ntest result: FAILED. 3 passed; 2 failed; 0 ignored\n"
        seen = libtest.read(text, 101)
        self.assertEqual(seen.failed, ["a::b", "src/x.rs - y (line 3) - compile"])
        self.assertEqual(seen.passed, 3)
        self.assertFalse(seen.good)

    def test_a_process_that_died_has_failed_as_a_whole(self):
        seen = libtest.read("test a::b ... ok\n", -6)
        self.assertIn("signal 6", seen.broken)
        self.assertFalse(seen.good)

    def test_a_failure_without_a_name_is_a_failure(self):
        self.assertIn(
            "only 0 are named", libtest.read("test result: FAILED. 1 passed; 1 failed; 0 ignored\n", 1).broken
        )

    def test_a_run_in_which_no_test_ran_has_failed(self):
        self.assertIn("no test ran", libtest.read("", 0).broken)

    def test_a_status_that_contradicts_the_result_is_a_failure(self):
        self.assertIn("status 3", libtest.read(OK, 3).broken)

    def test_a_suite_that_cannot_run_says_why_in_its_last_line(self):
        self.assertEqual(
            libtest.read("looking\nnpm is missing\n", libtest.CANNOT_RUN).cannot_run, "npm is missing"
        )


class WhyATestFailed(unittest.TestCase):
    def test_libtest_shows_the_output_of_each_failed_test_by_itself(self):
        log = (
            "test a::b ... FAILED\ntest a::bc ... FAILED\n\nfailures:\n\n---- a::b stdout ----\n\n"
            "thread 'a::b' panicked at x.rs:3:5:\nit is 4 and not 3\nnote: run with `RUST_BACKTRACE=1`\n\n"
            "---- a::bc stdout ----\nother\n\nfailures:\n    a::b\n    a::bc\n"
        )
        self.assertEqual(
            libtest.said_of(log, "a::b"), ["thread 'a::b' panicked at x.rs:3:5:", "it is 4 and not 3"]
        )
        self.assertEqual(libtest.said_of(log, "a::bc"), ["other"])

    def test_a_suite_of_ours_says_it_in_lines_that_begin_with_the_name(self):
        log = "test torture::x ... FAILED\nrow torture::x\ntorture::x: files: 3; allowed 0\ntorture::xy: other\n"
        self.assertEqual(libtest.said_of(log, "torture::x"), ["torture::x: files: 3; allowed 0"])

    def test_or_after_the_line_of_its_failure(self):
        log = "test v::a ... ok\n   1.2 s\ntest v::b ... FAILED\n   9.8 s\nError: it is 4, wanted 5\n    at b (x.mjs:1)\ntest v::c ... ok\n"
        self.assertEqual(libtest.said_of(log, "v::b"), ["Error: it is 4, wanted 5", "    at b (x.mjs:1)"])
        self.assertEqual(libtest.said_of(log.replace("v::c ... ok", "result: FAILED"), "v::b")[0], "Error: it is 4, wanted 5")

    def test_or_anywhere_in_a_line_and_little_of_it(self):
        log = "E  t is wrong\n" * 50 + "test t ... FAILED\n"
        self.assertEqual(libtest.said_of(log, "t"), ["E  t is wrong"] * libtest.MOST_SAID)
        self.assertEqual(libtest.said_of("", "t"), [])


class Stage(unittest.TestCase):
    """Parts that are shell scripts in a directory of their own."""

    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()
        self.addCleanup(self.folder.cleanup)
        self.work = pathlib.Path(self.folder.name)
        self.runner = Runner(self.work)
        self.judge = Judge(self.runner, self.work / "unsteady.log", load=lambda: (1.0, 2.0, 3.0))

    def part(self, first, again="exit 9"):
        """A part whose command is a script; `again` gets the names of tests as its arguments."""
        return Part(
            "some",
            ["sh", "-c", first],
            lambda names: ["sh", "-c", again, "again", *names],
            cwd=str(self.work),
        )

    def play(self, part):
        ran = self.runner.run(part, part.command, part.title)
        self.judge.judge(part, ran)
        return ran

    FAILS = "printf 'test a ... ok\\ntest b ... FAILED\\ntest result: FAILED. 1 passed; 1 failed; 0 ignored\\n'; exit 1"


class ASecondOpinion(Stage):
    def test_what_failed_once_is_unsteady_and_written_down(self):
        ran = self.play(
            self.part(
                self.FAILS, "printf 'test %s ... ok\\ntest result: ok. 1 passed; 0 failed; 0 ignored\\n' $1"
            )
        )
        self.assertTrue(ran.outcome.good)
        self.assertEqual(ran.outcome.passed, 2)
        [one] = self.judge.unsteady
        self.assertEqual((one.suite, one.test), ("some", "b"))
        self.assertIn("test b ... FAILED", pathlib.Path(one.log).read_text())
        self.assertRegex(
            (self.work / "unsteady.log").read_text(), r"^20..-.*load 1.0 \(1 min\) 2.0 \(5 min\)  some  b  "
        )

    def test_what_failed_twice_has_failed(self):
        ran = self.play(
            self.part(
                self.FAILS,
                "printf 'test %s ... FAILED\\ntest result: FAILED. 0 passed; 1 failed; 0 ignored\\n' $1; exit 1",
            )
        )
        self.assertEqual(ran.outcome.failed, ["b"])
        self.assertEqual(self.judge.unsteady, [])

    def test_a_second_run_without_the_test_is_no_success(self):
        ran = self.play(self.part(self.FAILS, "echo 'test result: ok. 0 passed; 0 failed; 0 ignored'"))
        self.assertEqual(ran.outcome.failed, ["b"])

    def test_many_failures_are_not_played_again(self):
        many = (
            "".join(f"echo 'test t{n} ... FAILED';" for n in range(6))
            + "echo 'test result: FAILED. 0 passed; 6 failed; 0 ignored'; exit 1"
        )
        ran = self.play(self.part(many, "touch played_again; exit 1"))
        self.assertEqual(len(ran.outcome.failed), 6)
        self.assertFalse((self.work / "played_again").exists())

    def test_a_process_that_died_is_played_again_as_a_whole(self):
        died_once = "test -e again && { printf 'test a ... ok\\ntest result: ok. 1 passed; 0 failed; 0 ignored\\n'; exit 0; }; touch again; kill -ABRT $$"
        ran = self.play(self.part(died_once))
        self.assertTrue(ran.outcome.good)
        self.assertIn("signal 6", self.judge.unsteady[0].test)

    def test_a_skipped_test_is_not_counted_as_passed(self):
        script = "echo 'a: no camera' >\"$TROCAR_SKIPS\"; printf 'test a ... ok\\ntest b ... ok\\ntest result: ok. 2 passed; 0 failed; 0 ignored\\n'"
        ran = self.play(self.part(script))
        self.assertEqual((ran.outcome.passed, ran.skips), (1, {"a": "no camera"}))

    def test_a_process_that_hangs_is_ended_and_has_failed(self):
        self.runner.most_silent_s = 0.1
        part = self.part("echo begun; sleep 600")
        self.assertIn("printed nothing", self.runner.run(part, part.command, "x").outcome.broken)

    def test_a_command_that_cannot_be_started_is_a_failure_that_names_it(self):
        part = Part("some", ["/no/such/program"], lambda names: ["/no/such/program"], cwd=str(self.work))
        self.assertIn("/no/such/program", self.runner.run(part, part.command, "x").outcome.broken)


class WhatRunsBesideWhat(unittest.TestCase):
    def lanes(self, play, count=2):
        self.ended = []
        return Lanes(count, play, lambda part, ran: self.ended.append(part.title))

    @staticmethod
    def part(name, alone=False):
        return Part(name, [], None, alone=alone)

    def test_two_parts_run_at_the_same_time(self):
        both = threading.Barrier(2)
        lanes = self.lanes(lambda part, quiet: both.wait(60))
        lanes.run([("build", lambda: [self.part("a"), self.part("b")])])
        self.assertEqual(sorted(self.ended), ["a", "b"])

    def test_a_part_that_is_alone_runs_when_all_others_are_over(self):
        lanes = self.lanes(lambda part, quiet: None)
        lanes.run(
            [
                ("one", lambda: [self.part("counts", alone=True), self.part("a")]),
                ("two", lambda: [self.part("b")]),
            ]
        )
        self.assertEqual(self.ended[-1], "counts")
        self.assertEqual(sorted(self.ended), ["a", "b", "counts"])

    def test_of_two_heavy_parts_one_runs_at_a_time(self):
        busy = threading.Lock()

        def play(part, quiet):
            if part.heavy:
                self.assertTrue(busy.acquire(blocking=False), "two heavy parts at once")
                meets.wait(60)
                busy.release()
            else:
                meets.wait(60)

        # Each heavy part ends only beside a light one.
        meets = threading.Barrier(2)
        lanes = self.lanes(play)
        made = [self.part("a"), self.part("b"), self.part("c"), self.part("d")]
        made[0].heavy = made[1].heavy = True
        lanes.run([("one", lambda: made)])
        self.assertEqual(sorted(self.ended), ["a", "b", "c", "d"])

    def test_parts_of_a_build_run_beside_the_next_build(self):
        ran = threading.Event()
        lanes = self.lanes(lambda part, quiet: ran.set())
        lanes.run([("one", lambda: [self.part("a")]), ("two", lambda: self.assertTrue(ran.wait(60)) or [])])
        self.assertEqual(self.ended, ["a"])

    def test_a_failed_build_keeps_no_other_part_back(self):
        lanes = self.lanes(lambda part, quiet: None)
        lanes.run([("one", lambda: None), ("two", lambda: [self.part("a")])])
        self.assertEqual(self.ended, ["a"])

    def test_a_run_that_is_stopped_begins_nothing_more(self):
        lanes = self.lanes(lambda part, quiet: None, count=1)
        lanes.ended = lambda part, ran: (self.ended.append(part.title), lanes.stop())
        lanes.run(
            [
                ("one", lambda: [self.part("a"), self.part("b"), self.part("c", alone=True)]),
                ("two", lambda: [self.part("d")]),
            ]
        )
        self.assertEqual(self.ended, ["a"])

    def test_nothing_begins_while_a_test_is_played_again(self):
        order, first = [], threading.Event()

        def play(part, quiet):
            if part.title == "again":
                with quiet:
                    first.set()
                    order.append("again begins")
                    order.append("again ends")
            else:
                first.wait(60)
                order.append(part.title)

        lanes = self.lanes(play)
        lanes.run([("build", lambda: [self.part("again"), self.part("a"), self.part("b"), self.part("c")])])
        begins, ends = order.index("again begins"), order.index("again ends")
        self.assertEqual(ends, begins + 1)


class WhatPeopleSee(Stage):
    def results(self):
        self.out = io.StringIO()
        return Suites({"some": 7.0}, Screen(self.out))

    def test_a_suite_is_told_when_its_last_part_ends(self):
        results = self.results()
        parts = [self.part(f"echo '{OK}'"), self.part(f"echo '{OK}'")]
        parts[1].name = "more"
        results.expect("some", parts)
        results.ends(parts[0], self.play(parts[0]), 0)
        self.assertEqual(self.out.getvalue(), "")
        results.ends(parts[1], self.play(parts[1]), 0)
        self.assertRegex(self.out.getvalue(), r"^ok      some +2 tests +\d+ s \(last run 7 s\)\n$")

    def test_a_part_of_which_nothing_was_heard_is_unfinished(self):
        results = self.results()
        parts = [self.part(f"echo '{OK}'"), self.part(f"echo '{OK}'")]
        parts[1].name = "more"
        results.expect("some", parts)
        results.ends(parts[0], self.play(parts[0]), 0)
        self.assertEqual(results.unfinished(), ["some.more"])

    def test_a_part_that_cannot_run_shows_no_figures(self):
        results = self.results()
        part = self.part("exit 1")
        part.cannot_run, part.show = "no browser", "^bench"
        results.expect("some", [part])
        results.ends(part, self.runner.skipped(part), 0)
        self.assertIn("skipped: no browser", self.out.getvalue())

    def test_the_end_of_a_log_is_shown_for_failures(self):
        results = self.results()
        part = self.part("echo 'what happened'; " + self.FAILS)
        results.expect("some", [part])
        results.ends(part, self.runner.run(part, part.command, part.title), 0)
        for text in ("FAILED  b", "what happened", "1 passed, 1 failed"):
            self.assertIn(text, self.out.getvalue())

    def test_a_skipped_suite_says_why(self):
        results = self.results()
        part = self.part("echo 'npm is missing'; exit 77")
        results.expect("some", [part])
        results.ends(part, self.play(part), 0)
        self.assertIn("skipped: npm is missing", self.out.getvalue())
        self.assertEqual(results.total("skipped"), 1)


class TheTable(unittest.TestCase):
    def test_names_of_suites_are_unique(self):
        names = [suite.name for suite in suites.SUITES]
        self.assertEqual(len(names), len(set(names)))

    def test_a_crate_of_the_workspace_is_asked_for_by_name_and_no_other_suite_has_any(self):
        asked = ["workspace.trocar-rt", "links", "workspace.trocar-model"]
        self.assertTrue(all(suites.known(name) for name in asked))
        self.assertEqual(
            suites.apart(asked), (["workspace", "links", "workspace"], ["trocar-rt", "trocar-model"])
        )
        self.assertFalse(any(suites.known(name) for name in ("links.trocar-rt", "workspace.", "nothing")))

    def test_modules_that_count_or_judge_durations_have_a_part_of_their_own(self):
        stage = suites.Stage(planted.ROOT, types.SimpleNamespace(built=lambda name: name, executables=[]))
        for path in sorted((planted.ROOT / "tests/it").glob("*/*.rs")):
            if path.stem in ("counted", "timed"):
                parts = suites.named(path.parent.name).parts(stage)
                self.assertIn(path.stem, [part.name for part in parts], f"{path} would never run")

    def test_a_package_id_names_its_package(self):
        for package_id, name in (
            ("path+file:///x/host/model#trocar-model@0.1.0", "trocar-model"),
            ("path+file:///x/trocar#0.1.0", "trocar"),
        ):
            self.assertEqual(building._package(package_id), name)


class TheEndOfALog(unittest.TestCase):
    def test_a_build_that_failed_shows_what_the_compiler_said_and_not_its_messages_for_programs(self):
        out = io.StringIO()
        with tempfile.NamedTemporaryFile("w", suffix=".log") as log:
            log.write("error[E0063]: missing field\n")
            log.write('{"reason":"compiler-artifact"}\n' * 100)
            log.write("error: could not compile\n")
            log.flush()
            Screen(out).tail(log.name)
        self.assertEqual(
            out.getvalue().splitlines()[1:], ["   error[E0063]: missing field", "   error: could not compile"]
        )


class PlantedFaults(unittest.TestCase):
    """The list of planted.py, beside the sources of today."""

    def setUp(self):
        # While one of them is planted, its text before is away.
        self.faults = [fault for fault in planted.faults() if fault["id"] != os.environ.get("TROCAR_PLANTED")]

    def test_the_text_each_exchanges_is_in_its_file_once(self):
        times = {fault["id"]: planted.occurrences(planted.ROOT, fault) for fault in self.faults}
        self.assertEqual({name: n for name, n in times.items() if n != 1}, {})
        self.assertEqual([fault["id"] for fault in self.faults if fault["old"] == fault["new"]], [])

    def test_each_has_a_name_of_its_own_and_suites_that_exist(self):
        ids = [fault["id"] for fault in self.faults]
        self.assertEqual(len(ids), len(set(ids)))
        unknown = [suite for fault in self.faults for suite in fault["suites"] if not suites.known(suite)]
        self.assertEqual(unknown, [])

    def test_a_build_that_failed_is_no_test_that_found_it(self):
        built = "FAILED  build of tests\n-- the end of /x/build-tests.log\n"
        self.assertEqual(planted.read(built), ("tests", None, None))
        printed = "built   tests\nFAILED  a::b\n-- the end of /x/logs/workspace.trocar.log\n   FAILED  c\n"
        self.assertEqual(planted.read(printed), (None, "a::b", "workspace.trocar"))
        self.assertEqual(planted.read("0 unsteady\n5 passed, 0 failed, 0 skipped\n"), (None, None, None))


class Lines(unittest.TextTestResult):
    """libtest's line for each test."""

    def stopTest(self, test):
        super().stopTest(test)
        bad = any(test is one for one, _ in self.failures + self.errors)
        print(f"test gate::{test.id().removeprefix('__main__.')} ... {'FAILED' if bad else 'ok'}", flush=True)


def main():
    every = unittest.defaultTestLoader.loadTestsFromModule(sys.modules["__main__"])
    tests = {f"gate::{test.id().removeprefix('__main__.')}": test for group in every for test in group}
    names = sys.argv[2:] if sys.argv[1:2] == ["--exact"] else list(tests)
    unknown = [name for name in names if name not in tests]
    if unknown:
        print(f"there is no test {unknown[0]}")
        return 2
    ran = unittest.TextTestRunner(stream=sys.stdout, resultclass=Lines, verbosity=0).run(
        unittest.TestSuite(tests[name] for name in names)
    )
    bad = len(ran.failures) + len(ran.errors)
    print(f"test result: {'FAILED' if bad else 'ok'}. {ran.testsRun - bad} passed; {bad} failed; 0 ignored")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
