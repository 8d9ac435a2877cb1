"""Promise: what tables of a recording show was sent: exact, with its unit, or missing and told."""

import pathlib
import re
import sys
import warnings

import numpy as np
import pytest

import trocar

from .files import File, raw_image, types

pd = pytest.importorskip("pandas")
S = 1_000_000_000
BIG = 2**63 + 12345


@pytest.fixture
def quiet():
    """Nothing is told."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", trocar.RecordingNote)
        yield


def state():
    """A type with all that a table has to flatten."""
    fields = [
        ("stamp", 6, False, "", False),
        ("big", 3, False, "", False),
        ("position", 1, True, "", False),
        ("pose", 11, False, "Pose", False),
        ("joints", 11, True, "Pose", False),
        ("mode", 14, False, "Mode", False),
        ("name", 9, False, "", False),
        ("on", 8, False, "", False),
        ("raw", 12, False, "", False),
        ("maybe", 6, False, "", True),
        ("effort", 1, False, "", True),
        ("at", 11, False, ".google.protobuf.Timestamp", False),
    ]
    pose = [("x", 1, False, "", False), ("y", 2, False, "", False)]
    words = [(0, "MODE_IDLE"), (1, "MODE_RUNS"), (5, "MODE_BROKEN")]
    return types("trocar.h2.State", [("Pose", pose), ("State", fields)], [("Mode", words)])


def recorded(path, more=lambda file: None, **settings):
    kind = state()
    file = File(path, **settings)
    arm = file.topic("/robot/arm/state", kind, {"unit:position": "m|rad", "unit:pose": "m", "unit:joints.x": "rad"})
    pose = kind[1]().pose.__class__
    for i in range(4):
        value = kind[1](stamp=BIG + i, big=-(2**62) - i, position=[i, i / 2], mode=(0, 1, 5, 9)[i], name=f'n,"{i}"', on=i % 2, raw=b"abc")
        value.pose.CopyFrom(pose(x=i, y=0.5))
        value.joints.extend([pose(x=1), pose(x=i)])
        value.at.seconds, value.at.nanos = 1_700_000_000, 123_456_789
        if i != 1:
            value.maybe, value.effort = BIG + i, float("nan") if i == 2 else 1.5
        file.add(arm, 10 * S + i * S, value, 10 * S + i * S - 5_000_000)
    more(file)
    file.tell("trocar.clock", offset_to_unix_ns=str(1_700_000_000 * S))
    file.close()
    return trocar.Recording(path)


def test_columns_have_the_names_units_and_values_that_were_sent(tmp_path, quiet):
    table = recorded(tmp_path / "a.mcap")["robot/arm/state"].to_pandas()
    names = (
        "stamp big position[0] position[1] pose.x pose.y joints[0].x joints[0].y joints[1].x joints[1].y mode name on raw at maybe effort"
    )
    assert set(table.columns) == set(names.split()) and list(table.columns)[:4] == names.split()[:4]
    assert table["stamp"].dtype == "uint64" and table["stamp"].tolist() == [BIG + i for i in range(4)]
    assert table["big"].dtype == "int64" and table["big"].tolist() == [-(2**62) - i for i in range(4)]
    assert table["position[1]"].tolist() == [0, 0.5, 1, 1.5] and table["joints[1].x"].tolist() == [0, 1, 2, 3]
    assert table["mode"].dtype == "category" and table["mode"].tolist() == ["MODE_IDLE", "MODE_RUNS", "MODE_BROKEN", "9"]
    assert list(table["mode"].cat.categories) == ["MODE_IDLE", "MODE_RUNS", "MODE_BROKEN", "9"]
    assert table["name"].tolist()[3] == 'n,"3"' and table["on"].dtype == bool and set(table["raw"]) == {3}
    assert table["maybe"].dtype == "UInt64" and table["maybe"].isna().tolist() == [False, True, False, False]
    assert table["maybe"].iloc[3] == BIG + 3, "a whole number that is missing elsewhere is exact all the same"
    assert table["effort"].isna().tolist() == [False, True, True, False]
    assert set(table["at"]) == {1_700_000_000_123_456_789}
    units = {"stamp": "ns", "position[0]": "m|rad", "position[1]": "m|rad", "pose.x": "m", "pose.y": "m", "joints[0].x": "rad"}
    assert table.attrs["units"].items() >= units.items() and "name" not in table.attrs["units"] and table.attrs["notes"] == []


def test_rows_have_the_time_that_was_asked_for(tmp_path, quiet):
    rec = recorded(tmp_path / "a.mcap")
    arm = rec["robot/arm/state"]
    assert arm.to_pandas("big").index.tolist() == [-0.005, 0.995, 1.995, 2.995] and arm.to_pandas().index.name == "t"
    assert arm.to_pandas("big", time="log_time").index.tolist() == [0, 1, 2, 3]
    assert arm.to_pandas("big", clock="ns").index.tolist()[1] == 11 * S - 5_000_000
    wall = arm.to_pandas("big", clock="wall").index
    assert wall[0] == pd.Timestamp((1_700_000_010 * S) - 5_000_000, tz="UTC") and rec.begin.timestamp() == 1_700_000_010
    assert arm.to_pandas("big", start=0.995, end=1.995).index.tolist() == [0.995, 1.995]
    assert arm.to_pandas("big", start=1, end=2, time="log_time").index.tolist() == [1, 2]
    none = arm.to_pandas("big", start=100)
    assert (len(none), list(none.columns)) == (0, ["big"]), "nothing lies in that time, and the columns are there"
    assert list(arm.to_pandas(start=100).columns) == list(arm.to_pandas().columns)
    with pytest.raises(trocar.TrocarError, match="has no column 'bog'"):
        arm.to_pandas("bog", start=100)
    for bad in ({"time": "publish"}, {"clock": "local"}, {"columns": []}, {"columns": [3]}):
        with pytest.raises(trocar.TrocarError, match="is"):
            arm.to_pandas(**bad)


def test_some_columns_and_those_below_a_name_can_be_chosen(tmp_path, quiet):
    arm = recorded(tmp_path / "a.mcap")["robot/arm/state"]
    assert list(arm.to_pandas(["pose", "position[1]"]).columns) == ["position[1]", "pose.x", "pose.y"]
    with pytest.raises(trocar.TrocarError, match=r"no column 'posiiton\[0\]'; it has stamp, .*; did you mean position\[0\]\?"):
        arm.to_pandas("posiiton[0]")


def test_arrays_are_exact_and_masked_where_something_is_missing(tmp_path, quiet):
    out = recorded(tmp_path / "a.mcap")["robot/arm/state"].to_numpy()
    assert out["stamp"].dtype == "u8" and out["stamp"].tolist() == [BIG + i for i in range(4)] and out["mode"].tolist() == [0, 1, 5, 9]
    assert out["maybe"].mask.tolist() == [False, True, False, False] and out["maybe"][3] == BIG + 3
    assert out["sequence"].tolist() == [0, 1, 2, 3] and out["name"][0] == 'n,"0"'


def test_stamps_out_of_order_or_twice_are_kept_and_told(tmp_path):
    def odd(file):
        note = file.topic("/odd")
        for n, at in enumerate((10, 12, 11, 11)):
            file.add(note, at * S, {"n": n})

    rec = recorded(tmp_path / "a.mcap", odd)
    with pytest.warns(trocar.RecordingNote) as told:
        table = rec["/odd"].to_pandas()
    assert table["n"].tolist() == [0, 1, 2, 3] and table.index.tolist() == [0, 2, 1, 1]
    assert {str(w.message) for w in told} == set(table.attrs["notes"])
    assert "1 of 4 stamps are earlier" in " ".join(table.attrs["notes"]) and "1 of 4 stamps are equal" in " ".join(table.attrs["notes"])


def test_a_topic_whose_type_changes_has_the_columns_of_both_and_says_so(tmp_path):
    def changes(file):
        first = types("trocar.h3.A", [("A", [("x", 1, False, "", False), ("n", 3, False, "", False)])])
        second = types("trocar.h4.B", [("B", [("x", 9, False, "", False), ("m", 3, False, "", False)])])
        file.add(file.topic("/c", first), S, first[1](x=1.5, n=7))
        file.add(file.topic("/c", second), 2 * S, second[1](x="wide", m=8))

    rec = recorded(tmp_path / "a.mcap", changes)
    with pytest.warns(trocar.RecordingNote) as told:
        table = rec["/c"].to_pandas()
    assert any("its type changed: trocar.h3.A, then trocar.h4.B" in str(w.message) for w in told)
    assert table["x"].tolist() == [1.5, "wide"] and table["n"].isna().tolist() == [False, True] and table["m"].iloc[1] == 8
    assert any("x are not of one kind" in note for note in table.attrs["notes"])


def changing_enum(path, *words, sends=None):
    """A topic whose type changes: of each a message with its second number, and one with its first."""
    file = File(path)
    for i, of in enumerate(words):
        kind = types(f"trocar.e{i}.T", [("T", [("m", 14, False, "M", False)])], [("M", of)])
        channel = file.topic("/c", kind)
        for at, n in enumerate((sends or of[1][0], of[0][0])):
            file.add(channel, (2 * i + at) * S, kind[1](m=n))
    rec = trocar.Recording(file.close())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", trocar.RecordingNote)
        return rec["/c"].to_pandas(), rec["/c"].to_numpy()["m"].tolist()


def test_words_of_an_enum_are_those_of_the_type_that_was_sent(tmp_path):
    out, _ = changing_enum(tmp_path / "other.mcap", [(0, "A"), (1, "B")], [(0, "Z"), (1, "A")])
    assert out["m"].tolist() == ["B", "A", "A", "Z"] and any("m are not of one kind" in note for note in out.attrs["notes"])
    out, numbers = changing_enum(tmp_path / "same.mcap", [(0, "A"), (1, "B")], [(0, "A"), (1, "B")])
    assert out["m"].tolist() == ["B", "A"] * 2 and out["m"].dtype == "category" and numbers == [1, 0] * 2
    out, numbers = changing_enum(tmp_path / "more.mcap", [(0, "A"), (1, "B")], [(0, "A"), (1, "B"), (2, "C")], [(0, "A"), (1, "B")])
    assert out["m"].tolist() == ["B", "A"] * 3 and list(out["m"].cat.categories) == ["A", "B", "C"] and numbers == [1, 0] * 3


def test_two_numbers_of_one_name_are_one_category(tmp_path):
    out, numbers = changing_enum(tmp_path / "a.mcap", [(0, "A"), (1, "B")], [(0, "A"), (2, "B")])
    assert out["m"].tolist() == ["B", "A", "B", "A"] and list(out["m"].cat.categories) == ["A", "B"] and numbers == [1, 0, 2, 0]


def test_a_number_without_a_name_does_not_get_that_of_another_type(tmp_path):
    few, more = [(0, "A"), (1, "B")], [(0, "A"), (1, "B"), (9, "C")]
    for words, sent in (((few, more), ["9", "A", "C", "A"]), ((more, few), ["C", "A", "9", "A"])):
        out, _ = changing_enum(tmp_path / "a.mcap", *words, sends=9)
        assert out["m"].tolist() == sent and any("m are not of one kind" in note for note in out.attrs["notes"])


def test_a_time_that_is_asked_for_has_its_rows_where_a_source_is_ahead_of_the_recorder(tmp_path, quiet):
    file = File(tmp_path / "ahead.mcap", chunk_size=1)
    note = file.topic("/a")
    for n in range(4):
        file.add(note, S + n * S, {"n": n}, S + n * S + 10_000_000)
    rec = trocar.Recording(file.close())
    assert rec["/a"].to_pandas(start=1.005)["n"].tolist() == [1, 2, 3]
    assert rec["/a"].to_pandas(start=1.005, time="log_time")["n"].tolist() == [2, 3]


def test_only_what_is_known_to_be_a_time_is_in_ns(tmp_path, quiet):
    stamp = [("value", 1, False, "", False), ("when", 11, False, ".google.protobuf.Timestamp", False)]
    fields = [("stamp", 11, False, "Stamp", False), ("timestamp", 1, False, "", False)]
    kind = types("x.h.T", [("Stamp", stamp), ("T", fields)])
    units = {}
    for profile in ("ros2", "trocar"):
        file = File(tmp_path / f"{profile}.mcap", profile=profile)
        file.add(file.topic("/a", kind), S, kind[1](timestamp=0.5))
        file.add(file.topic("/j"), S, {"stamp": 1.5})
        rec = trocar.Recording(file.close())
        units[profile] = rec["/a"].to_pandas().attrs["units"], rec["/j"].to_pandas().attrs["units"]
    assert units == {"ros2": ({"stamp.when": "ns"}, {}), "trocar": ({"stamp.when": "ns", "timestamp": "ns"}, {"stamp": "ns"})}


def test_whole_numbers_beside_a_fraction_are_exact(tmp_path, quiet):
    file = File(tmp_path / "a.mcap")
    large, small = file.topic("/large"), file.topic("/small")
    for n in (2**53 + 1, 0.5):
        file.add(large, S, {"n": n, "list": [n, 1]})
        file.add(small, S, {"n": min(n, 3)})
    rec = trocar.Recording(file.close())
    assert rec["/large"]["n"].tolist() == [2**53 + 1, 0.5] and rec["/large"]["list"].tolist() == [[2**53 + 1, 1], [0.5, 1]]
    assert rec["/small"]["n"].dtype == float and rec["/small"]["n"].tolist() == [3, 0.5]


def test_json_has_a_column_for_each_key_and_whole_numbers_stay_whole(tmp_path, quiet):
    def notes(file):
        note = file.topic("/note")
        for value in ({"n": 2**53 + 1, "x": 1}, {"n": 3, "x": 0.5, "list": [1, {"a": "ü"}]}, {"n": None, "text": "a,b", "yes": True}):
            file.add(note, S, value)
        huge = file.topic("/huge")
        for n in (2**64, 1):
            file.add(huge, S, {"n": n})

    rec = recorded(tmp_path / "a.mcap", notes)
    warnings.simplefilter("ignore", trocar.RecordingNote)
    table = rec["/note"].to_pandas()
    assert table["n"].tolist()[:2] == [2**53 + 1, 3] and table["n"].isna().tolist() == [False, False, True]
    assert table["x"].tolist()[:2] == [1, 0.5] and table["list"].iloc[1] == '[1, {"a": "ü"}]' and table["yes"].iloc[2]
    assert rec["/huge"].to_pandas()["n"].tolist() == [2**64, 1] and rec["/huge"]["n"].tolist() == [2**64, 1]


def test_bytes_of_an_unknown_encoding_have_their_length_and_say_so(tmp_path):
    rec = recorded(tmp_path / "a.mcap", lambda file: file.add(file.topic("/imu", encoding="cdr"), S, b"\0\1\2"))
    with pytest.warns(trocar.RecordingNote, match="cdr are not decoded"):
        assert rec["/imu"].to_pandas()["data"].tolist() == [3]


def test_without_pandas_it_says_how_to_get_it(tmp_path, monkeypatch):
    rec = recorded(tmp_path / "a.mcap")
    monkeypatch.setitem(sys.modules, "pandas", None)
    for tries in (rec["robot/arm/state"].to_pandas, lambda: rec.table("robot/arm/state")):
        with pytest.raises(trocar.TrocarError, match="pip install pandas"):
            tries()
    assert len(rec["robot/arm/state"].to_numpy()) == 4


def test_a_recording_that_does_not_tell_its_clock_has_no_date(tmp_path, quiet):
    file = File(tmp_path / "a.mcap")
    file.add(file.topic("/a"), 5, {"n": 1})
    rec = trocar.Recording(file.close())
    with pytest.raises(trocar.TrocarError, match="does not tell the time on the wall"):
        rec["/a"].to_pandas(clock="wall")
    assert rec.begin is None and rec["/a"].to_pandas().index.tolist() == [0]


# ---- several topics in one table


@pytest.fixture
def two(tmp_path):
    """A slow and a fast topic: at 0, 1, 2, 3 s the number n, and at 0, 0.4, 0.8, … 2 s ten times the time."""
    slow = types("trocar.h5.Slow", [("Slow", [("n", 6, False, "", False), ("mode", 14, False, "M", False)])], [("M", [(0, "A"), (1, "B")])])
    fast = types("trocar.h6.Fast", [("Fast", [("x", 1, False, "", False)])])
    file = File(tmp_path / "two.mcap")
    a, b = file.topic("/p/slow/out", slow), file.topic("/p/fast.b/out", fast, {"unit:x": "m"})
    for i in range(4):
        file.add(a, S + i * S, slow[1](n=BIG + i, mode=i % 2))
    for i in range(6):
        file.add(b, S + i * 400_000_000, fast[1](x=4.0 * i))
    return trocar.Recording(file.close())


def table(rec, *args, **settings):
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        out = rec.table(*args, **settings)
    assert [str(w.message) for w in told] == out.attrs["notes"] and all(w.filename == __file__ for w in told)
    return out


def test_a_table_takes_the_nearest_message_within_the_tolerance(two):
    out = table(two, ["p/fast.b/out.x", "/p/slow/out"], tolerance=0.21)
    assert list(out.columns) == ["p/fast.b/out.x", "p/slow/out.n", "p/slow/out.mode"] and out.index.tolist() == [0, 0.4, 0.8, 1.2, 1.6, 2]
    n = out["p/slow/out.n"]
    assert n.dtype == "UInt64" and n.isna().tolist() == [False, True, False, False, True, False]
    assert [int(v) for v in n.dropna()] == [BIG, BIG + 1, BIG + 1, BIG + 2] and out["p/slow/out.mode"].tolist()[2] == "B"
    assert out.attrs["beyond"]["p/slow/out.n"] == 2 and out.attrs["units"] == {"p/fast.b/out.x": "m"}
    assert "2 of 6 rows are further than 0.21 s from a message of /p/slow/out" in out.attrs["notes"][0]


def test_a_table_takes_the_previous_message(two):
    out = table(two, ["p/slow/out.n"], on="p/fast.b/out", how="previous", tolerance=1)
    assert [int(v) for v in out["p/slow/out.n"]] == [BIG, BIG, BIG, BIG + 1, BIG + 1, BIG + 2] and out.attrs["notes"] == []
    assert out["p/slow/out.n"].dtype == "uint64"


def test_a_table_at_a_rate_lies_on_the_line_between_neighbours(two):
    out = table(two, ["p/fast.b/out.x", "p/slow/out.n"], rate_hz=5, how="linear")
    assert len(out) == 16 and np.allclose(np.diff(out.index), 0.2)
    x = out["p/fast.b/out.x"].to_numpy()
    assert np.allclose(x[:11], 10 * out.index[:11]) and np.isnan(x[11:]).all(), "nothing is made up beyond the last message"
    assert out.attrs["tolerance_s"] == {"/p/fast.b/out": 0.8, "/p/slow/out": 2.0} and out.attrs["beyond"]["p/fast.b/out.x"] == 5
    assert any("/p/slow/out: n are no floats" in note for note in out.attrs["notes"])
    near = table(two, "p/fast.b/out.x", rate_hz=5, how="linear", tolerance=0.1, end=0.8)
    assert near["p/fast.b/out.x"].isna().tolist() == [False, True, False, True, False], "both neighbours have to be near"
    short = table(two, "p/fast.b/out.x", rate_hz=5, how="linear", start=0.4, end=0.8)
    assert short.index.tolist() == [0.4, 0.6, 0.8] and np.allclose(short["p/fast.b/out.x"], [4, 6, 8])


@pytest.fixture
def apart(tmp_path):
    """``/a`` at 0, 1, 2, 3, 4 s; ``/one`` at 2 s alone; ``/same`` twice at 2 s; ``/silent`` never."""
    kind = types("trocar.h9.X", [("X", [("x", 1, False, "", False), ("n", 3, False, "", False)])])
    file = File(tmp_path / "apart.mcap")
    a, one, same, _ = (file.topic(name, kind) for name in ("/a", "/one", "/same", "/silent"))
    for i in range(5):
        file.add(a, S + i * S, kind[1](x=i, n=i))
    file.add(one, 3 * S, kind[1](x=7, n=7))
    for x in (8, 9):
        file.add(same, 3 * S, kind[1](x=x, n=x))
    return trocar.Recording(file.close())


@pytest.mark.parametrize("how", ["nearest", "previous", "linear"])
def test_a_topic_without_a_measurable_distance_has_its_value_at_its_own_time_alone(apart, how):
    out = table(apart, ["a.x", "one.x", "same.x"], how=how)
    assert out["one.x"].dropna().to_dict() == {2: 7} and out["same.x"].dropna().to_dict() == {2: 9}
    assert out.attrs["tolerance_s"] == {"/a": 2, "/one": 0, "/same": 0} and out.attrs["beyond"] == {"a.x": 0, "one.x": 4, "same.x": 4}
    assert any("4 of 5 rows are further than 0 s from a message of /one" in n and "no distance" in n for n in out.attrs["notes"])
    wide = table(apart, ["a.x", "one.x"], how=how, tolerance=1e11)["one.x"]
    assert wide.dropna().to_dict() == {"nearest": dict.fromkeys(range(5), 7), "previous": {2: 7, 3: 7, 4: 7}, "linear": {2: 7}}[how]


def test_a_row_between_two_messages_has_no_value_where_one_of_them_is_not_there(apart):
    out = table(apart, ["a.x"], rate_hz=2, start=-1, end=5, how="linear")["a.x"]
    assert out.dropna().to_dict() == {i / 2: i / 2 for i in range(9)} and len(out) == 13


@pytest.mark.parametrize("how", ["nearest", "linear"])
def test_of_equal_stamps_the_last_one_counts_on_both_sides(apart, how):
    out = table(apart, ["same.x"], rate_hz=10, start=1.9, end=2.1, tolerance=0.5, how="nearest")["same.x"]
    assert out.tolist() == [9, 9, 9]
    kind = types("trocar.h10.X", [("X", [("x", 1, False, "", False)])])
    file = File(f"{apart.file}.2")
    topic = file.topic("/b", kind)
    for at, x in ((0, 0), (2, 100), (2, 2), (4, 200), (4, 4)):
        file.add(topic, S + at * S, kind[1](x=x))
    out = table(trocar.Recording(file.close()), "b.x", rate_hz=1, how=how)["b.x"]
    assert out.tolist() == {"linear": [0, 1, 2, 3, 4], "nearest": [0, 0, 2, 2, 4]}[how]


def test_a_topic_without_messages_has_its_wanted_columns_missing_and_says_so(apart):
    out = table(apart, ["a.x", "silent.x", "silent.n"])
    assert list(out.columns) == ["a.x", "silent.x", "silent.n"] and out[["silent.x", "silent.n"]].isna().all(axis=None)
    assert out.attrs["notes"] == ["/silent has no messages: its values are missing"] and out.attrs["beyond"]["silent.n"] == 5
    for settings in ({"fields": ["a.x", "silent"]}, {"fields": "a.x", "on": "silent"}, {"fields": ["silent.x", "a.x"]}):
        assert any("/silent has no messages" in n for n in table(apart, **settings).attrs["notes"]), settings


def test_stamps_that_are_no_times_are_refused(tmp_path):
    file = File(tmp_path / "far.mcap", profile="ros2")
    file.add(file.topic("/far"), 2**63 + 5, {"n": 1})
    file.add(file.topic("/near"), 2**63 + 5, {"n": 1}, 7)
    rec = trocar.Recording(file.close())
    assert rec["far"].to_pandas(clock="ns").index.tolist() == [2**63 + 5]
    tries = (
        rec["far"].to_pandas,
        lambda: rec["far"].to_pandas(clock="wall"),
        lambda: rec.table("far"),
        lambda: rec.table("near"),
        lambda: rec.table("near", rate_hz=1, start=0, end=1),
        lambda: rec.table("near", start=0, clock="ns"),
    )
    for ask in tries:
        with pytest.raises(trocar.TrocarError, match="no time|no dates"):
            ask()


def test_a_table_of_what_is_not_there_is_refused(two):
    for fields, settings, says in (
        (["p/slwo/out"], {}, "did you mean /p/slow/out"),
        (["p/slow/out.k"], {}, "no column 'k'"),
        ([], {}, "name topics"),
        (["p/slow/out"], {"how": "cubic"}, "'nearest'"),
        (["p/slow/out"], {"tolerance": -1}, "tolerance is -1"),
        (["p/slow/out"], {"rate_hz": 0}, "rate_hz is 0"),
        (["p/slow/out"], {"rate_hz": 1e11}, "rows are over the limit"),
        (["p/slow/out"], {"rate_hz": 5, "on": "p/slow/out"}, "give one of them"),
        (["p/slow/out"], {"on": "nobody"}, "is of no topic"),
    ):
        with pytest.raises(trocar.TrocarError, match=says):
            two.table(fields, **settings)


def test_the_code_in_the_manual_runs(tmp_path, monkeypatch):
    manual = (pathlib.Path(__file__).resolve().parents[3] / "docs/PYTHON.md").read_text()
    code = re.search(r"\n## Recordings\n.*?```python\n(.*?)```", manual, re.S).group(1)
    vectors = [(name, 1, True, "", False) for name in ("position", "linear")]
    parts = [("pose", 11, False, "Part", False), ("twist", 11, False, "Part", False)]
    tip_type = types("trocar.h7.Tip", [("Part", vectors), ("Tip", parts)])
    column_type = types("trocar.h8.Column", [("Column", [("distance", 1, False, "", False)])])
    file = File(tmp_path / "trial7.mcap")
    tip = file.topic("/host/robot/tip", tip_type, {"unit:pose.position": "m"})
    column, image = file.topic("/host/bscan/column", column_type), file.topic("/host/bscan/bscan_image", raw_image())
    for i in range(60):
        value = tip_type[1]()
        value.pose.position.extend([i, 1, 2])
        value.twist.linear.extend([0.5, 0, 0])
        file.add(tip, i * S // 10, value)
        file.add(column, i * S // 10, column_type[1](distance=0.5))
        file.add(image, i * S // 10, raw_image()[1](width=2, height=2, step=2, encoding="mono8", data=b"abcd"))
    file.close()
    monkeypatch.chdir(tmp_path)
    ran = {}
    exec(code, ran)
    assert ran["table"].index[[0, -1]].tolist() == [2, 5] and ran["table"].attrs["units"]["pose.position[0]"] == "m"
    assert len(ran["both"].columns) == 4 and (tmp_path / "bscan.png").exists() and ran["sample"].t == pytest.approx(5.9)
