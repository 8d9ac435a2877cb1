"""Recordings that end by themselves: a process that is killed, a disk that is full."""

import contextlib
import json
import os
import signal
import subprocess
import tempfile
import threading
import time

from world import OK, PARTIAL, Skip, World, contiguous, explained, messages, reaches

# Hosts killed while they record.
KILLS = 20


def test_a_recorder_that_is_killed_leaves_what_was_written_to_stock_readers():
    with World(["sine"]) as world:
        sine = world.source()
        world.recorder({"a": f"{sine}/value"})
        world.begin("a.mcap")
        path = world.dir / "rec/a.mcap"
        reaches("it is written", lambda: len(messages(path, whole=False)[0].get("/host/sine/value", ())), 401)
        world.host.send_signal(signal.SIGKILL)
        world.host.wait()
        topics, _, ended = messages(path, whole=False)
        values = topics["/host/sine/value"]
        assert not ended and len(values) > 400 and contiguous(values), len(values)
        told = world.run("info", "rec/a.mcap", code=PARTIAL)
        assert "before it could close it" in told.stderr, told.stderr
        world.run("export", "rec/a.mcap", "--csv", code=PARTIAL)
        rows = (world.dir / "rec/a-csv/host_sine_value.csv").read_text().splitlines()
        assert len(rows) == len(values) + 1, (len(rows), len(values))


def test_a_full_disk_ends_a_recording_with_a_whole_file_and_disturbs_nobody():
    full_disk("2m", video=False)


def test_a_full_disk_ends_one_of_video_that_passes_the_page_cache_by_as_well():
    full_disk("300m", video=True)


def full_disk(size, video):
    with World(["sine", "stereo"]) as world:
        disk = world.dir / "rec"
        mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", disk], capture_output=True, text=True)
        if mounted.returncode:
            raise Skip(f"no tmpfs can be mounted: {mounted.stderr.strip()}")
        try:
            sine = world.source()
            topics = {"a": f"{sine}/value"}
            if video:
                topics["video"] = f"{world.source('camera', 'phantom_source', {'width': 1024, 'height': 768})}/image"
            world.recorder(topics)
            world.begin("a.mcap")
            world.wait("it records", messages=21, bytes=60_000_001 if video else 1)
            world.recorder({"b": f"{sine}/value"}, {"directory": ".", "path": "other.mcap"}, path="host/other")
            reaches("the other one records", lambda: world.topic(0, "host/other")["kept"], 1)
            heard = world.follow("host/rec", "ctl/stopped")
            filler = disk / "filler"
            with open(filler, "wb") as file:
                try:
                    while True:
                        os.posix_fallocate(file.fileno(), file.tell(), file.tell() + 4096)
                        file.seek(4096, 1)
                except OSError:
                    pass
            last = world.ended("it ends by itself")
            assert last["whole"] and "disk is full" in last["reason"], last
            told = next(told for told in map(json.loads, heard.stdout) if told["kind"] == "event")
            heard.terminate()
            heard.communicate()
            assert told["value"] == last, (told, last)
            topics, metadata, ended = messages(disk / "a.mcap")
            assert ended and "disk is full" in metadata["trocar.end"]["reason"]
            assert contiguous(topics["/host/sine/value"])
            states = {c["path"]: c["state"] for c in world.json("ls")["components"]}
            assert set(states.values()) == {"ACTIVE"} and {"host/sine", "host/rec", "host/other"} <= set(states), states
            filler.unlink()
            if video:
                assert explained(topics, "/host/camera/image/right")
                (disk / "a.mcap").unlink()
            world.begin("b.mcap")
            world.wait("it records again", "RECORDING", messages=51)
            world.end()
            last = world.ended("the second one is closed", "b.mcap")
            assert last["whole"], last
            assert contiguous(messages(disk / "b.mcap")[0]["/host/sine/value"])
            # Somebody else, on another disk, has all of what was sent before, during and after it.
            world.run("stop", "host/other", code=OK)
            other = messages(world.dir / "other.mcap")[0]["/host/sine/value"]
            alone = [message.sequence for message, _ in topics["/host/sine/value"]]
            assert contiguous(other) and other[0][0].sequence < alone[-1] < other[-1][0].sequence, (len(other), alone[-1])
        finally:
            subprocess.run(["umount", "-l", disk], capture_output=True)


def test_who_records_is_told_when_it_ended_by_itself():
    with World(["stereo"]) as world:
        world.source("camera", "phantom_source", {"width": 160, "height": 120})
        mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=4m", "tmpfs", world.dir / "rec"], capture_output=True, text=True)
        if mounted.returncode:
            raise Skip(f"no tmpfs can be mounted: {mounted.stderr.strip()}")
        try:
            done = world.json("record", "host/camera/image", "-o", "rec/full.mcap", "--seconds", "600", code=PARTIAL)
            assert done["whole"] and "disk is full" in done["reason"], done
            topics, metadata, ended = messages(world.dir / "rec/full.mcap")
            assert ended and explained(topics, "/host/camera/image/left") and "disk is full" in metadata["trocar.end"]["reason"]
        finally:
            subprocess.run(["umount", "-l", world.dir / "rec"], capture_output=True)


@contextlib.contextmanager
def disk_that_can_stand_still():
    """A directory on a disk of its own; `fsfreeze` stops whoever writes to it."""
    with tempfile.TemporaryDirectory(prefix="trocar-disk-") as there:
        disk, at = f"{there}/disk", f"{there}/at"
        os.mkdir(at)
        with open(disk, "wb") as file:
            file.truncate(600 << 20)
        try:
            for command in (["mkfs.ext4", "-q", "-F", disk], ["mount", "-o", "loop", disk, at], ["fsfreeze", "--freeze", at],
                            ["fsfreeze", "--unfreeze", at]):
                try:
                    done = subprocess.run(command, capture_output=True, text=True)
                except FileNotFoundError:
                    raise Skip(f"{command[0]} is not there") from None
                if done.returncode:
                    raise Skip(f"no disk can be made that stands still: {command[0]}: {done.stderr.strip()}")
            yield at
        finally:
            subprocess.run(["fsfreeze", "--unfreeze", at], capture_output=True)
            subprocess.run(["umount", "-l", at], capture_output=True)


def test_a_disk_that_stands_still_holds_nobody_up_and_what_it_cost_is_counted():
    with disk_that_can_stand_still() as disk:
        topics = (("in_1", "host/sine/value", 4096), ("in_2", "far/camera/image", 64))
        system = {"version": 1,
                  "processes": {name: {"plugins": ["plugins"]} for name in ("host", "far")},
                  "components": {"host/sine": {"class": "sine/sine"},
                                 "far/camera": {"class": "stereo/phantom_source", "config": {"width": 320, "height": 240}},
                                 "host/rec": {"class": "recorder/recorder", "config": {"directory": disk, "buffer_mb": 16}},
                                 "host/other": {"class": "recorder/recorder", "config": {"path": "other.mcap"}}},
                  "connections": [{"client": f"host/{who}/{port}", "server": server, "queue": {"fifo": fifo}}
                                  for who in ("rec", "other") for port, server, fifo in topics]}
        with World(["sine", "stereo"], system) as world:
            world.begin("a.mcap")
            world.wait("it records", "RECORDING", messages=501)
            subprocess.run(["fsfreeze", "--freeze", disk], check=True)
            try:
                # What it does meanwhile is told: its memory is full, then it loses and counts, and answers all the time.
                lost = world.wait("it loses some", lost=21)
                assert lost["phase"] == "RECORDING", lost
                states = {c["path"]: c["state"] for c in world.json("ls")["components"]}
                assert set(states.values()) == {"ACTIVE"} and len(states) == 4, states
            finally:
                # Nobody can be ended who waits for it.
                subprocess.run(["fsfreeze", "--unfreeze", disk], check=True)
            # Of each topic: what comes behind a gap shows it.
            kept = [world.topic(n)["kept"] for n in range(2)]
            world.kept(0, kept[0] + 501)
            world.kept(1, kept[1] + 11)
            last = world.end()
            assert last["whole"] and last["reason"] == "stopped as asked" and last["lost"] >= lost["lost"], last
            world.run("stop", "host/other", code=OK)
            recorded, metadata, ended = messages(f"{disk}/a.mcap")
            assert ended
            # The counts are the gaps: of each topic as many as its numbers leave out.
            gaps = {name: sum(b.sequence - a.sequence - 1 for (a, _), (b, _) in zip(of, of[1:]))
                    for name, of in recorded.items() if not name.startswith("/recorder/")}
            end = metadata["trocar.end"]
            told = {name: int(end.get(f"lost:{name}", 0)) for name in ("/host/sine/value", "/far/camera/image")}
            assert told == {"/host/sine/value": gaps["/host/sine/value"], "/far/camera/image": gaps["/far/camera/image/left"]}, (told, gaps)
            assert sum(told.values()) == last["lost"] == int(end["lost"]), (told, last)
            # Pictures leave room for what is small.
            assert told["/host/sine/value"] == 0 < told["/far/camera/image"], told
            assert gaps["/far/camera/image/left"] == gaps["/far/camera/image/right"], gaps
            # Who records the same on another disk, has all of it.
            other, _, _ = messages(world.dir / "other.mcap")
            for name in gaps:
                if "/tap_" not in name:
                    assert contiguous(other[name]), (name, [message.sequence for message, _ in other[name]])
                    assert other[name][-1][0].sequence > recorded[name][0][0].sequence, name


def test_a_kill_at_any_moment_leaves_whole_records_in_order():
    killed_while_recording(video=False, kills=KILLS)


def test_a_kill_leaves_whole_frames_where_video_passes_the_page_cache_by():
    killed_while_recording(video=True, kills=KILLS // 2)


class Witness(threading.Thread):
    """How late this machine wakes who sleeps a millisecond."""

    def __init__(self):
        super().__init__(daemon=True)
        self.worst_ns, self.ends = 0, False

    def run(self):
        while not self.ends:
            due = time.monotonic_ns() + 1_000_000
            time.sleep(0.001)
            self.worst_ns = max(self.worst_ns, time.monotonic_ns() - due)

    def late_ns(self):
        self.ends = True
        self.join()
        return self.worst_ns


def killed_while_recording(video, kills):
    """Kills hosts while they record; what is in their files is whole. Of each: how much of the end is not
    there, and how late the machine was just then, ns.
    """
    losses = []
    for kill in range(kills):
        with World(["sine", "stereo"]) as world:
            topics = {"a": f"{world.source()}/value"}
            if video:
                topics["b"] = f"{world.source('camera', 'phantom_source', {'width': 1024, 'height': 768})}/image"
            world.recorder(topics)
            world.begin("a.mcap")
            world.wait("it records", messages=101, bytes=60_000_001 if video else 1)
            witness = Witness()
            witness.start()
            time.sleep(0.05 + 0.003 * kill)  # Each kill at another place between two chunks.
            killed_ns = time.monotonic_ns()
            world.host.send_signal(signal.SIGKILL)
            world.host.wait()
            late_ns = witness.late_ns()
            topics, _, _ = messages(world.dir / "rec/a.mcap", whole=False)
            values = topics["/host/sine/value"]
            assert contiguous(values)
            if video:
                left, right = (topics[f"/host/camera/image/{eye}"] for eye in ("left", "right"))
                numbers = [[message.sequence for message, _ in eye] for eye in (left, right)]
                assert all(explained(topics, f"/host/camera/image/{eye}") for eye in ("left", "right")), (numbers, topics.get("/recorder/loss"))
                # An image of each eye, but for the last pair.
                assert numbers[0][: len(right)] == numbers[1] and 0 <= len(left) - len(right) <= 1, numbers
                assert all(len(image.data) == image.step * 768 for _, image in left)
            losses.append((killed_ns - values[-1][0].publish_time, late_ns))
    return losses
