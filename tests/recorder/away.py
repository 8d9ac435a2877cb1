"""What a recording does where its manager, or its whole process, goes away while it is made."""

import itertools
import json
import signal
import subprocess
from contextlib import contextmanager

from world import BIN, OK, PARTIAL, PATIENCE_S, World, contiguous, eventually, messages, reaches

RECORDERS = "recorder/recorder"


@contextmanager
def recording(world):
    """`trocar record` of a sine, once it has recorded something: the process, and what it said so far on its standard error."""
    world.source()
    path = world.dir / "record.log"
    with open(path, "w") as log:
        command = [BIN / "trocar", "record", "host/sine/value", "-o", "a.mcap", "--json"]
        process = subprocess.Popen(command, cwd=world.dir, env=world.env, stdout=subprocess.PIPE, stderr=log, text=True)
    try:
        recorded = lambda: max((world.read(f"{path}/ctl/status").get("messages", 0) for path in recorders(world)), default=0)
        reaches("it records", recorded, 101)
        yield process, path.read_text
    finally:
        killed(process)


def recorders(world):
    return [component["path"] for component in world.json("ls")["components"] if component["class"] == RECORDERS]


def killed(process):
    process.kill()
    process.wait()


def ended_twice(process, said):
    """What it tells whoever does not wait for a manager that is gone: the first Ctrl-C ends the recording, the second one the waiting."""
    eventually("it says that nobody answers", lambda: said().count("recording goes on without it") == 1)
    process.send_signal(signal.SIGINT)
    eventually("it waits to end it", lambda: said().count("recording goes on without it") == 2)
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=PATIENCE_S)
    told = json.loads(out)
    assert process.returncode == PARTIAL and "cut short" in told["message"], (process.returncode, told, said())
    return told


def test_record_waits_for_a_manager_that_is_away_and_says_so():
    with World(["sine"], managed=True) as world:
        with recording(world) as (process, said):
            killed(world.manager)
            eventually("it says that nobody answers", lambda: "recording goes on without it" in said() or process.poll() is not None)
            assert process.poll() is None, (process.communicate(), said())
            world.manage(world.env["TROCAR_GCM"])
            eventually("it says that it is back", lambda: "it answers again" in said() or process.poll() is not None)
            process.send_signal(signal.SIGINT)
            out, _ = process.communicate(timeout=PATIENCE_S)
        done = json.loads(out)
        assert process.returncode == OK and done["whole"] and done["reason"] == "stopped as asked", (done, said())
        assert contiguous(messages(world.dir / "a.mcap")[0]["/host/sine/value"])
        assert recorders(world) == [], "nothing of it stays behind"


def test_who_does_not_wait_for_a_manager_is_told_what_stays_behind():
    with World(["sine"], managed=True) as world:
        with recording(world) as (process, said):
            killed(world.manager)
            told = ended_twice(process, said)
        world.manage(world.env["TROCAR_GCM"])
        (left,) = eventually("the new one knows its components", lambda: recorders(world) if world.run("ls").returncode == OK else None)
        assert f"trocar rm --force {left}" in told["help"], told
        eventually("it can be removed", lambda: world.run("rm", "--force", left).returncode == OK)
        # The recorder went on all the time, and has closed its file.
        assert contiguous(messages(world.dir / "a.mcap")[0]["/host/sine/value"])


def test_a_record_that_is_killed_takes_its_recorder_with_it_and_leaves_a_whole_file():
    with World(["sine"]) as world:
        with recording(world) as (process, _):
            killed(process)
            eventually("its recorder is gone", lambda: recorders(world) == [])
        info = world.json("info", "a.mcap")
        assert info["whole"] and info["messages"] > 100, info


def test_a_recorder_outlives_its_manager_and_is_held_at_the_next_one():
    with World(["sine"], managed=True) as world:
        with recording(world) as (process, said):
            # In order: it lets go of what it holds.
            world.manager.terminate()
            world.manager.wait()
            eventually("it says that nobody answers", lambda: "recording goes on without it" in said())
            world.manage(world.env["TROCAR_GCM"])
            eventually("it says that it is back", lambda: "it answers again" in said() or process.poll() is not None)
            assert len(recorders(world)) == 1, (recorders(world), said())
            killed(process)
            eventually("its recorder is gone", lambda: recorders(world) == [])
        assert contiguous(messages(world.dir / "a.mcap")[0]["/host/sine/value"])


def test_where_the_process_is_gone_the_file_is_named_and_read():
    with World(["sine"]) as world:
        with recording(world) as (process, said):
            killed(world.host)
            told = ended_twice(process, said)
        assert "a.mcap has what came before" in told["help"], told
        info = world.json("info", "a.mcap", code=PARTIAL)
        assert not info["whole"] and info["messages"] > 100, info


def test_what_was_lost_is_known_of_a_recording_that_was_killed():
    killed_while_losing()


def killed_while_losing():
    """Kills a host whose recorder loses most of what is sent: what it told of it is so. Answers how many of the recorder's looks came
    after that, by the gaps that each leaves.
    """
    with World(["sine"]) as world:
        sine = world.source()
        config = {"directory": "rec", "topics": ["few"]}
        world.run("create", "host/rec", "recorder", "--config", json.dumps(config), code=OK)
        # Of the ten samples between two looks of the recorder most find no room.
        world.run("connect", "host/rec/few", f"{sine}/value", "--fifo", "2", code=OK)
        world.run("start", "host/rec", code=OK)
        world.begin("a.mcap")
        losses = lambda: [told["lost"] for _, told in messages(world.dir / "rec/a.mcap", whole=False)[0].get("/recorder/loss", ())]
        reaches("its losses are in the file", lambda: max(losses(), default=0), 401)
        killed(world.host)
        topics, _, _ = messages(world.dir / "rec/a.mcap", whole=False)
        values = [message for message, _ in topics["/host/sine/value"]]
        last, told = topics["/recorder/loss"][-1]
        assert told["topics"] == {"/host/sine/value": told["lost"]} and told["lost"] > 400, told
        # A sample shows what was lost before it, so what was told is what all samples up to some one show.
        gaps = [b.sequence - a.sequence - 1 for a, b in zip(values, values[1:])]
        shown = list(itertools.accumulate(gaps))
        assert told["lost"] in shown, (told, shown[-20:])
        info = world.json("info", "rec/a.mcap", code=PARTIAL)
        assert info["lost"] == told["lost"] and not info["whole"], (info["lost"], told)
        assert next(t["lost"] for t in info["topics"] if t["topic"] == "/host/sine/value") == told["lost"], info
        return sum(gap > 0 for gap in gaps[shown.index(told["lost"]) + 1 :])
