#!/usr/bin/env python3
"""Judges the thread sanitizer itself: it has to report each race of races.rs, and nothing in the orderly cases.

    python3 tests/tsan/judge.py PROGRAM [--exact NAME...]      PROGRAM is the built races.rs

Each case is a process, since a report ends in its status. Prints libtest's lines.
"""

import subprocess
import sys

REPORTED = 66  # TSAN_OPTIONS=exitcode=66


def main():
    program, *rest = sys.argv[1:]
    told = subprocess.run([program], capture_output=True, text=True, check=True).stdout.split("\n")
    cases = {f"tsan_judged::{kind}::{name}": (kind, name) for kind, name in (line.split() for line in told if line.strip())}
    names = rest[1:] if rest[:1] == ["--exact"] else list(cases)
    unknown = [name for name in names if name not in cases]
    if unknown or not cases:
        print(f"no case is called {', '.join(unknown) or 'anything'}; there are {', '.join(cases)}")
        return 2
    failed = []
    for full in names:
        kind, name = cases[full]
        ended = subprocess.run([program, name], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        said = {REPORTED: "race", 0: "order"}.get(ended.returncode, f"status {ended.returncode}")
        good = said == kind
        print(f"test {full} ... {'ok' if good else 'FAILED'}", flush=True)
        if not good:
            failed.append(full)
            print(f"-- {name} is a case of {kind}, and ended as {said}:\n{ended.stdout}")
    print(f"test result: {'FAILED' if failed else 'ok'}. {len(names) - len(failed)} passed; {len(failed)} failed; 0 ignored")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
