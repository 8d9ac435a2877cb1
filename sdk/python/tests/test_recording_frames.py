"""Promise: a frame's numbers are those that were sent, and its picture shows them, or says what was done to them."""

import io
import struct
import tracemalloc
import warnings

import numpy as np
import pytest
from PIL import Image

import trocar
from trocar import _frames
from trocar._png import qoi

from .files import File, compressed_image, oct_lines, raw_image, schema


def gradient(height, width, colours, dtype="u1"):
    return (np.arange(height * width * colours).reshape(height, width, colours) * 7).astype(dtype)


def recorded(path, topics):
    """A recording of these messages by topic, a second apart."""
    file = File(path, chunk_size=1, enable_crcs=False)
    for name, (kind, values) in topics.items():
        channel = file.topic(name, kind)
        for i, value in enumerate(values):
            file.add(channel, 10**9 * i + 7, kind[1](**value), 10**9 * i)
    return trocar.Recording(file.close())


def image(pixels, encoding, gap=0):
    rows = np.ascontiguousarray(pixels).view("u1").reshape(len(pixels), -1)
    padded = np.pad(rows, ((0, 0), (0, gap)), constant_values=99)
    return {"width": pixels.shape[1], "height": len(pixels), "encoding": encoding, "step": padded.shape[1], "data": padded.tobytes()}


def shown(data):
    return np.array(Image.open(io.BytesIO(data)))


@pytest.mark.parametrize("encoding, colours", [("mono8", 1), ("rgb8", 3), ("bgr8", 3), ("rgba8", 4), ("bayer_rggb8", 1)])
def test_a_picture_has_the_pixels_that_were_sent(tmp_path, encoding, colours):
    pixels = gradient(5, 8, colours)
    rec = recorded(tmp_path / "a.mcap", {"/eye/image": (raw_image(), [image(pixels, encoding, gap=3)] * 3)})
    frame = rec["eye/image"].frames[1]
    assert frame.format == encoding and (frame.stamp_ns, frame.log_time) == (10**9, 10**9 + 7) and frame.t == pytest.approx(1 - 7e-9)
    assert (frame.array.reshape(pixels.shape) == pixels).all() and (np.asarray(frame) == frame.array).all() and frame.shown == ""
    expected = pixels[:, :, ::-1] if encoding == "bgr8" else pixels
    assert (shown(frame._repr_png_()).reshape(pixels.shape) == expected).all() and frame._repr_html_() is None
    assert frame.to_png(tmp_path / "a.png") == "" and (tmp_path / "a.png").read_bytes() == frame._repr_png_()


def test_frames_are_taken_by_number_by_slice_and_one_after_the_other(tmp_path):
    pictures = [image(np.full((2, 2, 1), n, "u1"), "mono8") for n in range(5)]
    rec = recorded(tmp_path / "a.mcap", {"/eye/image": (raw_image(), pictures)})
    for frames in (rec["/eye/image"].frames, trocar.read(tmp_path / "a.mcap")["/eye/image"].frames):
        assert len(frames) == 5 and frames[-1].array[0, 0] == 4 and [f.array[0, 0] for f in frames[::2]] == [0, 2, 4]
        assert [f.array[0, 0] for f in frames] == [0, 1, 2, 3, 4] and frames.stamps.tolist() == [n * 10**9 for n in range(5)]
        with pytest.raises(IndexError, match="has 5 frames; 5 is none of them"):
            frames[5]
    assert rec["/eye/image"].frame(3).array[0, 0] == 3


def test_numbers_and_a_loop_agree_where_a_frame_cannot_be_read(tmp_path):
    kind = raw_image()
    file = File(tmp_path / "a.mcap")
    channel = file.topic("/eye", kind)
    for n in range(4):
        pixels = image(np.full((2, 2, 1), n, "u1"), "mono8")
        file.add(channel, n, b"\xff\xff\xff" if n == 1 else kind[1](**pixels))
    path, messages = file.close(), trocar.Recording(file.path)
    assert len(messages["eye"].messages) == 3
    for rec in (trocar.Recording(path), trocar.read(path), messages):
        frames = rec["eye"].frames
        for found in ([f for f in frames], frames[:], [frames[n] for n in range(-4, 0)]):
            assert [f.stamp_ns for f in found] == frames.stamps.tolist() == [0, 1, 2, 3] and len(frames) == 4
            assert [f.array[0, 0] for f in found if f.value is not None] == [0, 2, 3]
            assert found[1].value is None and found[1].data == b"\xff\xff\xff" and found[1]._repr_png_() is None and repr(found[1])
            with pytest.raises(trocar.TrocarError, match="it is not what its type says"):
                found[1].array
        assert rec["eye"].unreadable == 1 and len(rec["eye"].messages) == 3


def test_a_file_that_is_shortened_meanwhile_says_so(tmp_path):
    pictures = [image(np.full((2, 2, 1), n, "u1"), "mono8") for n in range(5)]
    frames = recorded(tmp_path / "a.mcap", {"/eye": (raw_image(), pictures)})["eye"].frames
    assert len(frames) == 5
    with open(tmp_path / "a.mcap", "r+b") as out:
        out.truncate(100)
    with pytest.raises(trocar.TrocarError, match="frame 2 of /eye cannot be read any more: it ends before byte"):
        frames[2]


def test_colours_take_little_room_and_are_made_once_for_a_picture_in_a_notebook(tmp_path, monkeypatch):
    values = np.arange(500_000, dtype="<u2").reshape(500, 1000)
    tracemalloc.start()
    try:
        pixels, low, high = _frames.coloured(values)
        assert tracemalloc.get_traced_memory()[1] < 12 * values.nbytes
    finally:
        tracemalloc.stop()
    assert pixels.shape == (500, 1000, 3) and (low, high) == (0, 65535)
    assert pixels[0, 0].tolist() == [35, 23, 27] and pixels[65, 535].tolist() == [144, 13, 0], "the ends of turbo"
    made, coloured = [], _frames.coloured
    monkeypatch.setattr(_frames, "coloured", lambda v: made.append(1) or coloured(v))
    rec = recorded(tmp_path / "a.mcap", {"/wide": (raw_image(), [image(values[:4, :4, None], "mono16")])})
    assert "colours from" in rec["/wide"].frames[0]._repr_html_() and len(made) == 1


@pytest.mark.parametrize("values", [[[np.nan, np.inf]], [[3.0, 3.0]], [[-3.4e38, 3.4e38]]])
def test_colours_of_odd_numbers_are_some(values):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pixels, low, high = _frames.coloured(np.array(values, "f4"))
    assert pixels.shape == (1, 2, 3) and low <= high and pixels.any() == np.isfinite(values).any()


def test_sixteen_bit_and_depth_are_coloured_and_say_so(tmp_path):
    depth = np.array([[0.5, 1.0], [np.nan, 2.5]], "f4")
    disparity = np.array([[-16, 0], [16, 32]], "i2")
    wide = np.array([[0, 1000], [40000, 65535]], "u2")
    topics = {
        "/depth": (raw_image(), [image(depth[:, :, None], "32FC1")]),
        "/disparity": (raw_image(), [image(disparity[:, :, None], "16SC1")]),
        "/wide": (raw_image(), [image(wide[:, :, None], "mono16")]),
    }
    rec = recorded(tmp_path / "a.mcap", topics)
    frame = rec["/depth"].frames[0]
    assert np.array_equal(frame.array, depth, equal_nan=True) and frame.shown == "32FC1: colours from 0.5 (blue) to 2.5 (red)"
    picture = shown(frame._repr_png_())
    assert picture.shape == (2, 2, 3) and picture[1, 0].tolist() == [0, 0, 0] and picture[1, 1, 0] > picture[1, 1, 2]
    assert "colours from 0.5" in frame._repr_html_() and frame.to_png(tmp_path / "d.png") == frame.shown
    assert (rec["/disparity"].frames[0].array == disparity).all() and "from -16" in rec["/disparity"].frames[0].shown
    exact = rec["/wide"].frames[0]
    assert exact.to_png(tmp_path / "w.png") == "" and (shown((tmp_path / "w.png").read_bytes()) == wide).all(), "16 bit stay in a file"
    assert "mono16: colours from 0" in exact.shown


def test_lines_of_an_oct_are_rows(tmp_path):
    values = np.arange(12, dtype="<u2").reshape(3, 4)
    floats = np.array([[1.5, np.inf]], "<f4")
    lines = [
        {"lines": 3, "samples": 4, "format": 1, "data": values.tobytes() + b"more"},
        {"lines": 1, "samples": 2, "format": 2, "data": floats.tobytes()},
        {"lines": 9, "samples": 4, "format": 1, "data": values.tobytes()},
    ]
    frames = recorded(tmp_path / "a.mcap", {"/oct": (oct_lines(), lines)})["oct"].frames
    assert (frames[0].array == values).all() and frames[0].format == "U16" and (frames[1].array == floats).all()
    assert frames[0]._repr_png_() and frames[2]._repr_png_() is None
    with pytest.raises(trocar.TrocarError, match="24 bytes for 9 lines of 4"):
        frames[2].array


def test_jpeg_is_handed_on_as_it_is(tmp_path):
    made = io.BytesIO()
    Image.fromarray(gradient(16, 16, 3)).save(made, "JPEG")
    messages = [{"format": "jpeg", "data": made.getvalue()}, {"format": "jpeg", "data": b"\xff\xd8nothing"}]
    frames = recorded(tmp_path / "a.mcap", {"/eye": (compressed_image(), messages)})["eye"].frames
    assert frames[0]._repr_jpeg_() == made.getvalue() and frames[0]._repr_png_() is None and frames[0].array.shape == (16, 16, 3)
    with pytest.raises(trocar.TrocarError, match="it is no jpeg image"):
        frames[1].array


# A pixel of each kind of QOI: RGB, a run of two, a difference, luma, RGBA, and one that was seen before.
QOI = bytes([0xFE, 10, 20, 30, 0xC1, 0x40 | 3 << 4 | 2 << 2 | 1, 0x80 | 40, 0x9A, 0xFF, 1, 2, 3, 4])
SEEN = [[10, 20, 30, 255]] * 3 + [[11, 20, 29, 255], [20, 28, 39, 255], [1, 2, 3, 4], [10, 20, 30, 255]]


def qoi_file(width, height, body, channels=4):
    return b"qoif" + struct.pack(">IIBB", width, height, channels, 0) + body + bytes(7) + b"\1"


def test_qoi_is_what_its_specification_says(tmp_path):
    place = (10 * 3 + 20 * 5 + 30 * 7 + 255 * 11) % 64
    data = qoi_file(7, 1, QOI + bytes([place]))
    assert qoi(data)[0].tolist() == SEEN
    frames = recorded(tmp_path / "a.mcap", {"/eye": (compressed_image(), [{"format": "qoi", "data": data}])})["eye"].frames
    assert (shown(frames[0]._repr_png_()) == frames[0].array).all() and frames[0].array.shape == (1, 7, 4)
    for bad in (
        b"",
        b"qoif",
        data[:16],
        qoi_file(1 << 16, 1 << 16, b""),
        qoi_file(0, 1, b""),
        qoi_file(1, 1, QOI, 5),
        qoi_file(60, 9, QOI),
    ):
        assert qoi(bad) is None, bad


def test_pixels_that_are_not_there_or_not_known_are_refused_and_never_guessed(tmp_path):
    good = image(gradient(4, 4, 3), "rgb8")
    bad = [{**good, "height": 5}, {**good, "step": 2}, {**good, "width": 0}, {**good, "encoding": "x12"}, {**good, "width": 1 << 31}]
    frames = recorded(tmp_path / "a.mcap", {"/eye": (raw_image(), bad)})["eye"].frames
    for frame in frames:
        with pytest.raises(trocar.TrocarError, match="cannot be shown as numbers: .*; `data` has its bytes"):
            frame.array
        assert frame._repr_png_() is None and frame.data == good["data"] and repr(frame)


def test_both_images_of_a_pair_belong_together(tmp_path):
    kind = raw_image()
    file = File(tmp_path / "a.mcap")
    sides = [file.topic(f"/host/eye/image/{side}", kind) for side in ("left", "right")]
    for i in range(4):
        for side, channel in enumerate(sides):
            if (i, side) != (1, 1):
                pixels = np.full((2, 3, 3), 10 * i + side, "u1")
                file.add(channel, i, kind[1](**image(pixels, "rgb8")))
    rec = trocar.Recording(file.close())
    pair = rec["host/eye/image"]
    assert len(pair.frames) == 4 and pair.left is rec["host/eye/image/left"] and pair.lost is None
    frame = pair.frames[2]
    assert frame.array.shape == (2, 2, 3, 3) and frame.array[:, 0, 0, 0].tolist() == [20, 21] and frame.right.array[0, 0, 0] == 21
    assert shown(frame._repr_png_()).shape == (2, 6, 3) and frame.to_png(tmp_path / "p.png") == ""
    assert pair.frames[1].right is None
    with pytest.raises(trocar.TrocarError, match="the right image at .* was not recorded"):
        pair.frames[1].array
    assert [f.left.stamp_ns for f in pair.frames] == [0, 1, 2, 3] and "host/eye/image" in rec._ipython_key_completions_()


def test_a_topic_without_frames_says_who_has_some(tmp_path):
    kind = schema()
    topics = {"/arm": (kind, [{"n": 1}]), "/eye": (raw_image(), [image(gradient(2, 2, 1), "mono8")])}
    rec = recorded(tmp_path / "a.mcap", topics)
    with pytest.raises(trocar.TrocarError, match="/arm has no frames; /eye has"):
        rec["/arm"].frames
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert rec["/eye"].to_numpy()["data"].tolist() == [4]
