#!/usr/bin/env python3
"""Plants the faults of planted.json, one after another, and tells which tests find each of them.

  python3 tests/gate/planted.py                       all faults that have no result yet for this commit
  python3 tests/gate/planted.py ID...                 only these, again
  python3 tests/gate/planted.py [ID...] -- ARGUMENTS  each with `./tests/run --until-failure ARGUMENTS`, and nothing else

Without ARGUMENTS a fault's own suites run first, one after another, and the whole gate where these do not find it. Everything happens in a clone of HEAD
under target/planted, with one target directory for all faults. A control without a fault runs first and has to pass.

Results are kept in target/planted/results.json. A table is printed at the end. The status is 0 when every fault was found.

Invariant: a fault is planted in the clone alone and taken out before the next one; what does not compile counts as a mistake of the list,
never as found.
"""

import json
import os
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
LIST = pathlib.Path(__file__).with_name("planted.json")
# A run hangs when it takes so many seconds, and longer than so many times the control.
LONGEST = 1800
TIMES_THE_CONTROL = 3
# Seconds a run gets to end its processes.
ENDING = 60

FAILED = re.compile(r"^FAILED  (.+)$")
BUILD = re.compile(r"^build of (\w+)$")
LOG = re.compile(r"^-- the end of .*/([^/]+)\.log$")
MANY = re.compile(r"^more than \d+ unsteady tests")


def faults():
    """The list: of each fault its id, where it is, the text before and after, what a user would suffer, the suites that should find it."""
    return json.loads(LIST.read_text(encoding="utf-8"))


def occurrences(root, fault):
    """How often the text that is exchanged stands in its file; once is right."""
    path = root / fault["file"]
    return path.read_text(encoding="utf-8").count(fault["old"]) if path.is_file() else 0


def read(printed):
    """What a run printed: (the build that failed, the first test that failed and the part it belongs to)."""
    lines = printed.splitlines()
    for number, line in enumerate(lines):
        failed = FAILED.match(line)
        if not failed:
            continue
        build = BUILD.match(failed.group(1))
        if build:
            return build.group(1), None, None
        logs = (LOG.match(later) for later in lines[number:])
        return None, failed.group(1), next((log.group(1) for log in logs if log), "")
    if any(MANY.match(line) for line in lines):
        return None, "more unsteady tests than a run may have", ""
    return None, None, None


class Field:
    """The clone in which faults are planted."""

    def __init__(self, root, work):
        self.root = root
        self.tree = work / "tree"
        self.target = work / "target"
        self.logs = work / "logs"
        self.logs.mkdir(parents=True, exist_ok=True)
        self.commit = self._git("rev-parse", "HEAD", cwd=root)

    def prepare(self):
        """The clone is at HEAD, as it was committed. What is compiled stays."""
        if not (self.tree / ".git").exists():
            shutil.rmtree(self.tree, ignore_errors=True)
            self._git("clone", "--quiet", "--no-checkout", str(self.root), str(self.tree), cwd=self.root)
        self._git("fetch", "--quiet", str(self.root), "HEAD")
        self._git("checkout", "--quiet", "--force", "--detach", self.commit)
        self.restore()

    def plant(self, fault):
        """Exchanges the text, and builds the page anew where the fault is in its sources; answers what is wrong with the list, if anything."""
        found = occurrences(self.tree, fault)
        if found != 1:
            return f"the text before is there {found} times in {fault['file']}"
        path = self.tree / fault["file"]
        path.write_text(
            path.read_text(encoding="utf-8").replace(fault["old"], fault["new"]), encoding="utf-8"
        )
        return "" if not fault.get("page") or self._build_page(fault) else "the page does not build"

    def restore(self):
        """Takes out what was planted. Files get the time of now, so that cargo compiles them again."""
        self._git("checkout", "--quiet", "--force", "--", ".")
        # Ignored files stay: the packages of the page, for one.
        self._git("clean", "--quiet", "--force", "-d")

    def run(self, name, arguments, seconds, planted=""):
        """One run of the tests; answers (status, what it printed, seconds). The status is `None` where it had to be ended."""
        env = {**os.environ, "CARGO_TARGET_DIR": str(self.target), "TROCAR_PLANTED": planted}
        log = self.logs / f"{name}.log"
        began = time.monotonic()
        with open(log, "wb") as out:
            command = ["./tests/run", "--until-failure", *arguments]
            child = subprocess.Popen(
                command,
                cwd=self.tree,
                env=env,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
            try:
                status = child.wait(seconds)
            except subprocess.TimeoutExpired:
                status = None
            finally:
                self._end(child)
        return status, log.read_text(errors="replace"), round(time.monotonic() - began)

    def _build_page(self, fault):
        """As tests/viewer/dist.sh does it."""
        with open(self.logs / f"{fault['id']}.page.log", "wb") as log:
            where = {
                "cwd": self.tree / "host/web",
                "stdin": subprocess.DEVNULL,
                "stdout": log,
                "stderr": subprocess.STDOUT,
            }
            return all(
                subprocess.run(command, **where).returncode == 0
                for command in (["npm", "ci"], ["npm", "run", "build"])
            )

    @staticmethod
    def _end(child):
        """Ends a run that still goes on: first kindly, for then it ends the processes it has started."""
        if child.poll() is not None:
            return
        child.terminate()
        try:
            child.wait(ENDING)
        except subprocess.TimeoutExpired:
            pass
        try:
            os.killpg(child.pid, signal.SIGKILL)
        except ProcessLookupError:
            pass
        child.wait()

    def _git(self, *words, cwd=None):
        # A clone of a work tree is no part of it, whatever git says where this runs from a hook.
        env = {
            name: value
            for name, value in os.environ.items()
            if name not in ("GIT_DIR", "GIT_WORK_TREE", "GIT_INDEX_FILE")
        }
        return subprocess.run(
            ["git", *words], cwd=cwd or self.tree, env=env, check=True, stdout=subprocess.PIPE, text=True
        ).stdout.strip()


class Planting:
    """Runs the control and the faults, and keeps what they come to."""

    def __init__(self, field, book, arguments):
        self.field = field
        self.book = book
        self.arguments = arguments
        self.kept = self._kept()
        self.results = self.kept["runs"].setdefault(" ".join(arguments), {"control": {}, "faults": {}})

    def control(self):
        """Whether the tests pass without a fault; asked once for each commit and choice of arguments."""
        if self.results["control"].get("status") == 0:
            return True
        say("control: without a fault")
        status, printed, seconds = self.field.run("control", self.arguments, None)
        self.results["control"] = {"status": status, "seconds": seconds}
        self._keep()
        if status:
            print("\n".join(printed.splitlines()[-40:]))
        return status == 0

    def plant(self, fault):
        """Plants one fault and runs the tests until one fails."""
        say(f"{fault['id']}: {fault['file']}")
        result = {"verdict": "not found", "test": "", "part": "", "seconds": 0}
        try:
            wrong = self.field.plant(fault)
            if wrong:
                result |= {"verdict": "wrong list", "test": wrong}
            else:
                self._seek(fault, result)
        finally:
            self.field.restore()
        self.results["faults"][fault["id"]] = result
        self._keep()
        say(f"{fault['id']}: {result['verdict']} {result['test']} ({result['seconds']} s)")

    def _seek(self, fault, result):
        rounds = [self.arguments] if self.arguments else [*([suite] for suite in fault["suites"]), []]
        longest = max(LONGEST, TIMES_THE_CONTROL * self.results["control"]["seconds"])
        for number, arguments in enumerate(rounds):
            status, printed, seconds = self.field.run(
                f"{fault['id']}.{number}", arguments, longest, fault["id"]
            )
            result["seconds"] += seconds
            if status == 0:
                continue
            build, test, part = read(printed)
            if status is None:
                result |= {"verdict": "found", "test": f"a run that did not end within {longest} s"}
            elif build:
                result |= {"verdict": "does not compile", "test": f"build of {build}"}
            elif test:
                result |= {"verdict": "found", "test": test, "part": part}
            else:
                result |= {
                    "verdict": "wrong list",
                    "test": (printed.strip().splitlines() or ["the run said nothing"])[-1],
                }
            return

    def _kept(self):
        """What is known of this commit, by arguments; nothing of any other."""
        try:
            old = json.loads(self.book.read_text())
            if old["commit"] == self.field.commit and isinstance(old["runs"], dict):
                return old
        except (OSError, ValueError, LookupError, TypeError):
            pass
        return {"commit": self.field.commit, "runs": {}}

    def _keep(self):
        self.book.write_text(json.dumps(self.kept, indent=1) + "\n")


def table(listed, results):
    """The results in Markdown."""
    lines = ["| fault | where | what a user would suffer | found by | time |", "|---|---|---|---|---|"]
    done = [(fault, results[fault["id"]]) for fault in listed if fault["id"] in results]
    for fault, result in done:
        test = (
            f"`{result['test']}`"
            if result["verdict"] == "found"
            else f"**{result['verdict']}** {result['test']}".strip()
        )
        by = f"{result['part']}: {test}" if result["part"] else test
        lines.append(
            f"| {fault['id']} | `{fault['file']}` | {fault['harm']} | {by} | {result['seconds']} s |"
        )
    found = sum(result["verdict"] == "found" for _, result in done)
    return "\n".join([*lines, "", f"{found} of {len(done)} found"])


def say(text):
    print(f"{time.strftime('%H:%M:%S')} {text}", flush=True)


def main(words):
    if words[:1] in (["-h"], ["--help"]):
        print(__doc__)
        return 0
    at = words.index("--") if "--" in words else len(words)
    ids, arguments = words[:at], words[at + 1 :]
    listed = faults()
    known = [fault["id"] for fault in listed]
    unknown = [one for one in ids if one not in known]
    if unknown:
        print(f"planted: there is no fault '{unknown[0]}'; there are {', '.join(known)}", file=sys.stderr)
        return 2
    work = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", "target"))
    work = (work if work.is_absolute() else ROOT / work) / "planted"
    field = Field(ROOT, work)
    field.prepare()
    planting = Planting(field, work / "results.json", arguments)
    if not planting.control():
        print("planted: the control does not pass, so nothing can be said of faults", file=sys.stderr)
        return 1
    for fault in listed:
        if fault["id"] in ids or (not ids and fault["id"] not in planting.results["faults"]):
            planting.plant(fault)
    print()
    print(table(listed, planting.results["faults"]))
    asked = ids or known
    return 0 if all(planting.results["faults"][one]["verdict"] == "found" for one in asked) else 1


if __name__ == "__main__":
    # Whoever breaks it off leaves neither processes nor a planted fault behind.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    try:
        sys.exit(main(sys.argv[1:]))
    except KeyboardInterrupt:
        sys.exit(130)
