"""Promise: the session of the documentation, typed into IPython in a terminal, does what it says there."""

import os
import pathlib
import re
import signal
import sys
import threading

import pexpect
import pyte
import pytest

import trocar

from ..conftest import eventually
from .conftest import ROOT, Program

TAB, ENTER, CLEAR = "\t", "\r", "\x15"


class Terminal:
    """A program in a pseudo-terminal, and what its screen shows."""

    def __init__(self, directory, address, *command):
        env = {k: v for k, v in os.environ.items() if not k.startswith("IPYTHON")}
        env.update(
            TROCAR_GCM=address,
            TERM="xterm",
            PROMPT_TOOLKIT_NO_CPR="1",
            IPYTHONDIR=str(directory / "ipython"),
            MPLBACKEND="Agg",
            PAGER="cat",
            NO_COLOR="1",
            HOME=str(directory),
        )
        self.screen = pyte.HistoryScreen(180, 400, history=4000)
        self.stream = pyte.Stream(self.screen)
        self.child = pexpect.spawn(
            sys.executable, list(command), cwd=str(directory), env=env, dimensions=(400, 180), encoding="utf-8", timeout=60
        )
        self.lock = threading.Lock()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self):
        while True:
            try:
                text = self.child.read_nonblocking(65536, timeout=60)
            except pexpect.TIMEOUT:
                continue
            except (pexpect.EOF, OSError):
                return
            with self.lock:
                self.stream.feed(text)

    def text(self):
        with self.lock:
            return "\n".join(line.rstrip() for line in self.screen.display).rstrip()

    def see(self, what, pattern):
        def look():
            text = self.text()
            assert re.search(pattern, text, re.M), f"the screen shows:\n{text[-4000:]}"
            return text

        return eventually(what, look)

    def prompt(self, number):
        return self.see(f"the prompt In [{number}]", rf"^In \[{number}\]: *$")

    def run(self, number, *lines):
        """Types lines at the prompt of that number, and answers what the screen shows between it and the next prompt."""
        self.prompt(number)
        for line in lines:
            self.child.send(line + ENTER)
        # A block waits for an empty line; at a prompt an empty line does nothing.
        if lines[-1].startswith((" ", "def ", "with ")) or len(lines) > 1:
            self.see("the block was taken", re.escape(lines[-1][:60]))
            self.child.send(ENTER)
        text = self.prompt(number + 1)
        return text.rpartition(f"In [{number}]:")[2].rpartition(f"In [{number + 1}]:")[0]

    def complete(self, text, seen):
        """Types and presses TAB until the screen is as it should be: a pattern, or a function of what is
        shown. As people do, it presses TAB once more where nothing came of it (the system did not answer in
        time).
        """
        looks = [0]

        def look():
            if looks[0] % 300 == 0:
                self.child.send(CLEAR + text + TAB)
            looks[0] += 1
            shown = self.text()
            found = seen(shown) if callable(seen) else re.search(seen, shown, re.M)
            assert found, f"the screen shows:\n{shown[-2000:]}"
            return shown

        return eventually(f"{text} is completed", look)

    def end(self):
        if self.child.isalive():
            self.child.kill(signal.SIGKILL)
            eventually("the terminal's program has ended", lambda: not self.child.isalive())


@pytest.fixture
def terminal(tmp_path):
    made = []

    def make(address, *command, files=()):
        for file in files:
            (tmp_path / file.name).write_bytes(file.read_bytes())
        made.append(Terminal(tmp_path, address, *command))
        return made[-1]

    yield make
    for t in made:
        t.end()


def written_session(text):
    """What is typed at prompts in a block of a document: number, lines, what ``->`` says beside them, and what is written below."""
    session = []
    for line in text.splitlines():
        typed = re.match(r"In \[(\d+)\]: (.*?)(?:\s{2,}->\s+(.*))?$", line)
        if typed:
            session.append((int(typed[1]), [typed[2]], typed[3] or "", []))
        elif session and line.startswith("   ...: "):
            session[-1][1].append(line[len("   ...: ") :])
        elif session:
            session[-1][3].append(line)
    return session


def one_line(text):
    return " ".join(text.split())


def test_the_session_of_the_documentation_runs_as_it_is_written(system, ire, server, terminal, tmp_path):
    block = next(b for b in (ROOT / "docs/PYTHON.md").read_text().split("```\n") if b.startswith("In [1]: "))
    session = {n: told for n, *told in written_session(block)}
    # The numbers that it leaves out are looks at what there is.
    between = {2: "ire.tree", 4: "r", 11: "p = _10", 13: "ire.process"}
    assert sorted([*session, *between]) == list(range(1, 16)) and sum(len(typed) for typed, _, _ in session.values()) == 12, session
    assert session[5][0] == ["r.<TAB>"] and "ire.record" in session[12][0][0], session
    recorded = "recorder" not in system.missing
    if not recorded:
        session[12] = ["'no recorder was built'"], "", []
    server.Write(0)
    t = terminal(system.address, "-m", "IPython", "--no-banner", "--no-confirm-exit", files=[system.directory / "bscan.json"])
    shown = {}
    for number in range(1, 16):
        typed, beside, below = session.get(number, ([between.get(number)], "", []))
        if number == 5:
            t.prompt(5)

            def offered(text):
                return set(text.rpartition("In [5]:")[2].split("\n", 1)[-1].split())

            t.complete("r.", lambda text, beside=beside: offered(text) == set(beside.split()))
            t.child.send(CLEAR)
            typed, beside = ["r.Read()"], ""
        shown[number] = t.run(number, *typed)
        assert ("Error" in shown[number]) == any("Error" in line for line in below), shown[number]
        for told in (*below, *re.split(r"\s{3,}", beside)):
            assert one_line(told) in one_line(shown[number]), (told, shown[number])
        if number == 9:
            server.Write(55)
            t.see("the handler printed", r"reached 55 mm")
    # What is written of no line is asked of it all the same.
    assert "EyeRobot" in shown[2] and "0 mm" in shown[5] and "ire" in shown[13]
    assert re.search(r"ProcessServer/Server/Provided, connected as ire\d*/shell/Provided", shown[4])
    assert re.search(r"plot of robot/EyeRobot/Arm/measured_js\.position\[0\] \(m\|rad\) over 10 s", shown[10]), shown[10]
    assert "Apply, would be done:" in shown[14] and "+ create robot/robot" in shown[14] and "+ connect" in shown[14], shown[14]
    assert re.search(r"Out\[15\]: 55 mm$", shown[15], re.M), shown[15]
    if recorded:
        file = trocar.read(system.directory / "trial7.mcap")
        assert file.complete and {name.split("/")[1] for name in file} >= {"robot", "oct"}, list(file)
    t.child.send("exit()" + ENTER)
    eventually("IPython has ended", lambda: not t.child.isalive())

    def shells():
        return [p for p in ire._graph.processes if p.startswith("ire")]

    eventually("the shell is gone from the graph", lambda: shells() == [ire.process], progress=shells)
    if not recorded:
        pytest.skip("In [12], the recording: the recorder plugin was not built; the rest of the session ran")


def without_figures(text):
    """Numbers, and how they stand in lines, are those of whoever wrote them down."""
    text = re.sub(r"\[[-+.\de\s]*\]", "[]", text)
    return " ".join(re.sub(r"-?\d+(\.\d+)?(e[-+]\d+)?", "0", text).split())


def test_the_session_of_the_tour_runs_against_the_demo_it_starts(system, terminal, tmp_path):
    told = (ROOT / "docs/TOUR.md").read_text().partition("## From Python")[2].partition("```console\n")[2].partition("```")[0]
    assert told.startswith("$ trocar demo "), "it begins with the system that it needs"
    session = written_session(told)
    assert [n for n, *_ in session] == [1, 2, 3, 4], session
    demo = Program(tmp_path, "demo", "demo", "--listen", "127.0.0.1:0", "--plugins", system.plugins)
    try:
        t = terminal(demo.address(r"listening on (127\.0\.0\.1:\d+)"), "-m", "trocar.ire")
        for number, typed, _, below in session:
            shown = t.run(number, *typed)
            assert ("TrocarError" in shown) == any("TrocarError" in line for line in below), shown
            assert without_figures("\n".join(below)) in without_figures(shown), (below, shown)
        assert (tmp_path / "python-plot.png").read_bytes().startswith(b"\x89PNG")
        t.child.send("exit()" + ENTER)
        eventually("IPython has ended", lambda: not t.child.isalive())
    finally:
        demo.end()


def test_trocar_ire_starts_connected_and_completes_live_names_and_paths(system, terminal):
    t = terminal(system.address, "-m", "trocar.ire", "--name", "shell-under-test")
    t.see("the greeting", r"seen there as shell-under-test")
    t.prompt(1)
    t.complete("ire.robot.Ey", r"In \[1\]: ire\.robot\.EyeRobot")
    t.complete("ire.robot.EyeRobot.Arm.meas", r"ire\.robot\.EyeRobot\.Arm\.measured_js")
    t.child.send("()" + ENTER)
    t.see("its value is shown with its unit", r"position .*m\|rad")
    t.prompt(2)
    t.complete('ire.latest("robot/EyeRobot/pos', r'ire\.latest\("robot/EyeRobot/position')
    t.child.send(CLEAR)
    t.run(2, "help(ire.ProcessServer.Server.Provided.Write)")
    assert "Sets the set point (mm), 0..100" in t.text()
    t.child.send("exit()" + ENTER)
    eventually("it has ended", lambda: not t.child.isalive())


def test_trocar_ire_runs_code_and_says_when_there_is_no_gcm(system, tmp_path):
    command = pathlib.Path(sys.executable).with_name("trocar-ire")
    options = {"timeout": None, "encoding": "utf-8", "cwd": str(tmp_path)}
    out = pexpect.run(f"{command} --gcm {system.address} -c 'print(ire.connected)'", **options)
    assert "True" in out, out
    out, status = pexpect.run(f"{command} --gcm 127.0.0.1:1", withexitstatus=True, **options)
    assert status == 3 and "GCM_UNREACHABLE" in out and "127.0.0.1:1" in out, (status, out)
