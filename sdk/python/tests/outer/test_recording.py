"""Promise: a recording is made, steered and taken away again from Python, and its file holds what was asked for and nothing else."""

import csv
import pathlib
import subprocess
import time

import numpy as np
import pytest

import trocar

from ..conftest import eventually, reaches
from .conftest import BIN

EYEROBOT = "robot/EyeRobot"
POSITION = f"/{EYEROBOT}/position"


@pytest.fixture(autouse=True)
def recorder(system):
    if "recorder" in system.missing:
        pytest.skip("the recorder plugin was not built")


def steps(ire):
    return int(ire.call(f"{EYEROBOT}/Arm/steps"))


def goes_on(ire, count=300):
    """Waits for so many steps of the robot, each of which sends its position."""
    end = steps(ire) + count
    reaches(f"{count} steps", lambda: steps(ire), end)


def written(rec, count=100):
    """Waits until so many messages more are in the file."""
    end = rec.status()["messages"] + count
    reaches(f"{count} messages are written", lambda: rec.status()["messages"], end)


def test_a_recording_is_made_read_back_and_its_recorder_is_gone(system, ire, tmp_path):
    with ire.record("trial7", ["robot/**", "oct/**"], pre_trigger=5, directory=str(tmp_path)) as rec:
        rec.marker("half way")
        wanted = (f"{EYEROBOT}/position", "oct/spectrometer/spectra", "oct/lines/ascan")
        positions, *frames = map(rec.topics.index, wanted)
        reaches("positions are written", lambda: rec._ctl("topic", positions)["kept"], 100)
        for topic in frames:
            reaches("frames of another process are, too", lambda topic=topic: rec._ctl("topic", topic)["kept"], 6)
    assert rec.path == str(tmp_path / "trial7.mcap")
    told = rec.read()["/recorder/loss"].messages[-1:] if rec.result["lost"] else []
    assert rec.result["lost"] == 0, (rec.topics, told)
    assert not [c for c in ire._graph.components if "rec_" in c and c in {x.path for x in ire._call("GcmService/List").components}]
    file = rec.read()
    assert file.complete and file.profile == "trocar", file
    position = file["/robot/EyeRobot/position"]
    assert len(position) > 50 and np.abs(position.value).max() <= 0.01
    assert (np.diff(position.publish_time.astype(np.int64)) > 0).all()
    spectra, ascans = file["/oct/spectrometer/spectra"], file["/oct/lines/ascan"]
    assert len(spectra) > 5 and len(ascans) > 5, file
    for frame, dtype in [(f, "<u2") for f in spectra.messages] + [(f, "<f4") for f in ascans.messages]:
        assert frame.lines > 0 and frame.samples > 0
        assert len(frame.data) == frame.lines * frame.samples * np.dtype(dtype).itemsize, (frame.lines, frame.samples, len(frame.data))
        values = np.frombuffer(frame.data, dtype)
        assert np.isfinite(values).all() and values.any() and values.std() > 0, "something is in it"
    assert (np.diff(ascans["index"].astype(np.int64)) > 0).all(), "each frame once, in order"
    brief = ire.record("brief", ["robot/**"], directory=str(tmp_path)).start(duration=0.3)
    eventually("it ended by itself", lambda: str(brief.status()["phase"]) in ("IDLE", "0"))
    assert brief.stop()["reason"] == "its time was over" and brief.path == str(tmp_path / "brief.mcap")
    assert brief.read().complete
    with pytest.raises(trocar.TrocarError, match="exists"):
        with ire.record("trial7", ["robot/**"], directory=str(tmp_path)):
            pass
    with pytest.raises(trocar.TrocarError) as e:
        ire.record("trial8", ["nobody/**"])
    assert e.value.reason == "NOTHING_MATCHES" and "robot/EyeRobot/position" in e.value.sentence
    for name in ("../trial8", "a\nb"):
        with pytest.raises(trocar.TrocarError, match="is no name of a file"):
            ire.record(name, ["robot/**"])
    with pytest.raises(trocar.TrocarError, match="the recording trial7.mcap is over"):
        rec.marker("too late")


def test_a_pre_trigger_puts_the_past_into_the_file_and_without_one_it_begins_with_the_beginning(ire, tmp_path):
    files = {}
    for name, pre_trigger in (("past", 60), ("now", 0)):
        rec = ire.record(name, [f"{EYEROBOT}/position"], pre_trigger=pre_trigger, directory=str(tmp_path))
        assert "armed" in repr(rec)
        goes_on(ire)
        began_ns = time.monotonic_ns()
        with rec:
            written(rec)
        assert rec.result["lost"] == 0 and rec.result["whole"], rec.result
        files[name] = (rec.read()[POSITION], began_ns)
    past, began_ns = files["past"]
    # The last of those steps may have sent nothing yet when it was counted.
    assert (past.publish_time < began_ns).sum() >= 299, "each step since it was armed"
    assert (past.log_time < began_ns).any() and (past.log_time > began_ns).any(), "and it goes on without a gap from there"
    assert (np.diff(past.publish_time.astype(np.int64)) > 0).all()
    now, began_ns = files["now"]
    assert len(now) >= 90 and (now.log_time > began_ns).all(), "without one nothing of it is there"


def test_a_pause_leaves_a_hole_and_is_no_loss(ire, tmp_path):
    with ire.record("paused", [f"{EYEROBOT}/position"], directory=str(tmp_path)) as rec:
        written(rec)
        rec.pause()
        eventually("it says that it pauses", lambda: str(rec.status()["phase"]) == "PAUSED")
        paused_ns = time.monotonic_ns()
        goes_on(ire)
        goes_on_ns = time.monotonic_ns()
        rec.resume()
        eventually("it says that it goes on", lambda: str(rec.status()["phase"]) == "RECORDING")
        written(rec)
    assert rec.result["lost"] == 0 and rec.result["whole"], rec.result
    file = rec.read()
    times = file[POSITION].publish_time
    assert (times < paused_ns).sum() > 50 and (times > goes_on_ns).sum() > 50, "before and after"
    assert not ((times > paused_ns) & (times < goes_on_ns)).any(), "nothing of the time between"


@pytest.mark.parametrize(
    "video, schema, told, magic",
    [
        ("raw", "foxglove.RawImage", ("encoding", "rgb8"), b""),
        ("qoi", "foxglove.CompressedImage", ("format", "qoi"), b"qoif"),
        ("jpeg", "foxglove.CompressedImage", ("format", "jpeg"), b"\xff\xd8\xff"),
    ],
)
def test_video_is_kept_as_was_asked_for(ire, tmp_path, video, schema, told, magic):
    with ire.record("video", ["host/eye/image"], video=video, directory=str(tmp_path)) as rec:
        reaches("pictures come", lambda: rec._ctl("topic", 0)["kept"], 3)
    left = rec.read()["/host/eye/image/left"]
    assert left.schema == schema and set(left[told[0]].tolist()) == {told[1]}, left
    assert all(m.data.startswith(magic) for m in left.messages) and len(left) > 2
    assert video != "raw" or all(len(m.data) == m.step * m.height == 320 * 240 * 3 for m in left.messages)


def test_an_encoding_that_is_none_is_refused_and_leaves_nothing_behind(ire, tmp_path):
    with pytest.raises(trocar.TrocarError, match="qoi") as e:
        ire.record("video", ["host/eye/image"], video="mpeg", directory=str(tmp_path))
    assert e.value.code == "INVALID_ARGUMENT", e.value
    assert not recorders(ire) and not ire._recordings


def recorders(ire):
    return [c.path for c in ire._call("GcmService/List").components if getattr(c, "class") == "recorder/recorder"]


def test_a_rate_thins_all_or_those_that_a_mapping_names(ire, tmp_path):
    patterns = [f"{EYEROBOT}/position", f"{EYEROBOT}/tap_rows"]
    gaps = {}
    for name, rate in (("all", 20), ("some", {"*/*/tap_*": 20.0})):
        with ire.record(name, patterns, max_rate_hz=rate, directory=str(tmp_path)) as rec:
            goes_on(ire)
            for topic in (0, 1):
                reaches("some are kept of each", lambda rec=rec, topic=topic: rec._ctl("topic", topic)["kept"], 6)
        assert rec.result["lost"] == 0, rec.result
        file = rec.read()
        gaps[name] = [np.diff(file[f"/{p}"].publish_time.astype(np.int64)) for p in patterns]
    # A thinned topic has no more than the points of a grid of 20 Hz in its time; steps of 500 Hz are closer.
    for thinned in (*gaps["all"], gaps["some"][1]):
        assert 5 <= len(thinned) <= thinned.sum() / 50_000_000 + 0.5, gaps
    assert len(gaps["some"][0]) >= 290 and np.median(gaps["some"][0]) < 49_750_000, gaps


def test_a_recorder_keeps_to_the_processors_it_is_given_with_all_its_threads(system, tmp_path):
    own = allowed("/proc/self/status")
    cpu, said = min(own), []
    with system.connect(say=said.append) as ire:
        for name, cpus, expected in (("listed", [cpu], {cpu}), ("one", cpu, {cpu}), ("any", (), own)):
            with ire.record(name, ["robot/**"], cpus=cpus, directory=str(tmp_path)) as rec:
                written(rec, 10)
                tasks = list(pathlib.Path(f"/proc/{ire._graph.processes['robot'].pid}/task").iterdir())
                threads = {(t / "comm").read_text().strip(): allowed(t / "status") for t in tasks}
            # Its own and its writer's.
            assert {t: c for t, c in threads.items() if t.startswith("rec_")} == {f"rec_{name}": expected, f"rec_{name} mcap": expected}
            assert threads["EyeRobot"] == own, "nobody else is moved"
        assert not any("refused" in s and "CPU" in s.upper() for s in said), said
        # Where there is no such one it records all the same, and says so.
        with ire.record("nowhere", ["robot/**"], cpus=[4095], directory=str(tmp_path)) as rec:
            written(rec, 10)
        assert rec.result["whole"] and any("[4095] were refused" in s for s in said), said
        for bad in ([5000], [-1], [True], "1", [1.5], 0.5):
            with pytest.raises(trocar.TrocarError, match="cpus is .*; give numbers of processors") as e:
                ire.record("never", ["robot/**"], cpus=bad, directory=str(tmp_path))
            assert e.value.code == "INVALID_ARGUMENT"
        assert not recorders(ire)


def allowed(status):
    """The processors a thread may run on, of its status."""
    text = pathlib.Path(status).read_text().partition("Cpus_allowed_list:")[2].splitlines()[0]
    spans = [part.split("-") for part in text.strip().split(",")]
    return {n for span in spans for n in range(int(span[0]), int(span[-1]) + 1)}


def test_a_recording_is_opened_beside_its_system_and_gives_tables_and_frames(ire, tmp_path):
    pandas = pytest.importorskip("pandas")
    patterns = ["robot/**", "host/eye/image", "oct/lines/ascan"]
    with ire.record("opened", patterns, directory=str(tmp_path)) as rec:
        rec.marker("half way")
        for topic in ("host/eye/image", "oct/lines/ascan", f"{EYEROBOT}/position", f"{EYEROBOT}/tap_rows"):
            number = rec.topics.index(topic)
            reaches(f"{topic} is written", lambda number=number: rec._ctl("topic", number)["kept"], 8)
        # While it is written it is open for whoever looks.
        eventually("it is in the file", lambda: len(trocar.Recording(tmp_path / "opened.mcap").topics) > 5)
    file = trocar.Recording(rec.path)
    assert file.complete and file.losses.told and file.losses.lost == rec.result["lost"], file
    assert [m.text for m in file.markers] == ["half way"] and f"{EYEROBOT}" in file.config and file.plugins["eyerobot"]
    rows = file[f"{EYEROBOT}/tap_rows"].to_pandas(clock="wall")
    now = pandas.Timestamp.now(tz="UTC")
    assert len(rows) == file[f"{EYEROBOT}/tap_rows"].count and now - rows.index[-1] < pandas.Timedelta(hours=1), rows
    pair = file["host/eye/image"].frames[3]
    assert pair.array.shape == (2, 240, 320, 3) and pair._repr_png_().startswith(b"\x89PNG") and pair.left.array.std() > 0
    lines = file["oct/lines/ascan"].frames[0]
    assert lines.array.shape == (lines.value.lines, lines.value.samples) and "colours from" in lines.shown
    table = file.table(f"{EYEROBOT}/position", on="host/eye/image/left", tolerance=60.0)
    exported = subprocess.run([f"{BIN}/trocar", "export", rec.path, "--csv", "-o", str(tmp_path / "csv")], capture_output=True, text=True)
    assert exported.returncode == 0, exported.stderr
    for name in ("host/eye/image/left", f"{EYEROBOT}/tap_rows", "oct/lines/ascan"):
        with open(tmp_path / "csv" / f"{name.replace('/', '_')}.csv", newline="") as csv_file:
            heads, *lines = csv.reader(csv_file)
        ours = file[name].to_pandas(clock="ns", time="log_time")
        assert heads[3:] == list(ours.columns) and [int(line[0]) for line in lines] == ours.index.tolist(), (name, heads, ours)
        for n, head in enumerate(heads[3:], 3):
            told = ours[head].tolist()
            assert [line[n] if isinstance(v, str) else float(line[n]) for line, v in zip(lines, told)] == told, (name, head)
    assert len(table) == file["host/eye/image/left"].count and table[f"{EYEROBOT}/position.value"].notna().all(), table
