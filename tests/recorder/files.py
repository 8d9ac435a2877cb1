"""Recorders of a system file: their place on disk, their inputs and what they tell."""

import json
import subprocess

from world import BIN, PATIENCE_S, World, contiguous, eventually, messages


def test_a_system_file_has_one_place_and_connects_the_inputs_that_it_configures():
    with World(["sine"]) as world:
        # An input that is there because the configuration names it.
        rec = {"class": "recorder/recorder", "config": {"directory": "recordings", "path": "x.mcap", "topics": ["signal"]}}
        system = {"version": 1, "processes": {"s": {"plugins": ["plugins"]}},
                  "components": {"s/sine": {"class": "sine/sine"}, "s/rec": rec},
                  "connections": [{"client": "s/rec/signal", "server": "s/sine/value"}]}
        for verb in ("run", "up"):
            project, elsewhere = world.dir / verb / "project", world.dir / verb / "elsewhere"
            for place in (project, elsewhere):
                (place / "recordings").mkdir(parents=True)
            (project / "plugins").symlink_to(world.dir / "plugins")
            (project / "s.json").write_text(json.dumps(system))
            command = [BIN / "trocar", verb, "../project/s.json", "--listen", "127.0.0.1:0"]
            with open(world.dir / f"{verb}.log", "w+") as log:
                process = subprocess.Popen(command, cwd=elsewhere, env=world.env, stdout=log, stderr=subprocess.STDOUT)
                try:
                    found = eventually(f"{verb} records", lambda: [*(world.dir / verb).rglob("x.mcap")],
                                       progress=lambda: (process.poll(), (world.dir / f"{verb}.log").read_text()))
                finally:
                    process.terminate()
                    process.wait(PATIENCE_S)
            assert found == [project / "recordings/x.mcap"], found


def test_a_system_file_records_by_inputs_that_need_no_configuration():
    system = {"version": 1,
              "processes": {"host": {"plugins": ["plugins"]}},
              "components": {"host/rec": {"class": "recorder/recorder", "config": {"directory": "rec", "path": "a.mcap"}},
                             **{f"host/s{n}": {"class": "sine/sine"} for n in range(1, 9)}},
              "connections": [{"client": f"host/rec/in_{n}", "server": f"host/s{n}/value", "queue": {"fifo": 1024}}
                              for n in range(1, 9)]}
    with World(["sine"], system) as world:
        assert world.wait("all of them are recorded", "RECORDING", topics=8)["topics"] == 8
        for n in range(8):
            world.kept(n, 101)
        last = world.end()
        assert last["whole"] and last["lost"] == 0, last
        topics, _, _ = messages(world.dir / "rec/a.mcap")
        for n in range(1, 9):
            values = topics[f"/host/s{n}/value"]
            assert len(values) > 20 and contiguous(values), (n, len(values))
        configured = {told["path"] for _, told in topics["/recorder/config"]}
        assert configured == {"host/rec", *(f"host/s{n}" for n in range(1, 9))}, configured
