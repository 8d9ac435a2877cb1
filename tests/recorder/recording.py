"""What is in a recording, and how it is begun, paused, thinned and ended when somebody asks for it."""

import hashlib
import json
import os
import pathlib
import re
import signal
import subprocess
import time

from world import BIN, OK, PATIENCE_S, REFUSED, USAGE, Terminal, World, contiguous, eventually, messages, reaches

# The bar, once something was recorded.
SOME_MESSAGES = re.compile(r"\b[1-9]\d* messages")


def test_a_recording_by_the_command_line_is_whole_and_explains_itself():
    with World(["sine"]) as world:
        world.source()
        done = world.record("host/**", "-o", "a.mcap", least={"/host/sine/value": 101})
        assert done["lost"] == 0 and done["whole"] and done["topics"] >= 1, done
        topics, metadata, _ = messages(world.dir / "a.mcap")
        values = topics["/host/sine/value"]
        assert len(values) > 100 and contiguous(values), len(values)
        assert all(-1.0 <= value.value <= 1.0 for _, value in values)
        assert any(value.value != values[0][1].value for _, value in values)
        assert all(message.publish_time == value.stamp and message.log_time >= message.publish_time for message, value in values)
        graph = topics["/recorder/graph"][0][1]
        assert "host/sine" in [c["path"] for c in graph["components"]]
        plugin = hashlib.sha256((world.dir / "plugins/libtrocar_sine.so").read_bytes()).hexdigest()
        assert metadata["trocar.plugins"]["sine"].endswith(f"sha256:{plugin}"), (metadata["trocar.plugins"], plugin)
        offset_ns = time.time_ns() - time.monotonic_ns()
        assert abs(int(metadata["trocar.clock"]["offset_to_unix_ns"]) - offset_ns) < 1_000_000_000, (metadata["trocar.clock"], offset_ns)
        assert metadata["trocar.end"]["lost"] == "0", metadata["trocar.end"]
        drifts = [told["unix_ns"] - record.log_time - offset_ns for record, told in topics["/recorder/loss"]]
        assert drifts and all(abs(drift) < 1_000_000_000 for drift in drifts), drifts
        info = world.json("info", "a.mcap")
        assert info["whole"] and info["profile"] == "trocar"
        counted = {t["topic"]: t["messages"] for t in info["topics"]}
        assert counted["/host/sine/value"] == len(values), counted
        # Nothing of it stays behind.
        assert [c["path"] for c in world.json("ls")["components"]] == ["host/sine"]


def test_an_output_that_gave_nothing_is_in_the_recording():
    with World(["sine"]) as world:
        world.source()
        world.run("create", "host/quiet", "sine", code=OK)
        done = world.record("host/sine/value", "host/quiet/value", "-o", "a.mcap", least={"/host/sine/value": 101})
        assert done["silent"] == ["/host/quiet/value"], done
        _, metadata, _ = messages(world.dir / "a.mcap")
        assert metadata["trocar.end"]["messages:/host/quiet/value"] == "0", metadata["trocar.end"]
        counted = {t["topic"]: t["messages"] for t in world.json("info", "a.mcap")["topics"]}
        assert counted["/host/quiet/value"] == 0 < counted["/host/sine/value"], counted


def test_commands_begin_pause_mark_thin_and_end_a_recording():
    with World(["sine"]) as world:
        sine = world.source()
        world.recorder({"all": f"{sine}/value", "some": f"{sine}/tap_rows"}, {"every": [1, 10]})
        world.call("host/rec/ctl/marker", "too early", code=REFUSED)
        world.call("host/rec/ctl/annotate", {"kind": "operator", "json": "{}"}, code=REFUSED)
        world.begin("a.mcap")
        world.wait("it records", "RECORDING")
        world.kept(0, 201)
        world.call("host/rec/ctl/marker", "incision")
        world.call("host/rec/ctl/annotate", {"kind": "operator", "json": '{"name": "A"}'})
        world.call("host/rec/ctl/pause")
        world.wait("it pauses", "PAUSED")
        world.call("host/rec/ctl/resume")
        whole = world.topic(0)
        assert whole["left_out"] == 0, whole
        world.call("host/rec/ctl/thin", {"input": "all", "every": 1, "max_rate": 20.0})
        world.wait("it goes on", "RECORDING")
        reaches("it is thinned", lambda: world.topic(0)["left_out"], 1)
        # From here on it is thinned; before, all was kept for as long as the command took.
        thinning = world.topic(0)
        reaches("most is left out", lambda: world.topic(0)["left_out"], thinning["left_out"] + 500)
        last = world.end()
        assert last["whole"] and last["reason"] == "stopped as asked" and last["lost"] == 0, last
        thinned, some = world.topic(0), world.topic(1)
        left_out, kept = (thinned[what] - thinning[what] for what in ("left_out", "kept"))
        assert left_out > kept, (whole, thinning, thinned)
        assert abs(some["left_out"] - 9 * some["kept"]) <= 9 and some["topic"] == "/host/sine/tap_rows", some
        topics, _, _ = messages(world.dir / "rec/a.mcap")
        assert len(topics["/host/sine/tap_rows"]) == some["kept"], some
        assert topics["/recorder/markers"][0][1].message == "incision"
        assert topics["/recorder/note_operator"][0][1] == {"name": "A"}
        values = topics["/host/sine/value"]
        assert len(values) > 200, len(values)


def test_what_finds_its_queue_full_is_lost_and_the_file_says_so():
    with World(["sine"]) as world:
        sine = world.source()
        world.recorder({"a": f"{sine}/value"})
        world.run("disconnect", "host/rec/a", f"{sine}/value", code=OK)
        world.run("connect", "host/rec/a", f"{sine}/value", "--fifo", "2", code=OK)
        world.begin("a.mcap")
        world.wait("it loses some", "RECORDING", lost=101)
        last = world.end()
        assert last["whole"] and last["lost"] > 100, last
        topics, metadata, _ = messages(world.dir / "rec/a.mcap")
        numbers = [message.sequence for message, _ in topics["/host/sine/value"]]
        gaps = sum(after - before - 1 for before, after in zip(numbers, numbers[1:]))
        told = topics["/recorder/loss"][-1][1]
        assert gaps == last["lost"] == told["lost"] == told["topics"]["/host/sine/value"], (gaps, last, told)
        assert int(metadata["trocar.end"]["lost"]) == gaps, metadata["trocar.end"]


def test_a_source_that_went_away_meanwhile_is_told_as_a_gap_that_no_counter_knows():
    with World(["sine"]) as world:
        names = ("cut", "gone", "kept")
        world.recorder({name: f"{world.source(name)}/value" for name in names})
        world.begin("a.mcap")
        world.wait("it records", "RECORDING")
        for n in range(len(names)):
            world.kept(n, 101)
        world.run("disconnect", "host/rec/cut", "host/cut/value", code=OK)
        world.wait("the cut is told", interrupted=1)
        world.run("connect", "host/rec/cut", "host/cut/value", "--fifo", "4096", code=OK)
        world.kept(0, world.topic(0)["kept"] + 101)
        world.run("rm", "host/gone", "--force", code=OK)
        world.wait("the other is told", interrupted=2)
        last = world.end()
        assert last["interrupted"] == 2 and last["lost"] == 0 and last["whole"], last
        assert [world.topic(n)["interrupted"] for n in range(3)] == [1, 1, 0]
        topics, metadata, _ = messages(world.dir / "rec/a.mcap")
        end = metadata["trocar.end"]
        told = {key: end[key] for key in end if key.startswith("interrupted")}
        assert told == {"interrupted": "2", "interrupted:/host/cut/value": "1", "interrupted:/host/gone/value": "1"}, end
        when = [message.log_time for message, told in topics["/recorder/loss"] if told["interrupted"]]
        assert topics["/recorder/loss"][-1][1]["interrupted"] == {"/host/cut/value": 1, "/host/gone/value": 1}, topics["/recorder/loss"]
        # The file has it at the time of the gap.
        cut = [message for message, _ in topics["/host/cut/value"]]
        gaps = [(before.log_time, after.log_time) for before, after in zip(cut, cut[1:]) if after.sequence != before.sequence + 1]
        assert len(gaps) == 1 and gaps[0][0] < when[0] < gaps[0][1] and contiguous(topics["/host/kept/value"]), (gaps, when)
        info = world.run("info", "rec/a.mcap", code=OK)
        assert "/host/cut/value: its connection or the process of its source went away" in info.stderr, info.stderr
        world.begin("b.mcap")
        world.wait("the next one records", "RECORDING", messages=101)
        # Taken away while it records: that is an end, and no gap.
        world.run("rm", "host/rec", "--force", code=OK)
        end = messages(world.dir / "rec/b.mcap")[1]["trocar.end"]
        assert (end["interrupted"], end["lost"]) == ("0", "0"), end


def pid(world, process):
    return next(p["pid"] for p in world.json("ls")["processes"] if p["name"] == process)


def test_a_process_that_comes_back_with_another_plugin_file_is_told_with_both_hashes():
    system = {"version": 1,
              "processes": {"host": {"plugins": ["plugins"]}, "far": {"plugins": ["others"]}},
              "components": {"host/rec": {"class": "recorder/recorder", "config": {"directory": "rec", "path": "a.mcap"}},
                             "far/sine": {"class": "sine/sine"}},
              "connections": [{"client": "host/rec/in_1", "server": "far/sine/value", "queue": {"fifo": 4096}}]}

    def plugins(world):
        (world.dir / "others").mkdir()
        (world.dir / "plugins/libtrocar_sine.so").rename(world.dir / "others/libtrocar_sine.so")

    with World(["sine"], system, ready=plugins) as world:
        world.wait("it records", "RECORDING", messages=101)
        plugin = world.dir / "others/libtrocar_sine.so"
        hashes = [hashlib.sha256(plugin.read_bytes()).hexdigest()]
        # Another file of the same classes, put there as a newer build would be.
        other = world.dir / "newer"
        other.write_bytes(plugin.read_bytes() + b"newer")
        hashes.append(hashlib.sha256(other.read_bytes()).hexdigest())
        other.rename(plugin)
        os.kill(pid(world, "far"), signal.SIGKILL)
        # Its messages come when it is back: until then the file may stand still.
        eventually("the file knows it", lambda: hashes[1].encode() in (world.dir / "rec/a.mcap").read_bytes())
        last = world.end()
        assert last["whole"] and last["interrupted"] >= 1, last
        assert hashes[0].encode() in (world.dir / "rec/a.mcap").read_bytes()
        assert hashes[1] in messages(world.dir / "rec/a.mcap")[1]["trocar.plugins"]["sine"]


def test_a_manager_that_was_killed_is_no_gap():
    with World(["sine"], managed=True) as world:
        world.recorder({"a": f"{world.source()}/value"})
        world.begin("a.mcap")
        world.wait("it records", "RECORDING", messages=101)
        world.manager.kill()
        world.manager.wait()
        world.manage(world.env["TROCAR_GCM"])
        eventually("the new one knows it", lambda: world.run("call", "host/rec/ctl/status").returncode == OK)
        world.source("other")
        eventually("what changed then is told", lambda: b'"host/other"' in (world.dir / "rec/a.mcap").read_bytes())
        last = world.end()
        assert (last["interrupted"], last["lost"], last["whole"]) == (0, 0, True), last
        assert contiguous(messages(world.dir / "rec/a.mcap")[0]["/host/sine/value"])


def test_a_source_that_was_killed_is_told_by_record():
    system = {"version": 1,
              "processes": {name: {"plugins": ["plugins"]} for name in ("a", "b")},
              "components": {"a/sine": {"class": "sine/sine"}, "b/sine": {"class": "sine/sine"}},
              "connections": []}
    with World(["sine"], system) as world:
        command = ["record", "a/**", "b/sine/value", "-o", "a.mcap", "--in", "a", "--json"]
        recording = subprocess.Popen([BIN / "trocar", *command], cwd=world.dir, env=world.env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        try:
            status = lambda: next((world.read(f"{c['path']}/ctl/status") for c in world.json("ls")["components"] if c["class"] == "recorder/recorder"), {})
            kept = lambda: world.kept_by(recording, "/b/sine/value")
            reaches("its values are recorded", kept, 1)
            reaches("it records", lambda: status().get("messages", 0), 101)
            before = pid(world, "b")
            os.kill(before, signal.SIGKILL)
            eventually("the gap is told", lambda: status().get("interrupted") == 1)
            b = lambda: next(p for p in world.json("ls")["processes"] if p["name"] == "b")
            eventually("its source is back", lambda: b()["pid"] not in (0, before) and b()["state"] == "ATTACHED", progress=b)
            recording.send_signal(signal.SIGINT)
            out, errors = recording.communicate(timeout=PATIENCE_S)
        finally:
            recording.kill()
            recording.wait()
        assert recording.returncode == 5, (recording.returncode, out, errors)
        done = json.loads(out)
        assert done["interrupted"] == 1 and done["interruptions"] == [["/b/sine/value", 1]], done


def test_a_pause_is_no_part_of_the_next_recording():
    with World(["sine"]) as world:
        world.recorder({"a": f"{world.source()}/value"})
        for lead_s in LEADS_S:
            path = f"{lead_s}.mcap"
            world.begin(path, duration=lead_s)
            # A machine that does something else, too, may let its time be over before it is looked at.
            over = lambda: world.read("host/rec/ctl/last")["path"].endswith(path)
            eventually("it records", lambda: world.read("host/rec/ctl/status")["phase"] == "RECORDING" or over())
            paused = world.run("call", "host/rec/ctl/pause", "--deadline", "20s")
            world.ended("its time is over", path)
            if paused.returncode == OK:
                break
        else:
            raise AssertionError(paused.stderr)
        world.begin("b.mcap")
        world.wait("the next one records", "RECORDING", messages=101)


# How long before its time something is asked for, s: the next one where the machine took longer than that.
LEADS_S = (1.0, 4.0, 16.0, 60.0)


def test_a_pre_trigger_puts_the_past_into_a_recording():
    with World(["sine"]) as world:
        sine = world.source()
        world.recorder({"a": f"{sine}/value"}, {"pre_trigger_s": 60.0})
        begun = world.read("host/rec/ctl/status")
        assert begun["phase"] == "IDLE"
        executed = lambda: next(c["stats"]["executed"] for c in world.json("ls")["components"] if c["path"] == sine)
        reaches("some are sent before it begins", executed, executed() + 500)
        world.begin("a.mcap")
        world.wait("it records", messages=101)
        world.end()
        topics, metadata, _ = messages(world.dir / "rec/a.mcap")
        values = topics["/host/sine/value"]
        begun_ns = int(metadata["trocar.graph"]["monotonic_ns"])
        before = [message for message, _ in values if message.log_time < begun_ns]
        assert contiguous(values) and len(before) > 100, (len(before), len(values))


def test_what_changes_in_the_graph_during_a_recording_is_in_it():
    with World(["sine"]) as world:
        sine = world.source()
        world.recorder({"a": f"{sine}/value"})
        world.begin("a.mcap")
        world.wait("it records", "RECORDING", messages=101)
        world.source("second", config={"amplitude": 0.25})
        eventually("the second is told", lambda: ["host/rec", "host/second", "host/sine"] in graphs(world), progress=lambda: graphs(world))
        world.run("stop", sine, code=OK)
        world.run("configure", sine, '{"amplitude": 0.5}', code=OK)
        world.run("start", sine, code=OK)
        eventually("its configuration is in the file", lambda: b'"amplitude":0.5' in (world.dir / "rec/a.mcap").read_bytes())
        world.run("rm", "host/second", "--force", code=OK)
        last = lambda: graphs(world)[-1:]
        eventually("the last graph is in the file", lambda: last() == [["host/rec", "host/sine"]], progress=last)
        world.end()
        topics, _, _ = messages(world.dir / "rec/a.mcap")
        seen = [sorted(c["path"] for c in graph["components"]) for _, graph in topics["/recorder/graph"]]
        assert seen[0] == ["host/rec", "host/sine"] and ["host/rec", "host/second", "host/sine"] in seen, seen
        configs = [(told["path"], told["config"]["amplitude"]) for _, told in topics["/recorder/config"] if told["path"] != "host/rec"]
        assert ("host/second", 0.25) in configs and configs.index(("host/sine", 0.5)) > configs.index(("host/sine", 1.0)), configs
        channels = [name for name in topics if name == "/host/sine/value"]
        assert len(channels) == 1, channels


def test_a_fault_is_in_the_recorded_graph_although_nobody_asked_for_it():
    with World(["fixture_chaos"]) as world:
        chaos = "host/chaos"
        world.run("create", chaos, "fixture-chaos/chaos", "--config", '{"panic_in": "step", "good_steps": 200}', code=OK)
        world.recorder({"events": f"{chaos}/tap_events"})
        world.begin("a.mcap")
        world.wait("it records", "RECORDING")
        world.run("start", chaos, code=OK)
        eventually("FAULT is in the file", lambda: "FAULT" in states(world, chaos), progress=lambda: states(world, chaos))
        world.run("reset", chaos, code=OK)
        eventually("what followed is in the file", lambda: states(world, chaos)[-1:] == ["READY"])
        world.end()
        assert states(world, chaos) == ["READY", "ACTIVE", "FAULT", "READY"], states(world, chaos)
        topics, _, _ = messages(world.dir / "rec/a.mcap")
        faults = [c["fault"] for _, graph in topics["/recorder/graph"] for c in graph["components"] if c["state"].endswith("FAULT")]
        assert faults and all("chaos in step" in fault for fault in faults), faults


def states(world, path):
    """What the graphs in the file say of a component, each change once."""
    told = [graph for _, graph in told_graphs(world)]
    all_of_it = [c["state"].removeprefix("COMPONENT_STATE_") for graph in told for c in graph["components"] if c["path"] == path]
    return [state for state, before in zip(all_of_it, [None, *all_of_it]) if state != before]


def graphs(world):
    return [sorted(c["path"] for c in graph["components"]) for _, graph in told_graphs(world)]


def told_graphs(world):
    """Those that are in the file so far."""
    return messages(world.dir / "rec/a.mcap", whole=False)[0].get("/recorder/graph", [])


def test_what_comes_before_its_name_is_known_is_in_the_topic_of_that_name():
    with World(["sine"]) as world:
        sine = world.source()
        for n in range(3):
            # The first step has samples; the GCM's answer comes after it.
            world.recorder({"a": f"{sine}/value", "rows": f"{sine}/tap_rows"}, {"pre_trigger_s": 5.0}, path=f"host/rec{n}")
            world.call(f"host/rec{n}/ctl/start", {"path": f"{n}.mcap", "delay": 0, "duration": 0})
            reaches("it records", lambda: world.read(f"host/rec{n}/ctl/status")["messages"], 101)
            world.run("stop", f"host/rec{n}", code=OK)
            topics, _, _ = messages(world.dir / f"rec/{n}.mcap")
            assert not [name for name in topics if name.startswith("/host/rec")], sorted(topics)
            assert contiguous(topics["/host/sine/value"]) and contiguous(topics["/host/sine/tap_rows"]), sorted(topics)


def test_a_recorder_that_cannot_start_leaves_nothing_behind():
    with World([]) as world:
        for n in range(5):
            world.run("create", f"host/r{n}", "recorder", "--config", '{"directory": "rec", "path": "../x.mcap"}', code=OK)
            assert "leads out" in world.run("start", f"host/r{n}", code=REFUSED).stderr
            gone = world.run("rm", f"host/r{n}", "--force", code=OK)
            assert "thread" not in gone.stdout + gone.stderr, gone.stdout + gone.stderr
        assert list((world.dir / "rec").iterdir()) == []


def test_who_runs_it_in_the_background_may_close_the_terminal():
    with World(["sine"]) as world:
        world.source()
        recording = subprocess.Popen(["nohup", BIN / "trocar", "record", "host/sine/value", "-o", "c.mcap", "--json"], cwd=world.dir,
                                     env=world.env, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        try:
            of = lambda: next((c["path"] for c in world.json("ls")["components"] if c["class"] == "recorder/recorder"), None)
            rec = eventually("it has a recorder", of)
            written = lambda: world.read(f"{rec}/ctl/status")["messages"]
            reaches("it records", written, 1)
            recording.send_signal(signal.SIGHUP)
            reaches("it goes on", written, written() + 101)
            recording.send_signal(signal.SIGTERM)
            out, errors = recording.communicate(timeout=PATIENCE_S)
        finally:
            recording.kill()
            recording.wait()
        assert recording.returncode == OK and json.loads(out)["reason"] == "stopped as asked", (recording.returncode, out, errors)


def test_what_waits_for_its_time_begins_then_and_leaves_nothing_where_it_is_stopped_before():
    with World(["sine"]) as world:
        sine = world.source()
        world.recorder({"a": f"{sine}/value"})
        told = world.follow("host/rec", "ctl/stopped")
        try:
            world.begin("a.mcap", delay=600)
            assert world.read("host/rec/ctl/status")["phase"] == "WAITING" and (world.dir / "rec/a.mcap").exists()
            assert "waits for its time" in world.begin("b.mcap", code=REFUSED).stderr
            last = world.end()
            assert (last["reason"], last["messages"]) == ("stopped before it began: there is no file", 0), last
            ended = json.loads(told.stdout.readline())
            assert "before it began" in json.dumps(ended), ended
            assert not list((world.dir / "rec").iterdir())
        finally:
            told.kill()
            told.wait()
        clock = time.monotonic_ns()
        world.begin("a.mcap", delay=0.5)
        world.wait("it records", "RECORDING", messages=101)
        world.call("host/rec/ctl/stop")
        eventually("the file is closed", lambda: world.read("host/rec/ctl/last")["whole"])
        values = messages(world.dir / "rec/a.mcap")[0]["/host/sine/value"]
        assert contiguous(values) and values[0][0].publish_time >= clock + 500_000_000, (clock, values[0][0])


def test_a_closed_terminal_ends_a_recording_as_ctrl_c_does():
    for ends in (signal.SIGHUP, signal.SIGTERM):
        with World(["sine"]) as world:
            world.source()
            terminal = Terminal(world, "record", "host/**", "-o", "c.mcap")
            terminal.shows("Ctrl-C ends it")
            terminal.shows(SOME_MESSAGES)
            terminal.process.send_signal(ends)
            assert terminal.ends() == OK, terminal.shown
            topics, metadata, ended = messages(world.dir / "c.mcap")
            assert ended and contiguous(topics["/host/sine/value"]) and metadata["trocar.end"]["reason"] == "stopped as asked", metadata
            assert [c["path"] for c in world.json("ls")["components"]] == ["host/sine"]


def test_who_looks_sees_a_bar_and_ctrl_c_leaves_a_whole_file():
    with World(["sine"]) as world:
        world.source()
        terminal = Terminal(world, "record", "host/**", "-o", "c.mcap")
        terminal.shows("Ctrl-C ends it")
        terminal.shows(SOME_MESSAGES)
        terminal.process.send_signal(signal.SIGINT)
        assert terminal.ends() == OK, terminal.shown
        topics, metadata, ended = messages(world.dir / "c.mcap")
        assert ended and contiguous(topics["/host/sine/value"]) and metadata["trocar.end"]["reason"] == "stopped as asked", metadata
        assert [c["path"] for c in world.json("ls")["components"]] == ["host/sine"]
        for words, says in ((["record", "host/**", "-o", "d.mcap", "--seconds", "1"], " % "), (["info", "c.mcap"], " % "),
                            (["export", "c.mcap", "--csv"], " % ")):
            terminal = Terminal(world, *words)
            terminal.shows(says)
            assert terminal.ends() == OK, terminal.shown


def test_a_recording_of_several_processes_is_made_where_it_is_asked_for_and_at_most_so_often():
    system = {"version": 1,
              "processes": {name: {"plugins": ["plugins"]} for name in ("a", "b")},
              "components": {path: {"class": "sine/sine"} for path in ("a/sine", "a/other", "b/sine")},
              "connections": []}
    with World(["sine"], system) as world:
        values = {f"/{path}/value" for path in ("a/sine", "a/other", "b/sine")}
        done = world.record("a/**", "b/sine/value", "-o", "few.mcap", "--in", "b", "--max-rate-hz", "50", least=dict.fromkeys(values, 21))
        assert done["lost"] == 0 and done["whole"], done
        topics, _, _ = messages(world.dir / "few.mcap")
        assert values <= set(topics), sorted(topics)
        for name in values:
            stamps = [message.publish_time for message, _ in topics[name]]
            # Samples nearest to the points of a grid: as many as the time holds, with the first and the last.
            most = (stamps[-1] - stamps[0]) / 20_000_000 + 1.5
            assert 20 < len(stamps) <= most, (name, len(stamps), most)
        where = {c["path"].split("/")[0] for c in topics["/recorder/graph"][0][1]["components"] if c["class"] == "recorder/recorder"}
        assert where == {"b"}, where
        # Without being told it is where most of it is.
        world.json("record", "a/**", "b/sine/value", "-o", "all.mcap", "--seconds", "0.5")
        graph = messages(world.dir / "all.mcap")[0]["/recorder/graph"][0][1]
        assert {c["path"].split("/")[0] for c in graph["components"] if c["class"] == "recorder/recorder"} == {"a"}, graph


def test_a_recorder_keeps_to_the_processors_and_the_memory_it_is_given_with_all_its_threads():
    with World(["sine"]) as world:
        world.source()
        cpu = min(os.sched_getaffinity(0))
        recording = subprocess.Popen([BIN / "trocar", "record", "host/sine/value", "-o", "c.mcap", "--cpus", str(cpu), "--buffer-mb", "64", "--json"],
                                     cwd=world.dir, env=world.env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        try:
            of = lambda: next((c["path"] for c in world.json("ls")["components"] if c["class"] == "recorder/recorder"), None)
            rec = eventually("it has a recorder", of)
            reaches("it records", lambda: world.read(f"{rec}/ctl/status")["messages"], 1)
            config = next(c["config"] for c in world.json("ls")["components"] if c["path"] == rec)
            names = {int(task.name): (task / "comm").read_text().strip() for task in pathlib.Path(f"/proc/{world.host.pid}/task").iterdir()}
            own = {tid: name for tid, name in names.items() if name.startswith("rec-")}
            allowed = {name: os.sched_getaffinity(tid) for tid, name in own.items()}
            recording.send_signal(signal.SIGTERM)
            out, errors = recording.communicate(timeout=PATIENCE_S)
        finally:
            recording.kill()
            recording.wait()
        assert recording.returncode == OK and json.loads(out)["whole"], (recording.returncode, out, errors)
        assert config["buffer_mb"] == 64, config
        assert len(allowed) == 2 and all(cpus == {cpu} for cpus in allowed.values()), (allowed, names)
        # Where there is no such one it records all the same, and says so.
        done = world.run("record", "host/sine/value", "-o", "d.mcap", "--seconds", "0.5", "--cpus", "4095", code=OK)
        assert "[4095] were refused" in done.stderr and "nproc" in done.stderr, done
        refused = world.run("record", "host/sine/value", "-o", "e.mcap", "--cpus", "5000", code=REFUSED)
        assert "5000 is no number of a processor" in refused.stderr and not (world.dir / "e.mcap").exists(), refused
        for wrong in ("7", "65537", "much", "-1"):
            refused = world.run("record", "host/sine/value", "-o", "e.mcap", f"--buffer-mb={wrong}", code=USAGE)
            assert "--buffer-mb" in refused.stderr and not (world.dir / "e.mcap").exists(), refused


def in_time(world, command, argument, at_ns):
    """Asks for something at a time of its own. False when the machine was so slow that the time was over when
    it was asked for.
    """
    asked = world.run("call", command, json.dumps(argument), "--deadline", "20s")
    assert asked.returncode == OK or time.monotonic_ns() >= at_ns, asked.stderr
    return asked.returncode == OK


def test_a_recording_begins_pauses_and_ends_at_the_times_that_were_asked_for():
    with World(["sine"]) as world:
        sine = world.source()
        world.recorder({"a": f"{sine}/value"})
        # What was sent at all, to compare with.
        world.recorder({"all": f"{sine}/value"}, {"path": "all.mcap"}, path="host/other")
        reaches("the other one records", lambda: world.topic(0, "host/other")["kept"], 1)
        world.call("host/rec/ctl/record_at", {"path": "never.mcap", "at": time.monotonic_ns() + 600_000_000_000, "duration": 3.0})
        assert world.read("host/rec/ctl/status")["phase"] == "WAITING"
        world.end()
        echo = world.follow("host/rec", "ctl/progress")
        try:
            for lead_s in LEADS_S:
                lead_ns = int(lead_s * 1e9)
                path, begins = f"{lead_s}.mcap", time.monotonic_ns() + lead_ns
                pauses, ends = begins + lead_ns, begins + 2 * lead_ns
                if not in_time(world, "host/rec/ctl/record_at", {"path": path, "at": begins, "duration": 2 * lead_s}, begins):
                    continue
                phase = lambda: world.read("host/rec/ctl/status")["phase"]
                eventually("it begins", lambda: phase() != "WAITING")
                paused = in_time(world, "host/rec/ctl/pause_at", pauses, pauses)
                eventually("it pauses by itself", lambda: phase() != "RECORDING")
                assert not paused or phase() == "PAUSED" or time.monotonic_ns() >= ends
                last = world.ended("its time is over", path)
                if paused:
                    break
            else:
                raise AssertionError("this machine is too slow to be asked for anything in time")
            told = next(told for told in map(json.loads, echo.stdout) if told["kind"] == "event")
        finally:
            echo.kill()
            echo.wait()
        assert last["reason"] == "its time was over" and last["whole"] and last["lost"] == 0, last
        progress = json.dumps(told)
        assert "RECORDING" in progress or "PAUSED" in progress, progress
        for lead_s in LEADS_S:
            whole, duration_ns = f"whole-{lead_s}.mcap", 500_000_000
            whole_begins = time.monotonic_ns() + int(lead_s * 1e9)
            if in_time(world, "host/rec/ctl/record_at", {"path": whole, "at": whole_begins, "duration": 0.5}, whole_begins):
                break
        else:
            raise AssertionError("this machine is too slow to be asked for anything in time")
        world.ended("its time is over", whole)
        for wrong in (time.monotonic_ns() - 1_000_000_000, 0, time.monotonic_ns() + 10 * 86_400_000_000_000):
            refused = world.call("host/rec/ctl/record_at", {"path": "b.mcap", "at": wrong, "duration": 0.0}, code=REFUSED)
            assert "name a time" in refused.stderr, refused.stderr
        assert not (world.dir / "rec/b.mcap").exists()
        world.run("stop", "host/other", code=OK)
        sent = [message.publish_time for message, _ in messages(world.dir / "rec/all.mcap")[0]["/host/sine/value"]]
        # The recorder steps each 10 ms, and what it takes then belongs to the recording or not by when it was
        # acquired.
        for path, begins, ends in ((path, begins, pauses), (whole, whole_begins, whole_begins + duration_ns)):
            topics, metadata, _ = messages(world.dir / "rec" / path)
            times = [message.publish_time for message, _ in topics["/host/sine/value"]]
            assert begins <= int(metadata["trocar.graph"]["monotonic_ns"])
            assert times and times == [at for at in sent if begins <= at < ends], (begins, times[0], times[-1], ends)


def test_rows_events_and_commands_have_topics_of_their_own_and_tell_how_commands_ended():
    with World(["eyerobot"]) as world:
        world.source("robot", "eyerobot")
        world.recorder({"state": "host/robot/state", "rows": "host/robot/tap_rows", "events": "host/robot/tap_events",
                        "commands": "host/robot/tap_commands"})
        world.begin("a.mcap")
        world.wait("it records", messages=101)
        world.call("host/robot/arm/hold")
        world.call("host/robot/arm/state_command", "nonsense", code=REFUSED)
        world.call("host/robot/arm/state_command", "disable")
        world.run("stop", "host/robot", code=OK)
        refused = world.call("host/robot/arm/hold", code=REFUSED)
        assert "STOPPED" in refused.stderr, refused.stderr
        last = world.end()
        assert last["lost"] == 0 and last["whole"], last
        topics, _, _ = messages(world.dir / "rec/a.mcap")
        # An output that is called state and the rows of the state table are two topics of two types.
        kinds = {name: {type(value).__name__ for _, value in topics[f"/host/robot/{name}"]} for name in ("state", "tap_rows")}
        assert all(len(kind) == 1 for kind in kinds.values()) and kinds["state"] != kinds["tap_rows"], kinds
        commands = "/host/robot/tap_commands/arm"
        # One that was turned away is told as well, though the component never saw it; and what came before `stop` is in the file.
        holds = [value.trocar_outcome for _, value in topics[f"{commands}/hold"]]
        assert holds == ["EXECUTED", "NOT_ACTIVE"], holds
        told = [(value.value, value.trocar_outcome) for _, value in topics[f"{commands}/state_command"]]
        assert told == [("nonsense", "FAILED"), ("disable", "EXECUTED")], told
        events = [name for name in topics if name.startswith("/host/robot/tap_events/")]
        told = [(value.DESCRIPTOR.fields_by_name["state"].enum_type.values_by_number[value.state].name, value.is_homed, message.publish_time)
                for message, value in topics["/host/robot/tap_events/arm/operating_state"]]
        # The event of what the command did, and so between the commands before and after it.
        assert len(told) == 1 and told[0][0].endswith("DISABLED") and told[0][1], (told, events)
        refused, before, after = (of[at][0].publish_time for of, at in ((topics[f"{commands}/state_command"], 0),
                                                                         (topics[f"{commands}/hold"], 0), (topics[f"{commands}/hold"], 1)))
        assert before < refused < told[0][2] < after, (told, before, refused, after)
        world.run("info", "rec/a.mcap", code=OK)
        world.run("export", "rec/a.mcap", "--csv", "--topic", "host/robot/tap_commands", code=OK)
        names = {path.name for path in (world.dir / "rec/a-csv").iterdir()}
        assert names == {"host_robot_tap_commands_arm_hold.csv", "host_robot_tap_commands_arm_state_command.csv"}, names
