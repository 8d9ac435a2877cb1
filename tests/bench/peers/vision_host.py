#!/usr/bin/env python3
"""Each vision filter as a built plugin file in a running host: the age of frames at the display behind it, in percentiles.

    python3 tests/bench/peers/vision_host.py [--seconds 10] [--output FILE] [--trocar FILE] [--plugins DIR]

Pairs of 1024 x 768 px, RGB8, 30 a second, go from `image_source` through one filter to `display`, as they do in EyeSAW. The first
row has no filter: what it shows is the source's copy and the framework. `adds_ms` is a row's median less that one's. `copied` has a
second display read what the filter reads, so that it cannot work where the frame lies; `pip` gets another inset with each frame, the
dearest case. Plugin files are built for any x86-64 and choose AVX2 at run time. Python's own library is enough; nothing passes or fails
by times. Build before: `cargo build --release`.
"""

import argparse
import json
import os
import pathlib
import random
import socket
import struct
import subprocess
import tempfile
import time
import zlib

ROOT = pathlib.Path(__file__).resolve().parents[3]
RELEASE = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")) / "release"
WIDTH, HEIGHT, RATE_HZ = 1024, 768, 30
IN_PLACE = {"flip", "exposure", "overlay", "pip"}
# Class, its output, its configuration, commands before it is measured.
LINE = {"item": 0, "from": [0, 0], "to": [1000, 700], "width": 3, "color": [255, 0, 0, 255], "eye": 0, "disparity": 0}
ROWS = [
    ("rectify", "rectified", {"calibration": "calibration.json"}, []),
    ("gray", "gray", {}, []),
    ("color", "converted", {"to": "bgr8"}, []),
    ("resize", "resized", {"width": 512, "height": 384, "from_width": WIDTH, "from_height": HEIGHT}, []),
    ("crop", "part", {"width": 512, "height": 384}, []),
    ("flip", "flipped", {"direction": "both"}, []),
    ("exposure", "exposed", {"gain": 1.2}, []),
    ("overlay", "overlaid", {}, [("items/set_line", LINE)]),
    ("pip", "composed", {"w": 341, "h": 256}, []),
]


def main():
    args = arguments()
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        for eye in ("left", "right"):
            (folder / f"{eye}1.png").write_bytes(noise_png(WIDTH, HEIGHT, eye))
        (folder / "calibration.json").write_text(json.dumps(calibration()))
        rows = [measured(args, folder, None, copied=False)]
        for row in ROWS:
            rows += [measured(args, folder, row, copied) for copied in (False, True)[:1 + (row[0] in IN_PLACE)]]
    for row in rows:
        row["adds_ms"] = round(row["p50_ms"] - rows[0]["p50_ms"], 3)
    result = {"pairs": f"2 x {WIDTH}x{HEIGHT} RGB8, {RATE_HZ}/s", "seconds": args.seconds, "rows": rows, "load_average": os.getloadavg()}
    if args.output:
        args.output.write_text(json.dumps(result, indent=1) + "\n")
    print("| filter | p50 | p99 | largest | adds (p50) | frames |\n|---|---|---|---|---|---|")
    for r in rows:
        print(f"| {r['filter']} | {r['p50_ms']} ms | {r['p99_ms']} ms | {r['max_ms']} ms | {r['adds_ms']} ms | {r['frames']} |")
    print("load average:", *os.getloadavg())


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10, help="time of each row (10)")
    parser.add_argument("--output", type=pathlib.Path, help="file for the figures as JSON")
    parser.add_argument("--trocar", type=pathlib.Path, default=RELEASE / "trocar", help="the host to run")
    parser.add_argument("--plugins", type=pathlib.Path, default=RELEASE, help="where the plugin files lie")
    return parser.parse_args()


def system(row, copied):
    components = {
        "host/source": {"class": "stereo/image_source", "execution": {"model": "stream", "rate_hz": RATE_HZ},
                        "config": {"directory": ".", "format": "rgb8"}},
        "host/show": {"class": "display/display", "execution": {"stream_of": "host/source"}},
    }
    if row is None:
        return components, [{"client": "host/show/image", "server": "host/source/image", "queue": {"fifo": 2}}]
    kind, output, config, _ = row
    components["host/filter"] = {"class": f"vision-filters/{kind}", "execution": {"stream_of": "host/source"}, "config": config}
    connections = [{"client": "host/filter/image", "server": "host/source/image", "queue": {"fifo": 2}},
                   {"client": "host/show/image", "server": f"host/filter/{output}", "queue": {"fifo": 2}}]
    if kind == "pip":
        connections.append({"client": "host/filter/inset", "server": "host/source/image"})
    if copied:
        components["host/other"] = {"class": "display/display", "execution": {"model": "stream"}}
        connections.append({"client": "host/other/image", "server": "host/source/image", "queue": {"fifo": 2}})
    return components, connections


def measured(args, folder, row, copied):
    components, connections = system(row, copied)
    file = folder / "system.json"
    file.write_text(json.dumps({"version": 1, "processes": {"host": {"trust": "dev"}}, "components": components, "connections": connections}))
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"

    def ask(*words):
        done = subprocess.run([args.trocar, "--gcm", address, "--json", *words], capture_output=True, text=True)
        return json.loads(done.stdout) if done.returncode == 0 else None

    host = subprocess.Popen([args.trocar, "run", file, "--plugins", args.plugins, "--listen", address], cwd=folder,
                            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    try:
        deadline = time.monotonic() + 30

        def ask_until_answered(*words):
            """Components take commands once they run."""
            while ask(*words) is None:
                if host.poll() is not None or time.monotonic() > deadline:
                    host.kill()
                    raise SystemExit(f"vision_host.py: {' '.join(words)} was not answered: {host.stderr.read()}")
                time.sleep(0.2)
        for command, argument in row[3] if row else []:
            ask_until_answered("call", f"host/filter/{command}", json.dumps(argument))
        ask_until_answered("call", "host/show/screen/latency")
        time.sleep(1)
        ask_until_answered("call", "host/show/screen/reset_latency")
        time.sleep(args.seconds)
        told = ask("call", "host/show/screen/latency")
    finally:
        host.terminate()
        host.wait(timeout=20)
    figures = told.get("value", told)
    name = (row[0] if row else "none") + (", copied" if copied else "")
    ms = {key: round(figures[key], 3) for key in ("p50_ms", "p99_ms", "max_ms")}
    return {"filter": name, **ms, "frames": int(figures["frames"])}


def calibration():
    def side(last):
        return {"matrix": [[900, 0, 511.5], [0, 900, 383.5], [0, 0, 1]], "distortion": [-0.2, 0.05, 1e-3, -1e-3],
                "rectification": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
                "projection": [[880, 0, 511.5, last], [0, 880, 383.5, 0], [0, 0, 1, 0]]}
    return {"format": "trocar-stereo-calibration", "version": 1, "image_size": [WIDTH, HEIGHT], "left": side(0), "right": side(-4.4)}


def noise_png(width, height, seed):
    rows = random.Random(seed)
    raw = b"".join(b"\0" + rows.randbytes(3 * width) for _ in range(height))

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(raw, 1)) + chunk(b"IEND", b"")


if __name__ == "__main__":
    main()
