"""Promise: an open recording reads no more of its file than is asked for, tells what is in it, and never believes what is damaged."""

import os
import struct
import tracemalloc

import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.writer import CompressionType, IndexType

import trocar
from trocar import _chunks

from .files import File, oct_lines, schema, types, write

THINGS = "/robot/arm/state"


@pytest.fixture
def bytes_read(monkeypatch):
    """The number of bytes of the file that were read since the test began."""
    count = [0]
    pread = os.pread

    def counted(*args):
        got = pread(*args)
        count[0] += len(got)
        return got

    monkeypatch.setattr(_chunks.os, "pread", counted)
    return lambda: count[0]


WAYS = {
    "lz4": {},
    "zstd": {"compression": CompressionType.ZSTD},
    "plain": {"compression": CompressionType.NONE},
    "no checksums": {"compression": CompressionType.NONE, "enable_crcs": False},
    "no index": {"index_types": IndexType.NONE},
    "no summary": {"use_statistics": False, "use_summary_offsets": False, "repeat_channels": False, "repeat_schemas": False},
    "no chunks": {"use_chunking": False},
}


@pytest.mark.parametrize("way", WAYS)
def test_a_recording_is_the_same_however_it_was_written(tmp_path, way):
    with trocar.Recording(write(tmp_path / "a.mcap", 300, **WAYS[way])) as rec:
        assert rec.complete and rec.profile == "trocar" and rec.why == "" and list(rec) == ["/recorder/note", THINGS]
        arm = rec["robot/arm/state"]
        assert arm is rec[THINGS] and arm is rec.topics[THINGS]
        assert (arm.count, arm.first, arm.last, arm.type, arm.units) == (300, 0.0, 0.299, "trocar.Thing_0123", {})
        assert arm.rate_hz == pytest.approx(1000) and rec.duration_s == 1.0
        assert arm.n.tolist() == list(range(300)) and arm.publish_time[7] == 1_006_000_000
        assert [s.value.n for s in arm] == list(range(300)) and next(iter(arm)).t == -0.001
        assert rec.metadata == {"trocar": {"version": "1"}}
        told = trocar.read(tmp_path / "a.mcap")
        assert told.complete and (told[THINGS].x == arm.x).all() and len(told) == 2


def test_opening_and_one_topic_of_many_read_little_of_the_file(tmp_path, bytes_read):
    kind = schema()
    file = File(tmp_path / "a.mcap", chunk_size=64 << 10)
    large, small = file.topic("/large"), file.topic("/small", kind)
    for i in range(4000):
        file.add(large, i * 1000, {"text": "x" * 4000})
        if i % 1000 == 0:
            file.add(small, i * 1000 + 1, kind[1](n=i))
    size = os.path.getsize(file.close())
    rec = trocar.Recording(file.path)
    assert repr(rec) and rec["/large"].count == 4000 and bytes_read() < size / 20, (bytes_read(), size)
    assert rec["/small"].n.tolist() == [0, 1000, 2000, 3000] and bytes_read() < size / 10, (bytes_read(), size)


def test_a_frame_of_a_large_file_is_read_alone(tmp_path, bytes_read):
    file = File(tmp_path / "a.mcap", chunk_size=1, enable_crcs=False)
    kind = oct_lines()
    frames = file.topic("/oct", kind)
    for i in range(100):
        file.add(frames, i, kind[1](data=bytes([i]) * 100_000))
    file.close()
    rec = trocar.Recording(file.path)
    assert rec["/oct"].frames[17].array[0] == 17 and bytes_read() < 200_000, bytes_read()
    assert len(rec["/oct"].frames) == 100 and rec["/oct"].log_time.tolist() == list(range(100)) and bytes_read() < 300_000, bytes_read()


def test_first_and_last_are_the_earliest_and_the_latest_wherever_they_lie(tmp_path):
    # Messages lie out of order, and chunks hold one, some or all of them.
    for size in (1, 60, 90, 120, 150, 400, 4000):
        file = File(tmp_path / f"{size}.mcap", chunk_size=size)
        a, b = file.topic("/a"), file.topic("/b")
        for log, topic in ((0, b), (50, a), (10, b), (20, a), (60, b), (70, a), (65, a), (100, b)):
            file.add(topic, log, {"n": log})
        rec = trocar.Recording(file.close())
        assert (rec["a"].first_ns, rec["a"].last_ns, rec["b"].first_ns, rec["b"].last_ns) == (20, 70, 0, 100), size
        assert rec.begin_ns == 0 and rec["a"]["n"].tolist() == [50, 20, 70, 65]


def test_a_wrong_name_is_refused_with_the_nearest_and_keys_are_completed(tmp_path):
    rec = trocar.Recording(write(tmp_path / "a.mcap"))
    with pytest.raises(KeyError, match=r"no topic 'arm/state'; did you mean /robot/arm/state\? It has "):
        rec["arm/state"]
    with pytest.raises(KeyError, match="did you mean /robot/arm/state"):
        rec["robot/arm/sttae"]
    with pytest.raises(KeyError, match="topics by name"):
        rec[3]
    assert {"robot/arm/state", THINGS} <= set(rec._ipython_key_completions_()) and "x" in dir(rec[THINGS])


def test_names_of_a_file_do_no_harm_where_they_are_shown(tmp_path):
    file = File(tmp_path / "a.mcap")
    file.add(file.topic("/<script>\x1b[2J"), 1, {"n": 1})
    rec = trocar.Recording(file.close())
    assert "<script>" not in rec._repr_html_() and "&lt;script&gt;" in rec._repr_html_() and "\x1b" not in rec._repr_html_() + repr(rec)


def test_what_the_recorder_told_is_at_hand(tmp_path):
    log = types("foxglove.Log", [("Log", [("message", 9, False, "", False)])])
    file = File(tmp_path / "a.mcap")
    value = file.topic("/host/sine/value")
    graph, config, markers = file.topic("/recorder/graph"), file.topic("/recorder/config"), file.topic("/recorder/markers", log)
    image = file.topic("/host/eye/image/left")
    for at, said in ((0, "first"), (5_000_000_000, "second")):
        file.add(graph, at, {"components": [{"path": said}]})
        file.add(config, at, {"path": "host/sine", "config": {"n": said}})
    file.add(markers, 2_500_000_000, log[1](message="half way"))
    file.add(image, 1, {"n": 1})
    file.add(value, 1, {"n": 1})
    file.tell("trocar.clock", offset_to_unix_ns="1700000000000000000")
    file.tell("trocar.plugins", sine="0.1.0 sha256:12")
    file.tell(
        "trocar.end",
        lost="7",
        interrupted="1",
        **{"lost:/host/eye/image": "7", "interrupted:/host/sine/value": "1", "messages:/host/quiet/out": "0"},
    )
    rec = trocar.Recording(file.close())
    assert rec.graph["components"][0]["path"] == "first" and rec.graph_at(6)["components"][0]["path"] == "second"
    assert rec.config == {"host/sine": {"n": "first"}} and rec.config_at(6) == {"host/sine": {"n": "second"}}
    assert [(m.t, m.text) for m in rec.markers] == [(2.5, "half way")] and rec.plugins == {"sine": "0.1.0 sha256:12"}
    assert rec.losses.told and rec.losses.final and rec.losses.lost == 7 and rec.losses["host/eye/image"].lost == 7
    assert rec["host/eye/image/left"].lost == 7 and rec["host/sine/value"].lost == 0 and rec["host/sine/value"].interrupted == 1
    assert rec["host/quiet/out"].silent and rec["host/quiet/out"].count == 0 and not rec["host/sine/value"].silent
    assert "gave nothing" in repr(rec) and "7 lost" in repr(rec) and rec.begin.year == 2023


def test_losses_of_a_file_without_an_end_are_what_was_told_last(tmp_path):
    file = File(tmp_path / "a.mcap")
    loss = file.topic("/recorder/loss")
    for n in (1, 5):
        file.add(loss, n, {"topics": {"/a": n}, "interrupted": {}, "silent": ["/b"]})
    rec = trocar.Recording(cut(file.close(), 0))
    assert rec.losses.lost == 5 and rec.losses.told and not rec.losses.final and rec.losses.silent == {"/b"} and not rec.complete
    nothing = trocar.Recording(write(tmp_path / "b.mcap"))
    assert not nothing.losses.told and nothing[THINGS].lost is None and "not told" in repr(nothing.losses)


def cut(path, more):
    """The file without its index and its end, and without so much more."""
    whole = path.read_bytes()
    (begin,) = struct.unpack("<Q", whole[-28:-20])
    path.write_bytes(whole[: begin - more])
    return path


def test_a_file_that_is_cut_off_or_is_being_written_gives_what_there_is(tmp_path):
    for name, more, tail in (("index", 0, b""), ("middle", 2500, b""), ("room", 2500, b"\0" * 65536)):
        path = cut(write(tmp_path / f"{name}.mcap", 1000, compression=CompressionType.NONE), more)
        path.write_bytes(path.read_bytes() + tail)
        rec = trocar.Recording(path)
        n = rec[THINGS].n
        assert not rec.complete and "no end" in rec.why and n.tolist() == list(range(len(n))) and len(n) > 900, (name, len(n))
        assert rec[THINGS].count == len(n) and "not complete" in repr(rec)


def test_a_chunk_with_a_wrong_checksum_is_left_out_whole_and_told(tmp_path):
    path = write(tmp_path / "a.mcap", 1000, compression=CompressionType.NONE)
    whole = bytearray(path.read_bytes())
    at = whole.index(b"n500")
    whole[at] = ord("m")
    path.write_bytes(whole)
    for rec in (trocar.Recording(path), trocar.read(path)):
        n = rec[THINGS].n
        assert 900 < len(n) < 1000 and 500 not in n and n[0] == 0 and n[-1] == 999
        assert not rec.complete and "another checksum" in rec.why


def test_packed_bytes_that_make_more_than_their_chunk_says_are_not_unpacked():
    large = bytes(16 << 20)
    told = zstandard.ZstdCompressor().compress(large)
    untold = zstandard.ZstdCompressor(write_content_size=False).compress(large)
    tracemalloc.start()
    try:
        for data in (told, untold):
            with pytest.raises(_chunks.Damaged, match="says"):
                _chunks._unpacked(data, "zstd", 100, 0)
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()
    for size in (True, False):
        data = zstandard.ZstdCompressor(write_content_size=size).compress(large)
        assert _chunks._unpacked(data, "zstd", len(large), 0) == large
    packed = lz4.frame.compress(large)
    with pytest.raises(_chunks.Damaged, match="has 101 bytes where it says 100"):
        _chunks._unpacked(packed, "lz4", 100, 0)
    assert _chunks._unpacked(packed, "lz4", len(large), 0) == large
    with pytest.raises(_chunks.Damaged):
        _chunks._unpacked(b"no zstd at all", "zstd", 100, 0)


def test_a_chunk_of_more_than_a_machine_holds_is_not_read(tmp_path, monkeypatch):
    path = write(tmp_path / "a.mcap", 100, compression=CompressionType.NONE)
    monkeypatch.setattr(_chunks, "_LARGEST", 500)
    rec = trocar.Recording(path)
    assert len(rec[THINGS].n) < 100 and "a length that cannot be" in rec.why


def test_a_wrong_index_is_not_believed(tmp_path):
    path = write(tmp_path / "a.mcap", 1000)
    whole = bytearray(path.read_bytes())
    (begin,) = struct.unpack("<Q", whole[-28:-20])
    whole[begin + 200] ^= 0xFF
    path.write_bytes(whole)
    rec = trocar.Recording(path)
    assert rec[THINGS].n.tolist() == list(range(1000)) and not rec.complete and "index is damaged" in rec.why


@pytest.mark.parametrize("content", [b"", b"PNG", b"\x89MCAP0\r", b"\x89MCAP1\r\n", b"x" * 4096])
def test_what_is_no_recording_is_refused(tmp_path, content):
    (tmp_path / "x.mcap").write_bytes(content)
    with pytest.raises(trocar.TrocarError, match="is no MCAP file"):
        trocar.Recording(tmp_path / "x.mcap")
    for nothing in (tmp_path / "none.mcap", tmp_path):
        with pytest.raises(trocar.TrocarError, match="cannot be read"):
            trocar.Recording(nothing)


def test_an_empty_recording_has_no_topics(tmp_path):
    rec = trocar.Recording(File(tmp_path / "a.mcap").close())
    assert rec.complete and len(rec) == 0 and rec.duration_s == 0 and rec.markers == [] and rec.graph is None
    with pytest.raises(KeyError, match="it has none"):
        rec["a"]
    (tmp_path / "b.mcap").write_bytes(b"\x89MCAP0\r\n")
    assert not trocar.Recording(tmp_path / "b.mcap").complete


def test_messages_that_are_not_what_their_type_says_are_left_out_and_told(tmp_path):
    kind = schema()
    file = File(tmp_path / "a.mcap")
    things = file.topic("/a", kind)
    for data in (kind[1](n=1), b"\xff\xff\xff", kind[1](n=3)):
        file.add(things, 1, data)
    rec = trocar.Recording(file.close())
    assert rec["/a"].n.tolist() == [1, 3] and len(rec["/a"].log_time) == 2 and rec["/a"].unreadable == 1
    assert not rec.complete and "/a" in rec.why


def test_an_encoding_that_is_not_known_gives_bytes(tmp_path):
    file = File(tmp_path / "a.mcap", profile="ros2")
    file.add(file.topic("/imu", encoding="cdr"), 5, b"\0\1\2")
    rec = trocar.Recording(file.close())
    assert rec["/imu"].messages == [b"\0\1\2"] and rec["/imu"].fields == [] and rec.profile == "ros2"
    assert isinstance(rec["/imu"].log_time, np.ndarray)


def test_a_recording_that_is_closed_says_so(tmp_path):
    with trocar.Recording(write(tmp_path / "a.mcap")) as rec:
        n = rec[THINGS].n
    rec.close()
    assert len(n) == 100 and rec[THINGS].n is n
    with pytest.raises(trocar.TrocarError, match="the recording is closed"):
        rec[THINGS].x
