"""Builds what the suites run: programs and plugins as the README builds them, the test executables, C++
fixtures, tsan, loom.

All share one target directory and one set of features, so that no dependency is compiled twice. Our own
crates are compiled twice: as they are used (`cargo build --release`, which the outer tests drive), and
*checked* for unit tests, with overflow checks and debug assertions and without optimisation.

Invariant: a build that fails is one failure of the run, and is told with the end of its log.
"""

import dataclasses
import json
import os
import pathlib
import shutil
import subprocess

# Signal processing and the simulated world are tested over minutes of virtual time; the rest is tested as
# quickly as it is built.
FULLY_OPTIMISED = (
    "trocar-oct-core",
    "trocar-bscan",
    "trocar-eyerobot",
    "trocar-stereo-depth",
    "trocar-phantom",
)
# Others' algorithms, which take long to compile: as in the release build, and once for both.
AS_RELEASED = ("trocar-fft",)


@dataclasses.dataclass
class Executable:
    """A test executable that cargo built."""

    package: str
    target: str
    path: str
    cwd: str

    @property
    def title(self):
        return (
            self.package if self.target.replace("_", "-") == self.package else f"{self.package}.{self.target}"
        )


class Workshop:
    """Where things are built, and with what."""

    def __init__(self, root, target):
        self.root = root
        self.target = target
        self.work = target / "outer"
        self.logs = self.work / "logs"
        self.logs.mkdir(parents=True, exist_ok=True)
        self.programs = target / "release"
        self.cpp = self.work / "cpp"
        self.paths = {}  # name of a built executable -> its path
        self.executables = []  # of unit and integration tests
        self.packages = []  # whose unit tests were asked for; none: all
        self.drives = True  # the outer tests run, too
        self.running = []  # the log of the build that runs now
        self.last = ""
        self.machine = self._machine()
        self.sysroot = _said(["rustc", "--print", "sysroot"])
        self.libraries_of_std = _said(["rustc", "--print", "target-libdir"])

    @staticmethod
    def _machine():
        lines = _said(["rustc", "-vV"]).splitlines()
        return next((line.removeprefix("host: ") for line in lines if line.startswith("host: ")), "")

    def run(self, name, command, env=None, nice=True):
        """Runs one command of a build; answers whether it worked. Its log is `logs/NAME.log`."""
        self.running, self.last = [name], name
        with open(self.logs / f"{name}.log", "ab") as log:
            lower = ["nice", "-n", "10"] if nice and shutil.which("nice") else []
            where = {"cwd": self.root, "env": {**os.environ, **(env or {})}}
            done = subprocess.run(
                [*lower, *command], stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT, **where
            )
        self.running = []
        return done.returncode == 0

    def fresh_log(self, name):
        (self.logs / f"{name}.log").unlink(missing_ok=True)

    # -- programs and plugins --------------------------------------------------------------------------------

    def build_programs(self):
        """What the outer tests drive, as `cargo build --release` makes it, and the fixture plugins. cargo
        test leaves no plugin behind.
        """
        # The derive alone would lie among the plugins, as a library that is none.
        packages = ["--workspace", "--exclude", "trocar-tests", "--exclude", "trocar-sdk-derive"]
        # It sets the clock of tokio, which programs that are used have no way to.
        packages += ["--exclude", "trocar-simulation"]
        examples = ["--example", "depth_bench", "--example", "filters_bench"]
        self.fresh_log("build-programs")
        return self.run(
            "build-programs",
            ["cargo", "build", "--release", *packages, "--lib", "--bins", *examples],
            nice=False,
        )

    def build_bench(self):
        return self.run("build-bench", ["cargo", "build", "--release", "-p", "trocar-tests"], nice=False)

    def build_cpp(self):
        """Fixture plugins in C++. Answers why there are none where the machine has no compiler; the suites
        then skip them by name.
        """
        self.fresh_log("build-cpp")
        compiler = os.environ.get("CXX", "g++")
        if not shutil.which(compiler):
            os.environ["TROCAR_NO_CPP"] = f"no C++ compiler ({compiler})"
            return True
        self.cpp.mkdir(parents=True, exist_ok=True)
        fixtures = ("cpp_filter", "cpp_arms", "conform_cpp", "places_cpp")
        return all(
            [
                self.run("build-cpp", ["bash", f"tests/fixtures/plugins/{name}/build.sh", str(self.cpp)])
                for name in fixtures
            ]
        )

    # -- tests -----------------------------------------------------------------------------------------------

    def build_tests(self):
        """The test executables of the workspace and of the outer tests, with checks."""
        command = ["cargo", "test", "--release", "--no-run", "--config", str(self._checks())]
        found = self.executables_of("build-tests", [*command, *self._asked()], self._beside)
        if found is None:
            return False
        self.executables = found
        if not self.drives:
            return True
        # The outer tests are no default target: a bare `cargo test` has nothing to run them against.
        harness = self.executables_of(
            "build-harness", [*command, "-p", "trocar-tests", "--test", "it"], self._beside
        )
        if not harness:
            return False
        self.paths["it"] = harness[0].path
        return True

    def _asked(self):
        return [word for package in self.packages for word in ("-p", package)] or ["--workspace"]

    def doc_tests(self):
        """The command that compiles and runs the examples of the documentation, and its environment."""
        return [
            "cargo",
            "test",
            "--release",
            "--doc",
            *self._asked(),
            "--no-fail-fast",
            "--config",
            str(self._checks()),
        ], self._beside

    def build_loom(self):
        env = {"RUSTFLAGS": "--cfg loom", "CARGO_TARGET_DIR": str(self.target / "loom")}
        found = self.executables_of(
            "build-loom", ["cargo", "test", "-p", "trocar-rt", "--release", "--lib", "--no-run"], env
        )
        if not found:
            return False
        self.paths["loom"] = found[0].path
        return True

    def build_tsan(self):
        """The outer tests and the cases of races.rs under the thread sanitizer.

        The standard library comes prebuilt: tests/tsan/std.c tells the sanitizer what its locks order.
        """
        link = self.target / "tsan/link"
        if not self.run("build-tsan", ["bash", "tests/tsan/link.sh", str(link)]):
            return False
        # Seen from here, so that what was compiled in another clone has the same flags.
        arguments = os.path.relpath(_last_line(self.logs / "build-tsan.log").removeprefix("@"), self.root)
        flags = f"-Zsanitizer=thread -Cunsafe-allow-abi-mismatch=sanitizer -Clink-arg=@{arguments}"
        env = {"RUSTC_BOOTSTRAP": "1", "CARGO_TARGET_DIR": str(self.target / "tsan"), "RUSTFLAGS": flags}
        command = [
            "cargo",
            "test",
            "--config",
            # No case decodes a picture; optimised, this crate takes half as long as the host under the
            # sanitizer.
            "profile.dev.package.image.opt-level=0",
            "-p",
            "trocar-tests",
            "--features",
            "tsan",
            "--target",
            self.machine,
            "--test",
            "it",
            "--no-run",
        ]
        found = self.executables_of("build-tsan", command, env)
        if not found:
            return False
        self.paths["it under tsan"] = found[0].path
        self.paths["races"] = str(self.target / "tsan" / self.machine / "debug" / "races")
        return True

    def built(self, name):
        return self.paths[name]

    def executables_of(self, log, command, env):
        """Runs `cargo test --no-run`; the test executables, or `None` where one does not compile."""
        self.fresh_log(log)
        if not self.run(log, [*command, "--message-format=json-render-diagnostics"], env):
            return None
        return _executables((self.logs / f"{log}.log").read_text(errors="replace"))

    @property
    def _beside(self):
        """A target directory of its own: programs stay as `cargo build --release` made them. What is compiled
        lies in the shared one.
        """
        return {"CARGO_TARGET_DIR": str(self.target / "checked"), "CARGO_BUILD_BUILD_DIR": str(self.target)}

    def _checks(self):
        """A cargo configuration that turns checks on for our own crates, and for nothing else: dependencies
        stay as they were built.
        """
        said = json.loads(_said(["cargo", "metadata", "--no-deps", "--format-version", "1"], cwd=self.root))
        lines = ["# Written by tests/gate/building.py."]
        for name in sorted({package["name"] for package in said["packages"]}.difference(AS_RELEASED)):
            level = 3 if name in FULLY_OPTIMISED else 0
            lines += [
                f"[profile.release.package.{name}]",
                f"opt-level = {level}",
                "debug-assertions = true",
                "overflow-checks = true",
            ]
        path = self.work / "checked.toml"
        path.write_text("\n".join(lines) + "\n")
        return path

    def libraries(self):
        """Where test executables find the libraries they were linked with (those of procedural macros need
        some).
        """
        return f"{self.target / 'release' / 'deps'}:{self.sysroot}/lib:{self.libraries_of_std}"


def _executables(log):
    found = []
    for line in log.splitlines():
        if not line.startswith('{"reason":"compiler-artifact"'):
            continue
        said = json.loads(line)
        if said["profile"]["test"] and said["executable"]:
            folder = pathlib.Path(said["manifest_path"]).parent
            found.append(
                Executable(
                    _package(said["package_id"]), said["target"]["name"], said["executable"], str(folder)
                )
            )
    return found


def _last_line(log):
    return log.read_text(errors="replace").strip().splitlines()[-1]


def _package(package_id):
    """The name in a package id: "path+file:///x/host/model#trocar-model@0.1.0", or
    "path+file:///x/trocar#0.1.0".
    """
    folder, _, rest = package_id.partition("#")
    return rest.split("@")[0] if "@" in rest else folder.rsplit("/", 1)[-1]


def _said(command, cwd=None):
    return subprocess.run(command, cwd=cwd, check=True, capture_output=True, text=True).stdout.strip()
