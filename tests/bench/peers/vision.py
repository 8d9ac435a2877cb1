#!/usr/bin/env python3
"""The built plugins beside OpenCV, numpy and scipy: one thread each, one machine, one run.

    python3 tests/bench/peers/vision.py [--rounds 5] [--output FILE] [--no-build] [--accuracy]

Makes a venv under target/ with the packages of vision.txt. Times are those of the plugin files in the built host (`built.py`): whole
steps of their components on pairs of images, or on spectra 64 lines at a time, with what the framework does around them. Both sides
work without a pause, and take turns; the least time of all rounds counts, as what else runs on the machine only adds to it. Prints
one JSON object: accuracy on *motorcycle* (gate B2 of the design), ratios (gate B3), percentiles, and how far results agree; with
`--accuracy` nothing is timed. Accuracy and agreement are those of the examples `depth_bench` and `filters_bench`, which write what
they make.

Exit 1 when a gate is missed, 77 when the packages cannot be had.

*motorcycle* is Middlebury 2014, taken from the scikit-image wheel and never copied into the repository.
"""

import argparse
import json
import os
import pathlib
import subprocess
import sys
import time

import built

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parents[2]
VENV = ROOT / "target" / "peers-venv"
WORK = ROOT / "target" / "peers"
CALIBRATION = ROOT / "tests/data/calibration/chessboard.json"
TARGET = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
# bad-2 of all pixels, gate B2.
ACCURACY = {"bm": 0.320, "sgm": 0.240}
# Of an image and its like: pixels within a level of OpenCV's, gate B1.
AGREEMENT = 0.999
# Of one side, s.
TURN_S = 0.7
# Rounds at most, beside what was asked for; and a least time that is less by a fiftieth is another one.
MOST, SAME = 4, 0.98
# Lines of a frame of spectra.
LINES = 64
# Exit status when the packages cannot be had.
SKIPPED = 77
# Least ratio to OpenCV by size, gate B3; and to numpy and scipy, which the design saw at a quarter.
SPEED = {("bm9", "640x480"): 1.15, ("bm15", "640x480"): 1.15, ("bm9", "1024x768"): 1.8, ("bm15", "1024x768"): 1.8,
         ("sgm", "640x480"): 1.4, ("sgm", "1024x768"): 1.6,
         ("remap", "640x480"): 1.5, ("remap", "1024x768"): 1.5, ("gray", "640x480"): 1.5, ("gray", "1024x768"): 1.5,
         ("oct linear", "1024"): 2.0, ("oct linear", "2048"): 2.0, ("oct cubic", "1024"): 2.0, ("oct cubic", "2048"): 2.0}


def main():
    args = arguments()
    enter_venv()
    if not args.no_build:
        build(args.accuracy)
    WORK.mkdir(parents=True, exist_ok=True)
    result = {"accuracy": accuracy(), "times": [], "agreement": {}}
    for width, height, disparities in ((640, 480, 64), (1024, 768, 96)):
        if not args.accuracy:
            result["times"] += stereo_times(width, height, disparities, args.rounds)
            result["times"] += filter_times(width, height, args.rounds)
        result["agreement"][f"{width}x{height}"] = agreement(width, height)
    for samples in () if args.accuracy else (1024, 2048):
        result["times"] += oct_times(samples, args.rounds)
    result["load_average"] = os.getloadavg()
    text = json.dumps(result, indent=1)
    if args.output:
        args.output.write_text(text + "\n")
    print(text)
    judge_all(result)


def judge_all(result):
    """Says it as libtest does, since `tests/run` counts by that."""
    accurate = {f"bad-2 of all pixels of {n} is at most {limit}": result["accuracy"][n]["bad2_all"] <= limit
                for n, limit in ACCURACY.items()}
    equal = {f"the portable code of {n} gives the same bytes": result["accuracy"][n]["portable_is_equal"] for n in ACCURACY}
    near = {f"{what} at {size} is OpenCV's within a level": figures["within_1"] >= AGREEMENT
            for size, all_ in result["agreement"].items() for what, figures in all_.items()}
    fast = {f"{row['what']} at {row['size']} is {row['goal']} times as fast (seen: {row['ratio']})": row["holds"]
            for row in result["times"] if "goal" in row}
    claims = {**accurate, **equal, **near, **fast}
    missed = [claim for claim, holds in claims.items() if not holds]
    for claim in missed:
        print(f"test peers: {claim} ... FAILED")
    word = "FAILED" if missed else "ok"
    print(f"test result: {word}. {len(claims) - len(missed)} passed; {len(missed)} failed; 0 ignored")
    sys.exit(1 if missed else 0)


def build(only_examples):
    for package, example in (("trocar-stereo-depth", "depth_bench"), ("trocar-vision-filters", "filters_bench")):
        subprocess.run(["cargo", "build", "--release", "-q", "-p", package, "--example", example], cwd=ROOT, check=True)
    if only_examples:
        return
    names = ["trocar-cli", "trocar-display", "trocar-stereo", "trocar-stereo-depth", "trocar-vision-filters", "trocar-oct",
             "trocar-fixture-ledger"]
    packages = [word for name in names for word in ("-p", name)]
    subprocess.run(["cargo", "build", "--release", "-q", *packages], cwd=ROOT, check=True)


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5, help="turns of both sides at least (5)")
    parser.add_argument("--output", type=pathlib.Path, help="file for the result, beside standard output")
    parser.add_argument("--no-build", action="store_true", help="take the examples as they are built")
    parser.add_argument("--accuracy", action="store_true", help="how right results are, not how long they take")
    return parser.parse_args()


def enter_venv():
    """Makes the venv where it is missing, and goes on in it, on one thread."""
    python = VENV / "bin" / "python"
    if pathlib.Path(sys.prefix) != VENV:
        if not python.exists():
            subprocess.run([sys.executable, "-m", "venv", str(VENV)], check=True)
        install = [python, "-m", "pip", "install", "-q", "--retries", "1", "-r", str(HERE / "vision.txt")]
        done = subprocess.run(install, capture_output=True, text=True)
        if done.returncode:
            print(f"vision.py: the packages of vision.txt cannot be had: {done.stderr.strip().splitlines()[-1:]}")
            sys.exit(SKIPPED)
        os.execve(python, [str(python), *sys.argv], {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"})
    global cv2, np
    import cv2
    import numpy as np
    cv2.setNumThreads(1)


def motorcycle():
    import skimage
    data = pathlib.Path(skimage.__file__).parent / "data"
    pair = [cv2.imread(str(data / f"motorcycle_{eye}.png")) for eye in ("left", "right")]
    with np.load(data / "motorcycle_disp.npz") as disparity:
        return pair, disparity[disparity.files[0]]


def opencv_matcher(kind, disparities):
    if kind.startswith("bm"):
        return cv2.StereoBM_create(disparities, int(kind[2:]))
    return cv2.StereoSGBM_create(0, disparities, 5, P1=8 * 25, P2=32 * 25, disp12MaxDiff=1, uniquenessRatio=10)


def job(kind, disparities, **more):
    method = f"method=bm,block={kind[2:]}" if kind.startswith("bm") else "method=sgm"
    return ",".join([method, f"n_disp={disparities}", *(f"{k}={v}" for k, v in more.items())])


def ours(program, *args):
    done = subprocess.run([TARGET / "release" / "examples" / program, *map(str, args)], capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"vision.py: {program}: {done.stderr.strip()}")
    return [json.loads(line) for line in done.stdout.splitlines()]


def accuracy():
    pair, truth = motorcycle()
    left, right = (cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) for image in pair)
    height, width = left.shape
    left.tofile(WORK / "left.raw")
    right.tofile(WORK / "right.raw")
    kinds = {"bm": "bm15", "sgm": "sgm"}
    ours("depth_bench", 1, WORK / "left.raw", WORK / "right.raw", width, height, WORK / "map",
         *(job(kind, 96) for kind in kinds.values()), *(job(kind, 96, portable=1) for kind in kinds.values()))
    maps = [np.fromfile(WORK / f"map.{n}", np.int16).reshape(height, width) for n in range(4)]
    figures = {}
    for n, (name, kind) in enumerate(kinds.items()):
        figures[name] = judge(maps[n] / 16, truth)
        figures[name]["portable_is_equal"] = bool((maps[n] == maps[n + 2]).all())
        figures[f"opencv_{name}"] = judge(opencv_matcher(kind, 96).compute(left, right) / 16, truth)
    return figures


def judge(disparity, truth):
    """Shares of the pixels with a truth; right of column 96 besides, where OpenCV begins."""
    def of(asked):
        known = asked & (disparity >= 0)
        error = np.abs(disparity - truth)
        bad = (error > 2) & known
        return {"density": known.sum() / asked.sum(), "bad2_of_known": bad.sum() / known.sum(),
                "bad2_all": (bad.sum() + (asked & ~known).sum()) / asked.sum(), "mean_error_px": error[known].mean()}
    there = np.isfinite(truth)
    beyond = there.copy()
    beyond[:, :96] = False
    rounded = lambda figures: {k: round(float(v), 4) for k, v in figures.items()}
    return {**rounded(of(there)), "right_of_96": rounded(of(beyond))}


def timed(work, seconds=TURN_S):
    """Times of `work(n)`, ms, one after the other."""
    times, end = [], time.perf_counter() + seconds
    while (n := len(times)) < 2 or time.perf_counter() < end:
        begin = time.perf_counter()
        work(n)
        times.append((time.perf_counter() - begin) * 1e3)
    return times


def line(what, size, theirs_ms, ours, peer="opencv", each=1):
    """`theirs_ms` are all times of the other side, for `each` frames at once; `ours` the figures of a stream, of one."""
    gate = SPEED.get((what, size))
    theirs_ms = np.array(theirs_ms) / each
    p50, p99 = np.percentile(theirs_ms, (50, 99))
    theirs = {"least_ms": theirs_ms.min(), "p50_ms": p50, "p99_ms": p99}
    ratio = theirs["least_ms"] / ours["least_ms"]
    rounded = lambda figures: {key: round(float(value), 5) for key, value in figures.items()}
    figures = {"what": what, "size": size, peer: rounded(theirs), "trocar": rounded(ours), "ratio": round(float(ratio), 2)}
    return {**figures, "goal": gate, "holds": bool(ratio >= gate)} if gate else figures


def turns(system, theirs, rounds, row):
    """Both sides, one after the other; `theirs` are pieces of work by the name of the stream that does the same, `row` makes a
    line of both. It ends, after so many rounds at least, when neither side's least time has become less for two of them: on a
    machine that does something else, too, one side alone may have been lucky."""
    times, rows = {name: [] for name in theirs}, {}
    least, settled = {name: (float("inf"),) * 2 for name in theirs}, {name: 0 for name in theirs}
    with system:
        for number in range(1, MOST * rounds + 1):
            for name in [name for name in theirs if number <= rounds or settled[name] < 2]:
                times[name] += timed(theirs[name])
                system.turn(name, TURN_S)
                ours_ = system.figures(name)
                now = (min(times[name]), ours_["least_ms"])
                less = any(new < SAME * old for new, old in zip(now, least[name]))
                least[name], settled[name] = now, 0 if less else settled[name] + 1
                rows[name] = row(name, times[name], ours_)
    return [rows[name] for name in theirs]


def stereo_times(width, height, disparities, rounds):
    pair, _ = motorcycle()
    folder = WORK / f"pair-{width}"
    folder.mkdir(parents=True, exist_ok=True)
    sides = [cv2.resize(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), (width, height)) for image in pair]
    for name, side in zip(("left", "right"), sides):
        cv2.imwrite(str(folder / f"{name}1.png"), side)
    kinds = {"bm9": {"method": "bm", "block": 9}, "bm15": {"method": "bm", "block": 15}, "sgm": {"method": "sgm"}}
    system = built.System(built.programs(TARGET), WORK, f"stereo-{width}")
    for name, config in kinds.items():
        system.matcher(name, folder, {**config, "n_disp": disparities, "width": width, "height": height})
    matchers = {name: opencv_matcher(name, disparities) for name in kinds}
    theirs = {name: (lambda n, m=m: m.compute(*sides)) for name, m in matchers.items()}
    return turns(system, theirs, rounds, lambda name, them, us: line(name, f"{width}x{height}", them, us))


def scaled_maps(calibration, width, height):
    """OpenCV's fixed-point maps of the left camera, stretched to another size."""
    stretch = np.diag([width / calibration["image_size"][0], height / calibration["image_size"][1], 1])
    k, d, r, p = (np.array(calibration["left"][key]) for key in ("matrix", "distortion", "rectification", "projection"))
    return cv2.initUndistortRectifyMap(stretch @ k, d, r, stretch @ p[:, :3], (width, height), cv2.CV_16SC2)


def images(width, height):
    """An RGB image, what a sensor with a colour filter sees of it, noise as YUYV, and a third of the first."""
    rgb = cv2.resize(cv2.cvtColor(motorcycle()[0][0], cv2.COLOR_BGR2RGB), (width, height))
    sensor = rgb[..., 1].copy()
    sensor[::2, ::2], sensor[1::2, 1::2] = rgb[::2, ::2, 0], rgb[1::2, 1::2, 2]
    yuyv = np.random.default_rng(1).integers(0, 256, (height, width, 2), np.uint8)
    return rgb, sensor, yuyv, cv2.resize(rgb, (width // 3, height // 3))


def stretched(width, height):
    """The calibration of the chessboards for another size, as a file."""
    calibration = json.loads(CALIBRATION.read_text())
    stretch = [width / calibration["image_size"][0], height / calibration["image_size"][1]]
    calibration["image_size"] = [width, height]
    for side in ("left", "right"):
        for matrix in ("matrix", "projection"):
            for row in range(2):
                calibration[side][matrix][row] = [value * stretch[row] for value in calibration[side][matrix][row]]
    file = WORK / f"calibration-{width}.json"
    file.write_text(json.dumps(calibration))
    return file


def filter_times(width, height, rounds):
    """Pairs: two images each on the other side."""
    rgb, sensor, yuyv, inset = images(width, height)
    maps = scaled_maps(json.loads(CALIBRATION.read_text()), width, height)
    shape = {name: (height, width) if name == "gray" else (height, width, 3) for name in ("remap", "gray", "debayer", "yuyv")}
    # The other side's two images stay in its caches, as far as they fit; a stream's pool goes round.
    eyes = {name: [image.copy() for _ in range(2)] for name, image in (("rgb", rgb), ("sensor", sensor), ("yuyv", yuyv))}
    out = {name: [np.empty(shape[name], np.uint8) for _ in range(2)] for name in shape}

    def of(name, source, convert):
        def work(_):
            for eye in range(2):
                convert(eyes[source][eye], out[name][eye] if name in out else None)
        return work

    def lay(big, _):
        big[16:16 + inset.shape[0], 16:16 + inset.shape[1]] = inset

    theirs = {
        "remap": of("remap", "rgb", lambda image, to: cv2.remap(image, *maps, cv2.INTER_LINEAR, dst=to)),
        "gray": of("gray", "rgb", lambda image, to: cv2.cvtColor(image, cv2.COLOR_RGB2GRAY, dst=to)),
        "debayer": of("debayer", "sensor", lambda image, to: cv2.cvtColor(image, cv2.COLOR_BayerRGGB2RGB, dst=to)),
        "yuyv": of("yuyv", "yuyv", lambda image, to: cv2.cvtColor(image, cv2.COLOR_YUV2RGB_YUYV, dst=to)),
        "pip": of("pip", "rgb", lay),
    }
    system = built.System(built.programs(TARGET), WORK, f"filters-{width}")
    ways = {
        "remap": ("rgb8", "rectify", {"calibration": str(stretched(width, height))}, "rectified"),
        "gray": ("rgb8", "gray", {}, "gray"),
        "debayer": ("bayer_rg8", "debayer", {}, "color"),
        "yuyv": ("yuyv", "color", {}, "converted"),
        "pip": ("rgb8", "pip", {}, "composed"),
    }
    for name, (pixels, class_, config, output) in ways.items():
        filter_ = {"class": f"vision-filters/{class_}", "config": config}
        system.frames(name, pixels, (width, height), filter_, ("image", output))
    small = {"width": width // 3, "height": height // 3}
    system.components["host/inset"] = {"class": f"{built.LEDGER}/blank_source", "config": small, "execution": {"model": "stream", "rate_hz": 10}}
    system.connect("host/pip-filter/inset", "host/inset/image")
    return turns(system, theirs, rounds, lambda name, them, us: line(name, f"{width}x{height}", them, us))


def agreement(width, height):
    """Shares of the bytes that are OpenCV's, and that are within a level of them."""
    rgb, sensor, yuyv, _ = images(width, height)
    for name, image in zip(("rgb", "sensor", "yuyv"), (rgb, sensor, yuyv)):
        image.tofile(WORK / f"{name}.raw")
    raw = (WORK / f"{name}.raw" for name in ("rgb", "sensor", "yuyv"))
    ours("filters_bench", 1, *raw, width, height, CALIBRATION, WORK / "made")
    maps = scaled_maps(json.loads(CALIBRATION.read_text()), width, height)
    theirs = {"remap": cv2.remap(rgb, *maps, cv2.INTER_LINEAR), "gray": cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY),
              "debayer": cv2.cvtColor(sensor, cv2.COLOR_BayerRGGB2RGB), "yuyv": cv2.cvtColor(yuyv, cv2.COLOR_YUV2RGB_YUYV)}
    figures = {}
    for name, image in theirs.items():
        made = np.fromfile(WORK / f"made.{name}", np.uint8).reshape(image.shape)
        # At the rim a debayer has its own ways.
        inner = (slice(1, -1), slice(1, -1)) if name == "debayer" else ...
        differ = np.abs(made[inner].astype(int) - image[inner])
        figures[name] = {"within_1": round(float((differ <= 1).mean()), 6), "equal": round(float((differ == 0).mean()), 6)}
    return figures


def oct_times(samples, rounds):
    """The design's chain without the surface, by the same interpolation, in f32 on both sides, 64 lines at a time. The plugin gives
    bytes for pictures besides, and follows its background."""
    spectra = np.random.default_rng(1).integers(1000, 3000, (4 * LINES, samples), np.uint16)
    file = WORK / f"spectra-{samples}.raw"
    spectra.astype("<u2").tofile(file)
    system = built.System(built.programs(TARGET), WORK, f"oct-{samples}")
    kinds = ("linear", "cubic")
    line_rate_hz = 200_000 if samples == 1024 else 100_000
    source = {"path": str(file), "samples": samples, "line_rate_hz": line_rate_hz, "exposure_s": 0, "max_lines": LINES}
    for kind in kinds:
        config = {"samples": samples, "interpolation": kind, "dispersion_rad": [18.0, 4.0]}
        system.spectra(kind, source, config, line_rate_hz / LINES)
    frames = spectra.reshape(4, LINES, samples)
    chains = {kind: oct_chain(samples, kind, spectra) for kind in kinds}
    theirs = {kind: (lambda n, chain=chain: chain(frames[n % 4])) for kind, chain in chains.items()}
    return turns(system, theirs, rounds, lambda kind, them, us: line(f"oct {kind}", str(samples), them, us, "numpy", LINES))


def oct_chain(samples, kind, spectra):
    """Background, k-linearisation by two or four points (Catmull-Rom), window and dispersion, FFT, dB of one frame; f32."""
    import scipy.fft
    background = spectra.mean(axis=0, dtype=np.float32)
    k = 2 * np.pi / np.linspace(790e-9, 890e-9, samples)
    place = np.interp(np.linspace(k[-1], k[0], samples), k[::-1], np.arange(samples)[::-1])
    low = np.clip(place.astype(np.int64), 0, samples - 2)
    t = (place - low).astype(np.float32)
    taps = [low, low + 1]
    weights = [1 - t, t]
    if kind == "cubic":
        taps = [np.clip(low + i, 0, samples - 1) for i in (-1, 0, 1, 2)]
        weights = [0.5 * (-t + 2 * t**2 - t**3), 0.5 * (2 - 5 * t**2 + 3 * t**3), 0.5 * (t + 4 * t**2 - 3 * t**3), 0.5 * (t**3 - t**2)]
    weights = [weight.astype(np.float32) for weight in weights]
    x = np.linspace(-1, 1, samples)
    window = (np.hanning(samples) * np.exp(1j * (18 * x**2 + 4 * x**3))).astype(np.complex64)

    def chain(frame):
        clean = frame.astype(np.float32) - background
        even = clean[:, taps[0]] * weights[0]
        for tap, weight in zip(taps[1:], weights[1:]):
            even += clean[:, tap] * weight
        depth = scipy.fft.fft(even * window, axis=1, workers=1)[:, :samples // 2]
        assert depth.dtype == np.complex64
        return 10 * np.log10(depth.real**2 + depth.imag**2 + np.float32(1e-9))

    return chain


if __name__ == "__main__":
    main()
