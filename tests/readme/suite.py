#!/usr/bin/env python3
"""The README and the tour, typed in: each section's commands, in one directory, as a newcomer types them from the first line on.

    python3 tests/readme/suite.py                  all sections
    python3 tests/readme/suite.py --exact NAME...  only these, named as their lines `test NAME ... ok` name them

Blocks of `sh` are run whole by bash, and have to succeed; one that ends in `trocar demo` or `trocar host` is a terminal of its own and ends by
Ctrl-C with its section. Of blocks of `console` each line behind `$ ` is run, and the lines below it have to be in what it says, at once or
when it is typed again. What a sentence names in passing (`trocar help`) is not run: its subcommand and its flags have to exist.

Invariant: no command of these pages is left out but those of NOT_HERE, each with its reason; what cannot be had is said and counted as skipped.
"""

import os
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback

ROOT = pathlib.Path(__file__).resolve().parents[2]
TARGET = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
BIN = pathlib.Path(os.environ.get("TROCAR_BIN_DIR", TARGET / "release"))
# A program that says nothing for so long hangs, s.
STANDSTILL_S = 120
LISTENS = re.compile(r"listening|127\.0\.0\.1:\d+")
STAYS = re.compile(r"^trocar (demo|host)\b")
# The gate itself is the test of these.
NOT_HERE = {
    "cargo build --release": "the gate has built it so",
    "./tests/run": "this suite is a part of it",
}
# Pages that are typed whole, in this order: what a section makes, later ones use.
PAGES = ["README.md", "docs/TOUR.md"]
# Sections of other pages that are typed behind those.
ELSEWHERE = {"docs/RECORDER.md": "As a component"}
# A prompt of Python is typed by the suite `python`, which reads the same block.
PROMPT = "In [1]:"


def sections(text):
    """Each heading of one or two # with its fenced blocks: (heading, [(language, lines)])."""
    found = []
    for part in re.split(r"^##? ", text, flags=re.M)[1:]:
        heading, _, body = part.partition("\n")
        blocks = [(kind, code.splitlines()) for kind, code in re.findall(r"^```(sh|console)\n(.*?)^```", body, re.M | re.S)]
        if blocks:
            found.append((heading, blocks))
    return found


def in_passing(text):
    """The commands of trocar that sentences name, without their values: (command, its words, its flags)."""
    prose = re.sub(r"^```.*?^```", "", text, flags=re.M | re.S)
    found = {}
    for span in re.findall(r"`([^`]+)`", prose):
        command = re.sub(r"^source <\((.*)\)$", r"\1", " ".join(span.split()))
        if command.startswith("trocar "):
            words = command.split()[1:]
            flags = [word.partition("=")[0] for word in words if word.startswith("-")]
            found[command] = ([word for word in words if not word.startswith("-")], flags)
    return found


def name_of(heading):
    return "readme::" + re.sub(r"\W+", "_", heading.lower()).strip("_")


def sources():
    """What a newcomer finds in a fresh clone: not what was typed there since, such as the tour's files."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    if listed.returncode == 0:
        return sorted({path.split("/")[0] for path in listed.stdout.split("\0") if path})
    return sorted(entry.name for entry in ROOT.iterdir() if entry.name not in (".git", "target"))


class Terminal:
    """A directory that looks like the sources, in a network of its own, and what was begun in it."""

    def __init__(self, directory):
        self.directory = directory
        self.staying = []
        for name in sources():
            (directory / name).symlink_to(ROOT / name)
        (directory / "target").mkdir()
        (directory / "target" / "release").symlink_to(BIN)
        self.env = {k: v for k, v in os.environ.items() if not k.startswith(("TROCAR_", "CARGO_"))}
        self.env.update(
            PATH=f"{BIN}:{pathlib.Path(os.environ['GRPCURL']).parent}:{os.environ['PATH']}",
            XDG_STATE_HOME=str(directory / ".state"),
            NO_COLOR="1",
            # A plugin is built to be loaded, not to be fast.
            CARGO_PROFILE_RELEASE_OPT_LEVEL="0",
            # Its crates are those that the host was built of.
            CARGO_NET_OFFLINE="true",
            CARGO_BUILD_BUILD_DIR=str(TARGET / "outer" / "readme-build"),
        )
        if "CARGO_HOME" in os.environ:
            self.env["CARGO_HOME"] = os.environ["CARGO_HOME"]
        # All sections are typed into one namespace of their own: the README's port is free there.
        self.holder = subprocess.Popen([*APART, "sh", "-c", "ip link set lo up && echo up && exec sleep infinity"], stdout=subprocess.PIPE, text=True)
        if self.holder.stdout.readline() != "up\n":
            raise Skip("no network namespace can be made, and the README's port may be in use")

    def inside(self, *command):
        return ["nsenter", "--preserve-credentials", "-U", "-n", "-t", str(self.holder.pid), *command] if USER else ["nsenter", "-n", "-t", str(self.holder.pid), *command]

    def run(self, script, judged=True):
        done = subprocess.run(
            self.inside("bash", "-e", "-c", script), cwd=self.directory, env=self.env, text=True, stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, timeout=None,
        )
        if judged and done.returncode:
            raise AssertionError(f"{script}\nended with {done.returncode}:\n{done.stdout[-3000:]}")
        return done.stdout

    def begin(self, script):
        log = open(self.directory / f".terminal{len(self.staying)}", "w+")
        child = subprocess.Popen(self.inside("bash", "-e", "-c", f"exec {script}"), cwd=self.directory, env=self.env, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        self.staying.append((child, log, script))
        said, since = "", time.monotonic()
        while not LISTENS.search(said):
            if child.poll() is not None:
                raise AssertionError(f"{script} ended with {child.returncode}:\n{said[-3000:]}")
            now = pathlib.Path(log.name).read_text()
            if now != said:
                said, since = now, time.monotonic()
            elif time.monotonic() - since > STANDSTILL_S:
                raise AssertionError(f"{script} says nothing of where it listens:\n{said[-3000:]}")
            time.sleep(0.05)

    def end(self):
        wrong = []
        for child, log, script in self.staying:
            child.send_signal(signal.SIGINT)
            try:
                child.wait(STANDSTILL_S)
            except subprocess.TimeoutExpired:
                child.kill()
            if child.wait() != 0:
                wrong.append(f"{script} ended with {child.returncode} after Ctrl-C:\n{pathlib.Path(log.name).read_text()[-3000:]}")
        self.staying.clear()
        if wrong:
            raise AssertionError("\n".join(wrong))

    def close(self):
        for child, _, _ in self.staying:
            child.kill()
            child.wait()
        self.holder.kill()
        self.holder.wait()


class Skip(Exception):
    """Why nothing can be typed here."""


USER = os.geteuid() != 0
APART = ["unshare", "--map-root-user", "--user", "--net"] if USER else ["unshare", "--net"]


def typed(terminal, blocks):
    for kind, lines in blocks:
        if any(line.startswith(PROMPT) for line in lines):
            continue
        lines = [line for line in lines if line not in NOT_HERE]
        if kind == "console":
            console(terminal, lines)
        elif lines and STAYS.match(lines[-1]):
            if lines[:-1]:
                terminal.run("\n".join(lines[:-1]))
            terminal.begin(lines[-1])
        elif lines:
            terminal.run("\n".join(lines))


def exist(terminal, commands):
    """Each command is one that `trocar help` knows, with the flags it is given."""
    for command, (words, flags) in commands.items():
        first, *more = words
        said = terminal.run(f"trocar help {first}")
        # `plugin new`: a subcommand that has some of its own lists them.
        if more and re.search(r"^Commands:", said, re.M):
            said = terminal.run(f"trocar help {first} {more[0]}")
        missing = [flag for flag in flags if not re.search(rf"(^|[ ,]){re.escape(flag)}(?![\w-])", said, re.M)]
        if missing:
            raise AssertionError(f"`{command}`: there is no {', '.join(missing)} in\n{said}")


def shown(line, said):
    """Whether what was said has this line, whatever its blanks; … stands for any text of one word."""
    wanted = re.escape(" ".join(line.split())).replace("…", r"\S*")
    return re.search(wanted, " ".join(said.split())) is not None


def console(terminal, lines):
    for asked in re.split(r"^[$] ", "\n".join(lines), flags=re.M)[1:]:
        command, *wanted = asked.splitlines()
        last, since = "", time.monotonic()
        while True:
            said = terminal.run(command, judged=not wanted)
            missing = [line for line in wanted if not shown(line, said)]
            if not missing:
                break
            if said != last:
                last, since = said, time.monotonic()
            elif time.monotonic() - since > STANDSTILL_S / 4:
                raise AssertionError(f"{command}\ndoes not say {missing}, but\n{said[-3000:]}")
            time.sleep(0.2)


def main():
    exact = "--exact" in sys.argv[1:]
    words = [word for word in sys.argv[1:] if word != "--exact"]
    means = (lambda word, name: word == name) if exact else (lambda word, name: word in name)
    asked = lambda name: not words or any(means(word, name) for word in words)
    text = "\n".join((ROOT / page).read_text(encoding="utf-8") for page in PAGES)
    found = {name_of(heading): (typed, blocks) for heading, blocks in sections(text)}
    for page, heading in ELSEWHERE.items():
        blocks = dict(sections((ROOT / page).read_text(encoding="utf-8")))[heading]
        found[name_of(f"{pathlib.Path(page).stem} {heading}")] = (typed, blocks)
    found[name_of("What sentences name")] = (exist, in_passing(text))
    if unknown := [word for word in words if not any(means(word, name) for name in found)]:
        print(f"suite.py: no section is called {', '.join(unknown)}", file=sys.stderr)
        sys.exit(2)
    if not os.environ.get("GRPCURL"):
        print("grpcurl is missing: set GRPCURL")
        sys.exit(77)
    for tool in ("unshare", "nsenter", "ip"):
        if not shutil.which(tool):
            print(f"{tool} is missing, which gives the README's port to these tests alone")
            sys.exit(77)
    passed, failed = 0, 0
    with tempfile.TemporaryDirectory(prefix="trocar-readme-") as directory:
        terminal = Terminal(pathlib.Path(directory))
        try:
            last = max((i for i, name in enumerate(found) if asked(name)), default=-1)
            for i, (name, (follow, blocks)) in enumerate(found.items()):
                if i > last:
                    break
                why = ""
                try:
                    try:
                        follow(terminal, blocks)
                    finally:
                        terminal.end()
                    word = "ok"
                except Exception:
                    word, why = "FAILED", traceback.format_exc()
                # Earlier sections are typed for those that were asked for, and do not count.
                if asked(name):
                    passed, failed = passed + (word == "ok"), failed + (word != "ok")
                    print(f"test {name} ... {word}", flush=True)
                if why:
                    print(why, flush=True)
        finally:
            terminal.close()
    print(f"test result: {'FAILED' if failed else 'ok'}. {passed} passed; {failed} failed; 0 ignored")
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    try:
        main()
    except Skip as why:
        print(why)
        sys.exit(77)
