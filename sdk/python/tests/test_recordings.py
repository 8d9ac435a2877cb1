"""Promise: a recording is read into numpy, also one that was broken off; a file that means ill costs an error, not more."""

import random
import warnings

import numpy as np
import pytest
from mcap.writer import CompressionType

import trocar

from .files import File, types, write


def test_topics_become_arrays(tmp_path):
    file = trocar.read(write(tmp_path / "a.mcap"))
    assert file.complete and file.profile == "trocar" and file.metadata["trocar"] == {"version": "1"} and len(file) == 2
    arm = file["/robot/arm/state"]
    assert (
        len(arm) == 100
        and arm.x[3] == 1.5
        and arm.joints.shape == (100, 2)
        and arm["n"].dtype.kind in "iu"
        and arm.name == "/robot/arm/state"
    )
    assert arm.t[10] == pytest.approx(0.01) and arm.log_time[0] == 1_000_000_000 and arm.publish_time[0] == 999_000_000
    table = arm.array()
    assert table["x"].sum() == sum(i / 2 for i in range(100)) and table["joints"].shape == (100, 2)
    assert file["recorder/note"].messages[0]["text"] == "half way"
    with pytest.raises(KeyError, match="did you mean"):
        file["/robot/arm/sttae"]
    with pytest.raises(AttributeError, match="it has x, joints"):
        arm.y
    assert "100 of trocar.Thing_0123" in repr(arm) and "trocar.Thing_0123" in repr(file)


def test_topics_and_times_can_be_chosen(tmp_path):
    path = str(write(tmp_path / "a.mcap"))
    assert list(trocar.read(path, topics="robot/**")) == ["/robot/arm/state"]
    part = trocar.read(path, start=0.0105, end=0.0205)["/robot/arm/state"]
    assert part.n.tolist() == list(range(11, 21))


def test_a_file_that_was_broken_off_gives_what_there_is_and_says_so(tmp_path):
    whole = write(tmp_path / "a.mcap", 1000).read_bytes()
    for part in (0.3, 0.6, 0.9):
        cut = tmp_path / f"cut{part}.mcap"
        cut.write_bytes(whole[: int(len(whole) * part)])
        file = trocar.read(cut)
        assert not file.complete and file.why and "not complete" in repr(file)
        n = file["/robot/arm/state"].n
        assert len(n) > 1000 * part * 0.5 and n.tolist() == list(range(len(n)))


def test_what_is_no_recording_is_refused(tmp_path):
    for content in (b"", b"not mcap at all", b"\x89MCAP0\r"):
        (tmp_path / "x.mcap").write_bytes(content)
        with pytest.raises(trocar.TrocarError, match="is no MCAP file"):
            trocar.read(tmp_path / "x.mcap")
    with pytest.raises(trocar.TrocarError, match="cannot be read"):
        trocar.read(tmp_path / "none.mcap")


@pytest.mark.parametrize("compression", [CompressionType.LZ4, CompressionType.ZSTD, CompressionType.NONE])
@pytest.mark.parametrize("crcs", [True, False])
def test_damaged_bytes_never_raise_anything_else(tmp_path, compression, crcs):
    whole = bytearray(write(tmp_path / "a.mcap", 200, compression=compression, enable_crcs=crcs).read_bytes())
    rng = random.Random(7)
    damaged = tmp_path / "b.mcap"
    told = 0
    for _ in range(100):
        content = bytearray(whole)
        for _ in range(rng.randint(1, 8)):
            content[rng.randrange(8, len(content))] = rng.randrange(256)
        damaged.write_bytes(content)
        file = trocar.read(damaged)
        told += not file.complete
        assert all(isinstance(t.log_time, np.ndarray) for t in file.values())
        with trocar.Recording(damaged) as rec, warnings.catch_warnings():
            warnings.simplefilter("ignore", trocar.RecordingNote)
            assert repr(rec) and rec._repr_html_() and rec.losses is not None and rec.markers is not None
            for topic in rec.topics.values():
                assert len(topic.to_numpy()) <= 4096 and all(s.t == s.t for s in topic)
    assert told > (50 if crcs else 10), "most damage is noticed"


def test_a_type_that_means_ill_costs_no_more_than_its_values_may(tmp_path):
    levels = [(f"L{n}", [(name, 11, False, f"L{n + 1}", False) for name in "ab"]) for n in range(30)]
    kind = types("trocar.h9.L0", [("L30", [("x", 1, False, "", False)]), *levels])
    itself = types("trocar.hA.Tree", [("Tree", [("left", 11, False, "Tree", False), ("n", 3, False, "", False)])])
    file = File(tmp_path / "a.mcap")
    file.add(file.topic("/wide", kind), 1, kind[1]())
    tree = itself[1](n=1)
    tree.left.n = 2
    file.add(file.topic("/tree", itself), 1, tree)
    rec = trocar.Recording(file.close())
    with pytest.warns(trocar.RecordingNote, match="have no column"):
        assert len(rec["/wide"].to_numpy()) == 1
    assert rec["/tree"].to_numpy()[["n", "left.n"]].tolist() == [(1, 2)]
