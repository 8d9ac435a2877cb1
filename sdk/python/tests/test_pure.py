"""Promise: values, paths, system files, pictures and completion are right without any system."""

import math
import pathlib
import pickle
import struct
import subprocess
import sys
import xml.dom.minidom

import numpy as np
import pytest

import trocar
from trocar import _ipython, _paths, _proto, _system_file, _values

from .fake import message

ROOT = pathlib.Path(__file__).resolve().parents[3]


def primitive(number, name, size):
    return message("TypeInfo", name=name, size=size, primitive=number)


F64, U32, U64, BOOL = primitive(11, "f64", 8), primitive(6, "u32", 4), primitive(8, "u64", 8), primitive(1, "bool", 1)


def structure(name, size, *fields):
    ty = message("TypeInfo", name=name, size=size)
    ty.structure.name, ty.structure.size = name, size
    for field, offset, inner, unit in fields:
        ty.structure.fields.add(name=field, offset=offset, type=inner, unit=unit)
    return ty


def listed(item, n):
    return message("TypeInfo", name=f"list {n}", size=8 + n * item.size, list=message("ArrayType", item=item, n=n))


def test_the_descriptors_are_those_of_the_host():
    packed = ROOT / "proto/src/gen/trocar.v1.bin"
    if not packed.exists():
        pytest.skip("not in a checkout")
    mine = pathlib.Path(trocar.__file__).with_name("trocar.v1.bin")
    assert mine.read_bytes() == packed.read_bytes(), "cp proto/src/gen/trocar.v1.bin sdk/python/src/trocar/"


def test_every_primitive_comes_back_as_it_was_with_its_unit():
    for number, (word, fmt) in enumerate(_values._STRUCTS.items(), 1):
        size = struct.calcsize(fmt)
        ty = primitive(number, word, size)
        value = {"bool": True, "f32": 0.5, "f64": -2.25}.get(word, 77)
        got = _values.to_value(ty, struct.pack(fmt, value), "mm")
        assert got == value and (word == "bool" or repr(got) == f"{value} mm"), word
        assert _values.raw_dtype(ty).itemsize == size


def test_numbers_with_units_calculate_pickle_and_format_like_numbers():
    n, x = _values.Int(30, "mm"), _values.Float(0.5, "N")
    assert n + 1 == 31 and type(n + 1) is int and np.array([n, n]).sum() == 60 and f"{n:d}" == "30" and f"{x:.2f}" == "0.50"
    assert pickle.loads(pickle.dumps(n)).unit == "mm" and pickle.loads(pickle.dumps(x)) == 0.5


def test_structs_lists_texts_and_enumerations_come_as_people_think_of_them():
    mode = message("TypeInfo", name="Mode", size=4)
    mode.enumeration.name, mode.enumeration.repr = "Mode", 6
    mode.enumeration.values.add(name="FAST", number=2)
    text = message("TypeInfo", name="text[8]", size=16, text=8)
    ty = structure(
        "Thing", 72, ("joints", 0, listed(F64, 4), "m|rad"), ("name", 40, text, ""), ("mode", 56, mode, ""), ("n", 64, U64, "px")
    )
    raw = struct.pack("<Q4d", 2, 1.5, -2, 0, 0) + struct.pack("<Q8s", 3, b"abc") + struct.pack("<IIQ", 2, 0, 2**63)
    thing = _values.to_value(ty, raw)
    assert thing.joints.tolist() == [1.5, -2] and thing.name == "abc" and thing.mode == "FAST" and repr(thing.n) == f"{2**63} px"
    assert thing.units == {"joints": "m|rad", "name": "", "mode": "", "n": "px"} and "m|rad" in repr(thing)
    outer = structure("Outer", 72, ("thing", 0, ty, ""))
    units = {"thing": "", "thing.joints": "m|rad", "thing.name": "", "thing.mode": "", "thing.n": "px"}
    assert _values.units_in(outer) == units and _values.units_of(outer) == {"thing": ""}
    with pytest.raises(AttributeError, match="has no field 'jonits'"):
        thing.jonits
    with pytest.raises(AttributeError, match="cannot be changed"):
        thing.n = 3
    # A list that says it is longer than there is room is as long as the room.
    rows = _values.to_rows(ty, [raw, struct.pack("<Q4d", 9, 1, 2, 3, 4) + raw[40:]])
    assert rows["joints"].shape == (2, 4) and np.isnan(rows["joints"][0, 2:]).all() and rows["mode"].tolist() == ["FAST"] * 2
    with pytest.raises(trocar.TrocarError, match="71 bytes came for 1 of Thing, which has 72"):
        _values.to_value(ty, raw[:-1])


def test_nested_structs_become_nested_arrays():
    inner = structure("P", 16, ("x", 0, F64, "m"), ("y", 8, F64, "m"))
    pair = message("TypeInfo", name="P[2]", size=32, array=message("ArrayType", item=inner, n=2))
    rows = _values.to_rows(structure("Q", 32, ("points", 0, pair, "")), [struct.pack("<4d", 1, 2, 3, 4)])
    assert rows["points"]["y"].tolist() == [[2, 4]]


def test_what_json_cannot_carry_goes_as_text_or_is_refused():
    wire = _values.to_wire({"big": 2**60, "nan": math.nan, "inf": -math.inf, "a": np.float32(0.5), "l": np.arange(3), "t": (True, None)})
    assert _values.plain(wire) == {"big": str(2**60), "nan": "NaN", "inf": "-Infinity", "a": 0.5, "l": [0, 1, 2], "t": [True, None]}
    row = np.zeros(1, [("x", "f8"), ("y", "i4")])[0]
    assert _values.plain(_values.to_wire(row)) == {"x": 0, "y": 0}
    for bad in (object(), {1: 2}, {3.0}, b"x", 1j):
        with pytest.raises(trocar.TrocarError):
            _values.to_wire(bad)
    assert _values.from_json(U64, str(2**63)) == 2**63 and math.isnan(_values.from_json(F64, "NaN"))


def frame_type(form, *fields):
    fmt = message("TypeInfo", name="PixelFormat", size=4)
    fmt.enumeration.repr = 6
    for number, name in enumerate(("GRAY8", "RGB8", "BGR8", "RGBA8", "GRAY16"), 1):
        fmt.enumeration.values.add(name=name, number=number)
    names = [*fields[:-1], "format"]
    header = structure("H", 4 * len(names), *((n, 4 * i, fmt if n == "format" else U32, "") for i, n in enumerate(names)))
    return message("FrameType", header=header, format=form)


def test_an_image_is_an_array_and_a_header_that_lies_is_refused():
    ty = frame_type("image", "width", "height", "stride", "format")
    data = bytes(range(40))
    image = _values.to_frame(ty, struct.pack("<4I", 3, 2, 16, 2), data)
    assert image.shape == (2, 3, 3) and image[1, 0].tolist() == [16, 17, 18] and image.pixels == "RGB8" and image.header.width == 3
    gray = _values.to_frame(ty, struct.pack("<4I", 4, 2, 16, 5), data)
    assert gray.shape == (2, 4) and gray.dtype == np.uint16
    for lie in ((3, 3, 16, 2), (6, 2, 16, 2), (2**31, 2**31, 2**32 - 1, 2), (4, 2, 4, 2)):
        with pytest.raises(trocar.TrocarError, match="FORMAT_MISMATCH"):
            _values.to_frame(ty, struct.pack("<4I", *lie), data)
    unknown = _values.to_frame(ty, struct.pack("<4I", 3, 2, 16, 99), data)
    assert unknown.shape == (40,), "what is not known is handed out as bytes"


@pytest.mark.parametrize("bad", ["", "/", "a//b", "a/b/", "../x", "a b", "a/\n", 42, None, (), ("a", 1), "a/b\x00"])
def test_a_path_that_is_none_is_refused_with_how_one_looks(bad):
    with pytest.raises(trocar.TrocarError, match="BAD_PATH"):
        _paths.path_of(bad, (2, 3))


def test_globs_stay_within_a_name_or_go_on():
    assert _paths.globbed("robot/**").match("robot/arm/x") and not _paths.globbed("robot/*").match("robot/arm/x")
    assert _paths.globbed("*/a.b/?").match("x/a.b/y") and not _paths.globbed("*/a.b/?").match("x/aXb/y")


def test_a_system_file_is_passed_on_as_it_is_and_a_refusal_names_it(tmp_path):
    file = tmp_path / "s.json"
    file.write_text('{ "version": 1, "//": "µ" }', encoding="utf-8")
    assert _system_file.text_of(file, "apply") == (str(file), '{ "version": 1, "//": "µ" }')
    assert _system_file.text_of({"version": 1}, "apply") == ("the system", '{"version": 1}')
    file.write_bytes(b"\xff")
    with pytest.raises(trocar.TrocarError, match="UTF-8"):
        _system_file.text_of(str(file), "apply")
    with pytest.raises(trocar.TrocarError, match="cannot be read"):
        _system_file.text_of(str(tmp_path / "none.json"), "apply")
    for wrong in (7, [1]):
        with pytest.raises(trocar.TrocarError, match="a file or a dict"):
            _system_file.text_of(wrong, "apply")
    with pytest.raises(trocar.TrocarError, match="JSON cannot carry it"):
        _system_file.text_of({"a": object()}, "apply")
    of_text = trocar.TrocarError("INVALID_ARGUMENT", "ARGUMENT_INVALID", "system:1:2: not JSON")
    assert _system_file.placed(of_text, "s.json").sentence == "s.json:1:2: not JSON"
    other = trocar.TrocarError("NOT_FOUND", "CLASS_NOT_FOUND", "no class")
    assert _system_file.placed(other, "s.json") is other


@pytest.mark.parametrize(
    "given, why",
    [
        ({"rate_hz": "fast"}, "rate_hz"),
        ({"rate_hz": 1, "period_us": 1}, "not both"),
        ({"modle": "none"}, "did you mean model"),
        ([], "object"),
    ],
)
def test_an_execution_of_another_form_is_refused_with_its_place(given, why):
    with pytest.raises(trocar.TrocarError, match="SYSTEM_FILE_INVALID") as e:
        _system_file.execution(given, "execution")
    assert why in e.value.sentence, e.value


def test_options_of_a_connection_are_those_of_a_file():
    made = _system_file.connect_options({"queue": {"fifo": 4}, "max_age_ms": 200}, "connect")
    assert made.queue.fifo == 4 and made.max_age.nanos == 200_000_000
    with pytest.raises(trocar.TrocarError, match="1 to 65536"):
        _system_file.connect_options({"queue": {"fifo": 0}}, "connect")


class Hostile:
    """A session with names and words that mean ill."""

    address = '<script>alert("a")</script>'
    component = ""

    class _graph:
        revision, term = 1, 1
        processes = {"p": message("Process", name="p", state=1, guest='</text><script>&"')}  # noqa: RUF012
        components = {}  # noqa: RUF012
        connections = {1: message("Connection", id=1, client="p/c/in<", server='p/c/out">', carrier="<x>")}  # noqa: RUF012


Hostile._graph.components["p/c"] = _proto.message("Component")(path="p/c", state=5, fault="\x1b]0;owned\x07 & <b>", **{"class": "<i>"})


def test_the_picture_of_the_graph_is_whole_and_escapes_what_it_shows():
    from trocar._show import Tree

    tree = Tree(Hostile())
    svg = tree.svg()
    xml.dom.minidom.parseString(svg)
    assert "<script" not in svg and "<i>" not in svg and "\x1b" not in repr(tree) and "\\x1b" in repr(tree)


def test_completion_never_evaluates_what_is_not_ours():
    called = []

    class Trap:
        def __getattr__(self, name):
            called.append(name)
            return self

        def __dir__(self):
            called.append("dir")
            return ["x"]

    names = {"trap": Trap(), "os": __import__("os")}
    for text in ("trap.", "trap.a.b", "os.sys", 'trap["x"].', "f().", "", "x.y.", 'trap.f("a/b'):
        assert _ipython.complete(names, text) == []
    assert not called


def test_the_source_is_clean():
    package = ROOT / "sdk/python"
    if not (package / "pyproject.toml").exists():
        pytest.skip("not in a checkout")
    ruff = pathlib.Path(sys.executable).with_name("ruff")
    for command in (["check"], ["format", "--check"]):
        done = subprocess.run([ruff, *command, "--no-cache", package], capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr


def test_without_the_extras_everything_else_works_and_the_rest_says_what_to_install():
    code = """
import sys
for name in ("IPython", "matplotlib", "mcap", "mcap_protobuf"):
    sys.modules[name] = None
import trocar
from trocar import _plot, ire
for ask in (lambda: trocar.read("x.mcap"), _plot._matplotlib):
    try:
        ask()
    except trocar.TrocarError as e:
        assert e.reason == "NOT_INSTALLED" and "pip install " in e.sentence and "trocar" not in e.sentence, e
    else:
        raise AssertionError(ask)
sys.exit(ire.main([]) + 10)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 11 and "IPython is missing" in done.stderr, done
