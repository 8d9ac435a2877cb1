"""Promise: a recording is read into numpy, also one that was broken off; a file that means ill costs an error, not more."""

import json
import random

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.writer import CompressionType, Writer

import trocar


def schema():
    file = descriptor_pb2.FileDescriptorProto(name="trocar/Thing.proto", package="trocar", syntax="proto3")
    m = file.message_type.add(name="Thing_0123")
    for number, (name, kind, label) in enumerate((("x", 1, 1), ("joints", 1, 3), ("name", 9, 1), ("n", 4, 1)), 1):
        m.field.add(name=name, number=number, type=kind, label=label)
    pool = descriptor_pool.DescriptorPool()
    pool.AddSerializedFile(file.SerializeToString())
    cls = message_factory.GetMessageClass(pool.FindMessageTypeByName("trocar.Thing_0123"))
    return descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString(), cls


def write(path, count=100, finish=True):
    data, cls = schema()
    with open(path, "wb") as out:
        w = Writer(out, chunk_size=1024, compression=CompressionType.LZ4)
        w.start(profile="trocar")
        kind = w.register_schema("trocar.Thing_0123", "protobuf", data)
        things = w.register_channel("/robot/arm/state", "protobuf", kind, {"unit": "m"})
        notes = w.register_channel("/recorder/note", "json", w.register_schema("note", "jsonschema", b"{}"))
        w.add_metadata("trocar", {"version": "1"})
        for i in range(count):
            message = cls(x=i / 2, joints=[i, -i], name=f"n{i}", n=i)
            w.add_message(things, 1_000_000_000 + i * 1_000_000, message.SerializeToString(), 999_000_000 + i * 1_000_000, i)
        w.add_message(notes, 2_000_000_000, json.dumps({"text": "half way"}).encode(), 2_000_000_000)
        if finish:
            w.finish()
    return path


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
    assert "100 of trocar.Thing_0123" in repr(file)


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


def test_damaged_bytes_never_raise_anything_else(tmp_path):
    whole = bytearray(write(tmp_path / "a.mcap", 200).read_bytes())
    rng = random.Random(7)
    damaged = tmp_path / "b.mcap"
    told = 0
    for _ in range(200):
        content = bytearray(whole)
        for _ in range(rng.randint(1, 8)):
            content[rng.randrange(8, len(content))] = rng.randrange(256)
        damaged.write_bytes(content)
        file = trocar.read(damaged)
        told += not file.complete
        assert all(isinstance(t.log_time, np.ndarray) for t in file.values())
    assert told > 20, "most damage is noticed"
