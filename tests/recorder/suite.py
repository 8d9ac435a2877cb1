#!/usr/bin/env python3
"""Recordings of the built program, read by the stock Python reader.

    python3 tests/recorder/suite.py [NAME...]            all tests, or those whose name holds one of the words

The canonical load under a recorder is `bench eyesaw/recording`.

Invariant: the program is driven from outside only, and nothing here knows how a recorder works. Prints what libtest prints, since
`tests/run` counts by that; exit 77 when the packages of packages.txt cannot be had.
"""

import argparse
import os
import signal
import sys
import traceback

import away
import endings
import reading
import recording
from world import Skip, enter_venv


def hear_signals():
    """What is begun here hears them, also where this suite was begun in the background: the program honours what its caller ignored."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*")
    args = parser.parse_args()
    enter_venv()
    hear_signals()
    tests = [(name, test) for of in (recording, reading, endings, away) for name, test in vars(of).items() if name.startswith("test_")
             and (not args.names or any(word in name for word in args.names))]
    passed, failed = 0, 0
    for name, test in tests:
        try:
            test()
            word, passed = "ok", passed + 1
        except Skip as why:
            word, passed = "ok", passed + 1
            with open(os.environ.get("TROCAR_SKIPS", os.devnull), "a") as skips:
                skips.write(f"recorder::{name}: {why}\n")
        except Exception:
            traceback.print_exc()
            word, failed = "FAILED", failed + 1
        print(f"test recorder::{name} ... {word}", flush=True)
    print(f"test result: {'FAILED' if failed else 'ok'}. {passed} passed; {failed} failed; 0 ignored")
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
