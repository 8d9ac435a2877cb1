#!/usr/bin/env python3
"""Recordings of the built program, read by the stock Python reader.

    python3 tests/recorder/suite.py                      all tests but those that judge durations
    python3 tests/recorder/suite.py --times              only tests that judge durations
    python3 tests/recorder/suite.py WORD...              those of all tests whose name holds one of the words
    python3 tests/recorder/suite.py --exact NAME...      only these tests, named as their lines `test NAME ... ok` name them

The canonical load under a recorder is `bench eyesaw/recording`.

Invariant: the program is driven from outside only, and nothing here knows how a recorder works. Prints what libtest prints, since
`tests/run` counts by that; exit 2 when there is no test of a name, 77 when the packages of packages.txt cannot be had.
"""

import argparse
import os
import signal
import sys
import traceback

import away
import endings
import files
import reading
import recording
import times
from world import Skip, enter_venv


def hear_signals():
    """What is begun here hears them, also where this suite was begun in the background: the program honours what its caller ignored."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def chosen(args, tests):
    """The tests that were asked for, by name."""
    wanted = {*(args.exact or ()), *args.words}
    if unknown := [word for word in wanted if not any(word == name or not args.exact and word in name for name in tests)]:
        print(f"suite.py: no test is called {', '.join(sorted(unknown))}", file=sys.stderr)
        sys.exit(2)
    if args.exact:
        return {name: test for name, test in tests.items() if name in wanted}
    judges = {name for name, test in tests.items() if test.__module__ == times.__name__}
    if args.times or not wanted:
        tests = {name: test for name, test in tests.items() if (name in judges) == args.times}
    return {name: test for name, test in tests.items() if not wanted or any(word in name for word in wanted)}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("words", nargs="*", metavar="WORD")
    parser.add_argument("--exact", nargs="+", metavar="NAME")
    parser.add_argument("--times", action="store_true")
    args = parser.parse_args()
    tests = chosen(args, {f"recorder::{name}": test for of in (recording, files, reading, endings, away, times) for name, test in vars(of).items()
                          if name.startswith("test_")})
    enter_venv()
    hear_signals()
    passed, failed = 0, 0
    for name, test in tests.items():
        try:
            test()
            word, passed = "ok", passed + 1
        except Skip as why:
            word, passed = "ok", passed + 1
            with open(os.environ.get("TROCAR_SKIPS", os.devnull), "a") as skips:
                skips.write(f"{name}: {why}\n")
        except Exception:
            traceback.print_exc()
            word, failed = "FAILED", failed + 1
        print(f"test {name} ... {word}", flush=True)
    print(f"test result: {'FAILED' if failed else 'ok'}. {passed} passed; {failed} failed; 0 ignored")
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
