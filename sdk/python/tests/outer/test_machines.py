"""A GCM as other machines reach it: each side shows its certificate."""

import os
import subprocess

import pytest

import trocar

from .conftest import BIN, Program, linked


@pytest.fixture
def machine(tmp_path):
    """A host with a GCM of its own that listens for other machines: its address, and the directory of the identities."""

    def ca(*words):
        environment = {**os.environ, "XDG_STATE_HOME": str(tmp_path / "state")}
        done = subprocess.run([f"{BIN}/trocar", "ca", *words], cwd=tmp_path, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()

    ca("init")
    ca("issue", "or1", "--role", "gcm", "--process", "host")
    for role in ("operator", "administrator"):
        ca("issue", role, "--role", role)
    plugins, missing = linked(tmp_path, "example")
    assert not missing, missing
    plain = ["host", "--listen", "127.0.0.1:0", "--plugins", plugins, "--state", tmp_path / "host"]
    program = Program(tmp_path, "host", *plain, "--listen-tls", "127.0.0.1:0", "--identity", "or1.pem", "--revoked", ca("revoked"))
    try:
        yield program.address(r"for other machines: (https://\S+)"), tmp_path
    finally:
        program.end()


def test_a_certificate_says_what_a_session_may(machine, capsys):
    address, place = machine
    with trocar.connect(address, identity=place / "administrator.pem") as ire:
        assert ire.process == "ire"
        ire.create("host/server", "example/Server")
    with trocar.connect(address, identity=place / "operator.pem") as ire:
        assert ire.process == "", "one who operates has no place in the graph"
        ire.start("host/server")
        ire.host.server.Provided.Write(30)
        assert ire.host.server.Provided.Read() == 30
        with pytest.raises(trocar.TrocarError, match="the role administrator") as refused:
            ire.remove("host/server")
        assert refused.value.reason == "ROLE_FORBIDDEN"
    assert "you may not join" in capsys.readouterr().err


def test_an_identity_that_is_none_is_told_before_anybody_is_asked(machine, monkeypatch):
    address, place = machine
    monkeypatch.delenv("TROCAR_IDENTITY", raising=False)
    with pytest.raises(trocar.TrocarError, match="identity=FILE or TROCAR_IDENTITY"):
        trocar.connect(address)
    with pytest.raises(trocar.TrocarError, match="cannot be read"):
        trocar.connect(address, identity=place / "nobody.pem")
    (place / "operator.pem").chmod(0o644)
    with pytest.raises(trocar.TrocarError, match="chmod 600"):
        trocar.connect(address, identity=place / "operator.pem")
    (place / "operator.pem").chmod(0o600)
    monkeypatch.setenv("TROCAR_IDENTITY", str(place / "operator.pem"))
    with trocar.connect(address, place=False) as ire:
        assert ire.connected
