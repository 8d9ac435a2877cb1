"""The built host with the built plugins, as `trocar up` runs them: what one component does to each frame, and how long that takes.

Times are ages where the last of a stream takes a frame, from the stamp of a source that does next to nothing: they hold the
component's whole step and what the framework does around it. A stream runs without a pause, as the other side does.
"""

import json
import os
import pathlib
import shutil
import subprocess
import time

LEDGER = "fixture-ledger"
# More than any filter reaches: its stream never sleeps.
FLAT_OUT_HZ = 20_000
WARMS_UP_S = 0.3


class System:
    """Streams of source, one filter and sink each, of which one runs at a time; a context manager."""

    def __init__(self, programs, work, name):
        self.trocar, self.plugins = programs / "trocar", programs
        self.folder = work / name
        self.components, self.connections, self.heads, self.began = {}, [], {}, set()

    def frames(self, name, pixels, size, filter_, ports):
        """Blank pairs through a filter of pairs: (class, config), its input and output."""
        source = {"class": f"{LEDGER}/blank_source", "config": {"width": size[0], "height": size[1], "format": pixels}}
        sink = {"class": f"{LEDGER}/frame_ledger"}
        self.stream(name, {"source": source, "filter": filter_, "sink": sink}, FLAT_OUT_HZ)
        self.connect(f"host/{name}-filter/{ports[0]}", f"host/{name}-source/image")
        self.connect(f"host/{name}-sink/image", f"host/{name}-filter/{ports[1]}")

    def matcher(self, name, folder, config):
        """The pairs of a folder, matched."""
        source = {"class": "stereo/image_source", "config": {"directory": str(folder)}}
        filter_ = {"class": "stereo-depth/stereo_depth", "config": config}
        self.stream(name, {"source": source, "filter": filter_, "sink": {"class": "display/display"}}, FLAT_OUT_HZ)
        self.connect(f"host/{name}-filter/rectified", f"host/{name}-source/image")
        self.connect(f"host/{name}-sink/picture", f"host/{name}-filter/disparity")

    def spectra(self, name, source, processor, rate_hz):
        """The lines of a file, 64 at a time, made A-scans; without the surface."""
        parts = {"source": {"class": "oct/oct_file", "config": source}, "edge": {"class": f"{LEDGER}/edge"},
                 "filter": {"class": "oct/oct_processor", "config": processor}, "sink": {"class": f"{LEDGER}/line_ledger"}}
        self.stream(name, parts, rate_hz)
        self.connect(f"host/{name}-edge/spectra", f"host/{name}-source/spectra")
        self.connect(f"host/{name}-filter/spectra", f"host/{name}-edge/through")
        self.connect(f"host/{name}-sink/begun", f"host/{name}-edge/begun")
        self.connect(f"host/{name}-sink/ascan", f"host/{name}-filter/ascan")

    def stream(self, name, parts, rate_hz):
        """Steps its parts one after the other."""
        head = f"host/{name}-source"
        for part, component in parts.items():
            leads = part == "source"
            execution = {"model": "stream", "rate_hz": rate_hz} if leads else {"stream_of": head}
            self.components[f"host/{name}-{part}"] = {**component, "execution": execution}
        self.heads[name] = head

    def connect(self, client, server):
        self.connections.append({"client": client, "server": server})

    def __enter__(self):
        plugins = self.folder / "plugins"
        plugins.mkdir(parents=True, exist_ok=True)
        for name in ("display", "stereo", "stereo_depth", "vision_filters", "oct", "fixture_ledger"):
            shutil.copy(self.plugins / f"libtrocar_{name}.so", plugins)
        # A stream begins to run when it is its turn.
        system = {"version": 1, "processes": {"host": {"plugins": ["plugins"]}},
                  "components": self.components, "connections": self.connections}
        file = self.folder / "system.json"
        file.write_text(json.dumps(system, indent=1))
        file.chmod(0o644)
        environment = {**os.environ, "XDG_STATE_HOME": str(self.folder / "state")}
        environment.pop("TROCAR_GCM", None)
        with (self.folder / "up.log").open("w") as log:
            self.up = subprocess.Popen([self.trocar, "up", file, "--listen", "127.0.0.1:0", "--json"], cwd=self.folder,
                                       stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=log, text=True, env=environment)
        said = self.up.stdout.readline()
        if not said:
            raise RuntimeError(f"trocar up: {(self.folder / 'up.log').read_text().strip()}")
        self.address = json.loads(said)["listening"]
        self.ask("stop", *self.heads.values())
        return self

    def __exit__(self, *_):
        self.up.terminate()
        self.up.wait()

    def ask(self, *words):
        environment = {**os.environ, "TROCAR_GCM": self.address}
        done = subprocess.run([self.trocar, *words], capture_output=True, text=True, env=environment)
        if done.returncode:
            raise RuntimeError(f"trocar {' '.join(words)}: {done.stderr.strip()}")
        return done.stdout

    def turn(self, name, seconds):
        """Lets one stream run for a while."""
        self.ask("start", self.heads[name])
        ledger = self.components[f"host/{name}-sink"]["class"].startswith(LEDGER)
        if name not in self.began and ledger:
            # What came first met new memory, and no inset.
            time.sleep(WARMS_UP_S)
            self.clear(f"host/{name}-sink")
        self.began.add(name)
        time.sleep(seconds)
        self.ask("stop", self.heads[name])

    def figures(self, name):
        """Of one frame, in all its turns: the least time, median and 99th percentile, ms. Lines count as frames."""
        if self.components[f"host/{name}-sink"]["class"] == "display/display":
            return self.figures_of_steps(name)
        told = self.told(f"host/{name}-sink/ledger/figures")
        some(name, told["frames" if "frames" in told else "lines"])
        return {f"{part}_ms": float(told[part]) / 1e6 for part in ("least", "p50", "p99")}

    def figures_of_steps(self, name):
        """The same of a component whose every step has a frame; percentiles are those of the age at its sink."""
        steps = self.told(f"host/{name}-filter/system/period_statistics")
        connections = json.loads(self.ask("ls", "--json"))["connections"]
        [last] = [c for c in connections if c["client"].startswith(f"host/{name}-sink/")]
        some(name, last["passed"])
        if abs(steps["executed"] - last["passed"]) > 1:
            raise RuntimeError(f"{name}: {steps['executed']} steps, {last['passed']} maps: the least step may be an empty one")
        return {"least_ms": steps["compute_min"] * 1e3, **{f"{p}_ms": last[f"latency_{p}_ns"] / 1e6 for p in ("p50", "p99")}}

    def clear(self, sink):
        offset_m = ["0"] if self.components[sink]["class"].endswith("line_ledger") else []
        self.ask("call", f"{sink}/ledger/clear", *offset_m)

    def told(self, command):
        return json.loads(self.ask("call", command))


def some(name, count):
    if int(count) == 0:
        raise RuntimeError(f"{name}: its sink was given nothing")


def programs(target):
    """Where the built program and plugins are."""
    return pathlib.Path(os.environ.get("TROCAR_BIN_DIR", target / "release"))
