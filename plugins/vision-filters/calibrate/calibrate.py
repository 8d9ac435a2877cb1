#!/usr/bin/env python3
"""Makes the calibration that `rectify` and `stereo_depth` read, from pictures of a chessboard.

    python3 -m venv venv && venv/bin/pip install -r requirements.txt
    venv/bin/python calibrate.py tests/data/chessboard --square 0.025 --output calibration.json

The folder holds left*.jpg/png and right*.jpg/png of one size. Pairs on which the board is not found in both pictures are
named and left out. `--corners FILE` writes the corners that were found, `--reference DIR` parts of rectified pictures:
both are what the plugin's tests compare with.
"""

import argparse
import json
import pathlib
import sys

import cv2
import numpy as np

FORMAT, VERSION = "trocar-stereo-calibration", 1
# Left upper corner of the reference parts, and their size, px.
PARTS, PART_SIZE = [(0, 0), (240, 180), (480, 360)], (160, 120)


def main():
    args = arguments()
    pairs = read_pairs(args.folder)
    board = (args.columns, args.rows)
    found, left_out = {}, []
    for name, (left, right) in pairs.items():
        corners = [find_corners(image, board) for image in (left, right)]
        if any(c is None for c in corners):
            left_out.append(name)
        else:
            found[name] = corners
    if len(found) < 3:
        sys.exit(f"calibrate.py: {args.folder}: the board of {board[0]} x {board[1]} inner corners was found in {len(found)} "
                 "pairs, and 3 are needed: take more pictures, or give --columns and --rows")
    height, width = next(iter(pairs.values()))[0].shape
    calibration = calibrate(found, board, args.square, (width, height))
    calibration["pairs"] = {"used": sorted(found), "left_out": left_out}
    errors = row_errors(calibration, found)
    calibration["errors_px"]["rectified_rows"] = float(np.sqrt(np.mean(errors**2)))
    args.output.write_text(json.dumps(calibration, indent=1) + "\n")
    print(json.dumps({"pairs": len(found), "left_out": left_out, **calibration["errors_px"]}))
    if args.corners:
        listed = {n: [np.round(c.reshape(-1, 2), 4).tolist() for c in corners] for n, corners in found.items()}
        args.corners.write_text(json.dumps(listed) + "\n")
    if args.reference:
        write_reference(calibration, pairs, args.reference)


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=pathlib.Path, help="left* and right* pictures of the board")
    parser.add_argument("--columns", type=int, default=9, help="inner corners of a row of the board (9)")
    parser.add_argument("--rows", type=int, default=6, help="inner corners of a column of the board (6)")
    parser.add_argument("--square", type=float, required=True, help="side of a square, m")
    parser.add_argument("--output", type=pathlib.Path, required=True, help="JSON file to write")
    parser.add_argument("--corners", type=pathlib.Path, help="JSON file for the corners that were found")
    parser.add_argument("--reference", type=pathlib.Path, help="folder for parts of rectified pictures")
    args = parser.parse_args()
    if not args.square > 0:
        parser.error(f"--square {args.square} m is not above 0")
    return args


def read_pairs(folder):
    """Grey pictures, left and right, by what follows `left` in the file's name."""
    pairs = {}
    for left in sorted(p for p in folder.glob("left*") if p.suffix.lower() in (".png", ".jpg", ".jpeg")):
        right = left.with_name("right" + left.name[len("left"):])
        images = [cv2.imread(str(p), cv2.IMREAD_GRAYSCALE) for p in (left, right)]
        for path, image in zip((left, right), images):
            if image is None:
                sys.exit(f"calibrate.py: {path}: is missing or no picture")
        pairs[left.stem[len("left"):]] = images
    if not pairs:
        sys.exit(f"calibrate.py: {folder}: no left*.png or left*.jpg here")
    sizes = {image.shape for images in pairs.values() for image in images}
    if len(sizes) > 1:
        sys.exit(f"calibrate.py: {folder}: pictures of different sizes: {sorted(sizes)}")
    return pairs


def find_corners(image, board):
    there, corners = cv2.findChessboardCorners(image, board)
    if not there:
        return None
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-4)
    return cv2.cornerSubPix(image, corners, (5, 5), (-1, -1), criteria)


def calibrate(found, board, square_m, size):
    grid = np.zeros((board[0] * board[1], 3), np.float32)
    grid[:, :2] = np.mgrid[0:board[0], 0:board[1]].T.reshape(-1, 2) * square_m
    grids = [grid] * len(found)
    points = [[corners[eye] for corners in found.values()] for eye in (0, 1)]
    cameras = [cv2.calibrateCamera(grids, p, size, None, None)[:3] for p in points]
    (left_rms, k1, d1), (right_rms, k2, d2) = cameras
    stereo_rms, k1, d1, k2, d2, rotation, translation, _, _ = cv2.stereoCalibrate(
        grids, *points, k1, d1, k2, d2, size, flags=cv2.CALIB_FIX_INTRINSIC)
    r1, r2, p1, p2, *_ = cv2.stereoRectify(k1, d1, k2, d2, size, rotation, translation,
                                           flags=cv2.CALIB_ZERO_DISPARITY, alpha=0)
    side = lambda k, d, r, p: {"matrix": k.tolist(), "distortion": d.ravel().tolist(),
                               "rectification": r.tolist(), "projection": p.tolist()}
    return {
        "format": FORMAT,
        "version": VERSION,
        "made_with": f"calibrate.py, OpenCV {cv2.__version__}",
        "image_size": list(size),
        "left": side(k1, d1, r1, p1),
        "right": side(k2, d2, r2, p2),
        "rotation": rotation.tolist(),
        "translation_m": translation.ravel().tolist(),
        "errors_px": {"left": left_rms, "right": right_rms, "stereo": stereo_rms},
    }


def camera(calibration, eye):
    side = calibration[eye]
    return [np.array(side[key]) for key in ("matrix", "distortion", "rectification", "projection")]


def row_errors(calibration, found):
    """How far apart the rows of each corner are in the rectified pictures, px."""
    rows = []
    for n, eye in enumerate(("left", "right")):
        k, d, r, p = camera(calibration, eye)
        # To the end: the usual five rounds leave some hundredths of a pixel at the rim.
        criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-9)
        points = [cv2.undistortPoints(c[n], k, d, None, r, p[:, :3], criteria)[:, 0, 1] for c in found.values()]
        rows.append(np.concatenate(points))
    return rows[0] - rows[1]


def write_reference(calibration, pairs, folder):
    """Parts of the first pair's pictures, and of what OpenCV's fixed-point remap makes of them."""
    folder.mkdir(parents=True, exist_ok=True)
    size = tuple(calibration["image_size"])
    name = sorted(pairs)[0]
    for image, eye in zip(pairs[name], ("left", "right")):
        k, d, r, p = camera(calibration, eye)
        maps = cv2.initUndistortRectifyMap(k, d, r, p, size, cv2.CV_16SC2)
        # Colours of which each is another picture, so that a test sees when they are mixed up.
        color = np.dstack([image, 255 - image, image[::-1]])
        rectified = cv2.remap(color, *maps, cv2.INTER_LINEAR)
        # OpenCV writes blue first.
        cv2.imwrite(str(folder / f"{eye}{name}.png"), cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)[..., 0])
        for x, y in PARTS:
            part = rectified[y:y + PART_SIZE[1], x:x + PART_SIZE[0]]
            cv2.imwrite(str(folder / f"{eye}{name}_{x}_{y}.png"), part[..., ::-1])


if __name__ == "__main__":
    main()
