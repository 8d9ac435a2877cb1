"""The table of suites: what each one is, when it runs, how its processes are started and started again.

Invariant: what is not in this table does not run; a file of tests/it without a row ends every run with its
name.
"""

import dataclasses
import os
import pathlib
import re
import sys
from typing import Callable

from parts import ALL, GATE, TIMES, Part


@dataclasses.dataclass(frozen=True)
class Suite:
    """A row of the table."""

    name: str
    about: str
    build: str  # what makes its executables: "programs", "tests", "loom", "tsan", "bench"
    parts: Callable  # Stage -> parts, asked when that is built
    drives: bool = True  # it runs the built program or its plugins
    only: str = ""  # all its parts run in these runs alone, so that in others nothing is built for it


@dataclasses.dataclass
class Stage:
    """What there is to run, for those who start processes."""

    root: pathlib.Path
    workshop: object
    everything: bool = False  # --all
    torture_args: list = dataclasses.field(default_factory=list)
    no_grpcurl: str = ""
    no_etcd: str = ""
    no_cpp: str = ""

    @property
    def harness(self):
        """The executable of tests/it."""
        return self.workshop.built("it")


# -- one process in Rust -------------------------------------------------------------------------------------

COUNTED, TIMED = "::counted::", "::timed::"


def outer(name, about, threads=2, counted=False, timed=False, grpcurl=True, cpp=False, heavy=False):
    """A file of tests/it. Its module `counted` counts cycles and runs alone; its module `timed` judges
    durations.
    """

    def parts(stage):
        missing = (grpcurl and stage.no_grpcurl) or (cpp and stage.no_cpp) or ""

        def part(label, *words, one_by_one=False, **more):
            command = [stage.harness, *words, f"--test-threads={1 if one_by_one else threads}"]
            return in_harness(stage, name, command, label, cannot_run=missing, **more)

        made = [part("", f"{name}::", "--skip", COUNTED, "--skip", TIMED, heavy=heavy)]
        if counted:
            made.append(part("counted", f"{name}{COUNTED}", one_by_one=True, alone=True))
        if timed:
            words = (f"{name}{TIMED}", "--show-output")
            made.append(part("timed", *words, one_by_one=True, alone=True, when=TIMES, show=FIGURES))
        return made

    return Suite(name, about, "tests", parts)


def in_harness(stage, suite, command, label, **more):
    return Part(suite, command, exactly(command[0]), label, cwd=str(stage.root / "tests"), **more)


def exactly(executable):
    """libtest runs these tests, one after another."""
    return lambda names: [executable, "--exact", *names, "--test-threads=1"]


def workspace(stage):
    """One process for each test executable, and one for the examples in the documentation."""
    env = {"LD_LIBRARY_PATH": stage.workshop.libraries()}
    made = [
        Part(
            "workspace",
            [one.path, *(NOT_THERE if one.title == "trocar" else [])],
            exactly(one.path),
            one.title,
            cwd=one.cwd,
            env=env,
        )
        for one in stage.workshop.executables
    ]
    command, env = stage.workshop.doc_tests()
    made.append(
        Part(
            "workspace",
            command,
            lambda names: [*command, "--", "--exact", *names],
            "doc",
            cwd=str(stage.root),
            env=env,
        )
    )
    return made


# Unit tests of the crate `trocar` that need an etcd: a part of the suite of that name.
THERE = ["etcd::", "--include-ignored"]
NOT_THERE = ["--skip", "etcd::"]


def etcd(stage):
    """Managers over a real etcd, from outside; and the store alone, among the unit tests."""
    made = outer("etcd", "", timed=True).parts(stage)
    for one in stage.workshop.executables:
        if one.title == "trocar":
            again = lambda names, path=one.path: [path, "--include-ignored", "--exact", *names]
            command = [one.path, *THERE, "--test-threads=2"]
            made.append(Part("etcd", command, again, "store", cwd=one.cwd))
    for part in made:
        part.cannot_run = part.cannot_run or stage.no_etcd
    return made


def shares(name, when):
    """Each case maps new copies of its plugins, and a process has room for some thousands only: threads keep
    1024 keys.
    """
    apart = f"{name}::other_process_"
    groups = {
        "one_process": [f"{name}::", "--skip", apart, "--skip", "::built_", "--skip", "::shared_"],
        "built": [f"{name}::built_", f"{name}::shared_"],
        "two_hosts": [apart, "--skip", f"{apart}o"],
        "two_hosts_executed": [f"{apart}o"],
    }
    return lambda stage: [
        in_harness(stage, name, [stage.harness, *words, "--test-threads=2"], label, when=when)
        for label, words in groups.items()
    ]


def loom(stage):
    executable = stage.workshop.built("loom")
    return [Part("loom", [executable, "loom_"], exactly(executable), cwd=str(stage.root / "host/rt"))]


def tsan(stage):
    """The sanitizer is judged first: it has to find the races of races.rs, and nothing in its orderly cases.

    Plugins are linked in, so that they are instrumented too; C++ classes, and Rust ones from a file, are not,
    and are left out.
    """
    env = {
        "TSAN_OPTIONS": f"history_size=4 {os.environ.get('TSAN_OPTIONS', '')} exitcode=66 suppressions={stage.root}/tests/tsan/suppressions"
    }
    judge = [sys.executable, "tests/tsan/judge.py", stage.workshop.built("races")]
    harness = stage.workshop.built("it under tsan")
    lines = (stage.root / "tests/tsan/gate.txt").read_text().splitlines()
    chosen = [line for line in lines if line and not line.startswith("#")]
    words = ["_linked::", "of_linked_classes"] if stage.everything else ["--exact", *chosen]
    command = [harness, *words, "--test-threads=2"]
    return [
        Part(
            "tsan", judge, lambda names: [*judge, "--exact", *names], "judged", cwd=str(stage.root), env=env
        ),
        in_harness(stage, "tsan", command, "races", env=env),
    ]


def torture(stage):
    """Rows load the machine on purpose (endless loops, real-time priorities), so that nothing runs beside them."""
    command = [str(stage.workshop.programs / "torture")]

    def part(label, when, *options, rows=()):
        again = lambda names: [*command, *options, "--exact", *names]
        full = [*command, *options, *rows]
        return Part("torture", full, again, label, when=when, cwd=str(stage.root), alone=True, show="^[|] ")

    if stage.torture_args:
        return [part("full", GATE, "--full", rows=[word for word in stage.torture_args if word != "--full"])]
    return [part("", GATE, "--gate"), part("times", TIMES, "--times")]


def eyesaw(stage):
    command = [str(stage.workshop.programs / "bench"), "eyesaw"]
    return [Part("eyesaw", command, None, when=TIMES, alone=True, cwd=str(stage.root), show="^")]


# -- processes in other languages ----------------------------------------------------------------------------


def script(name, about, *modes, build="programs", grpcurl=False, drives=True):
    """A suite that prints libtest's lines and takes `--exact NAME...`, but for a mode that is `whole`.

    A mode is (command, part's label, when, more of the part).
    """

    def parts(stage):
        missing = stage.no_grpcurl if grpcurl else ""
        made = []
        for command, label, when, more in modes:
            plain = [word for word in command if word != "--times"]
            again = None if "whole" in more else lambda names, plain=plain: [*plain, "--exact", *names]
            more = {key: value for key, value in more.items() if key != "whole"}
            made.append(
                Part(name, command, again, label, when=when, cwd=str(stage.root), cannot_run=missing, **more)
            )
        return made

    return Suite(name, about, build, parts, drives)


def mode(*command, label="", when=GATE, **more):
    words = [sys.executable if word == "python3" else word for word in command]
    return words, label, when, more


def times(*command, **more):
    return mode(*command, label="times", when=TIMES, alone=True, **more)


PYTHON = ("python3", "sdk/python/tests/run.py")
RECORDER = ("python3", "tests/recorder/suite.py")
VIEWER = ("bash", "tests/viewer/run.sh")
FIGURES = "^(bench|figure|events:|300 components:)"

# -- the table -----------------------------------------------------------------------------------------------

# Long ones first: they decide when a run ends.
SUITES = [
    Suite(
        "conformance",
        "client and server over a pairwise choice of deployments and languages",
        "tests",
        shares("conformance", GATE),
    ),
    script(
        "viewer",
        "the page, driven in Debian's chromium",
        mode(*VIEWER, heavy=True),
        times(*VIEWER, "--times", show=FIGURES),
        grpcurl=True,
    ),
    script(
        "recorder",
        "recordings of the built program, read by the stock Python reader",
        mode(*RECORDER, heavy=True),
        times(*RECORDER, "--times"),
    ),
    script(
        "python",
        "the package sdk/python, installed as users do",
        mode(*PYTHON, heavy=True),
        times(*PYTHON, "--times"),
    ),
    Suite(
        "workspace",
        "unit tests, integration tests and documented examples of every crate",
        "tests",
        workspace,
        drives=False,
    ),
    outer(
        "conformance_random",
        "random interleavings of changes and calls, by seed",
        threads=1,
        grpcurl=False,
        heavy=True,
    ),
    outer("processes", "supervised processes that are killed at any moment", timed=True),
    outer("demo", "the newcomer's first command", threads=1, counted=True, timed=True, heavy=True),
    outer("devices", "robot, OCT, video and filters from outside", heavy=True),
    outer("realtime", "threads, priorities, streams and queues", counted=True),
    outer("faults", "components that panic, hang and misbehave", counted=True, timed=True),
    outer("hostile", "strangers, impostors and limits", counted=True, timed=True),
    outer("links", "connections between processes"),
    outer("places", "components in processes of their own, by one word"),
    outer("plugin_loading", "plugin files that are dropped in", counted=True),
    script(
        "accuracy",
        "vision and OCT beside OpenCV's results",
        mode("python3", "tests/bench/peers/vision.py", "--no-build", "--accuracy", whole=True),
    ),
    outer("adapting", "connections between payloads that differ", grpcurl=False),
    outer("arrows", "who may depend on whom; one set of features", grpcurl=False),
    outer("changing_ports", "components whose ports change", grpcurl=False),
    outer("cli", "the command line"),
    outer("control_plane", "requests through grpcurl, and every refusal"),
    outer("cpp_plugin", "plugins in C++", cpp=True),
    outer("deployment", "several hosts, one manager"),
    outer("embedding", "hosts inside other programs"),
    outer("embedding_client", "clients inside other programs", grpcurl=False),
    Suite("etcd", "several managers for one system, over a real etcd", "tests", etcd),
    outer("fig4", "the figure of the paper"),
    outer("guests", "processes without a manager"),
    outer("machines", "a manager that other machines reach", timed=True),
    outer("odd_plugins", "plugins that are not what they say"),
    outer("plugin_guide", "the plugin guide, typed in", timed=True),
    outer("purity", "no allocation, lock or system call in a step", grpcurl=False),
    outer("sdk_devices", "the sdk's device contracts", grpcurl=False),
    outer("sdk_helpers", "the sdk's helpers", grpcurl=False),
    outer("services", "what components ask of the manager"),
    script("readme", "README and tour, typed in", mode("python3", "tests/readme/suite.py"), grpcurl=True),
    script("gate", "the runner of these suites itself", mode("python3", "tests/gate/tests.py"), drives=False),
    script(
        "words",
        "plain words in comments, texts, pages and commits",
        mode("python3", "tests/words/suite.py"),
        drives=False,
    ),
    script(
        "viewer_dist",
        "the committed page is what its sources make",
        mode("bash", "tests/viewer/dist.sh"),
        drives=False,
    ),
    Suite("loom", "the real-time core under every interleaving of its models", "loom", loom, drives=False),
    Suite(
        "tsan",
        "the thread sanitizer: a choice of the conformance suite, all of it with --all",
        "tsan",
        tsan,
        drives=False,
    ),
    Suite("torture", "faults at random moments against built programs", "programs", torture),
    Suite(
        "conformance_cross", "every deployment with every language", "tests", shares("conformance_cross", ALL)
    ),
    script(
        "python_oldest",
        "the package with the oldest Python it promises",
        mode(*PYTHON, "--oldest", when=ALL, heavy=True),
    ),
    script(
        "generated",
        "the code of trocar.v1 is what its .proto files give",
        mode("bash", "proto/generate/check.sh", when=ALL),
        drives=False,
    ),
    Suite("eyesaw", "a surgical system under its full load, against its gates", "bench", eyesaw, only=TIMES),
    script(
        "peers",
        "vision and OCT beside OpenCV, numpy and scipy",
        times("python3", "tests/bench/peers/vision.py", "--no-build", whole=True),
    ),
    script(
        "python_times",
        "what a call from Python costs",
        times(*PYTHON, "--bench", whole=True, show=r"^(call|r\.|bare)"),
    ),
    script(
        "recorder_times",
        "what a recorder writes beside the crate mcap alone",
        times(
            "cargo",
            "run",
            "--release",
            "--quiet",
            "-p",
            "trocar-recorder",
            "--example",
            "throughput",
            "--",
            "target",
            whole=True,
            show="^{",
        ),
    ),
]


def named(name):
    return next((suite for suite in SUITES if suite.name == name), None)


def known(name):
    """Whether it names a suite, or a crate of the workspace, whose name cargo judges."""
    suite, dot, package = name.partition(".")
    return bool(named(suite)) and (not dot or (suite == "workspace" and bool(package)))


def apart(names):
    """Suites that were asked for, and the crates of the suite workspace: workspace.trocar-rt."""
    split = [name.partition(".") for name in names]
    return [suite for suite, _, _ in split], [package for _, _, package in split if package]


def forgotten(root):
    """Files of tests/it that no row names."""
    modules = re.findall(r"^mod (\w+);$", (root / "tests/it/main.rs").read_text(), re.M)
    return [module for module in modules if not named(module)]
